//! What a candidate has to show besides a score: that it holds on trajectories it was not fitted to, and that it matters.

use super::evidence::Evidence;
use super::fit::{Problem, group};
use super::library::Candidate;
use super::state::{State, Tried, mean_square};
use nalgebra::DVector;

/// A fold with less than this share of the fitted effect says nothing about it, and one with more than the other is all that says
/// anything.
const INFORMATIVE: (f64, f64) = (0.03, 0.8);
/// Share of the informative folds that have to agree.
const AGREEMENT: f64 = 0.75;

/// How the folds judge a candidate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Folds {
    /// Folds whose error falls when the effect, fitted to the others, is added.
    pub positive: usize,
    /// Folds that can tell.
    pub informative: usize,
}

impl Folds {
    /// Whether they confirm it; `None` when none can tell.
    pub fn confirm(self) -> Option<bool> {
        (self.informative > 0).then_some(self.positive as f64 >= AGREEMENT * self.informative as f64)
    }
}

/// Leaves out one fold after the other, fits with and without the candidate, and looks at the fold that was left out.
pub fn folds(problem: &Problem, state: &State, tried: &Tried) -> Folds {
    let count = problem.evidence.folds().len();
    let mut found = Folds::default();
    if count < 2 {
        return found;
    }
    let phi = &tried.fit.phi;
    let shares = shares(problem, state, tried);
    for (fold, share) in shares.into_iter().enumerate() {
        if !(INFORMATIVE.0..=INFORMATIVE.1).contains(&share) {
            continue;
        }
        let others = |other: usize| other != fold;
        let with = problem.weighted(&tried.moments, &others, phi);
        let without = if tried.held { None } else { Some(problem.weighted(&state.moments, &others, phi)) };
        let error_with = problem.of_fold(&tried.moments, &with.theta, fold, phi);
        // Parameters that a prior holds stay as they are with the candidate.
        let held = || with.theta.rows(0, state.fit.theta.len()).into_owned();
        let theta = without.map_or_else(held, |without| without.theta);
        let error_without = problem.of_fold(&state.moments, &theta, fold, phi);
        found.informative += 1;
        found.positive += usize::from(error_with < error_without);
    }
    found
}

/// Share of each fold in the energy of what the candidate changes.
fn shares(problem: &Problem, state: &State, tried: &Tried) -> Vec<f64> {
    let change = change(state, tried);
    let mut energy = vec![0.0; problem.evidence.folds().len()];
    for (cell, own) in problem.evidence.cells().iter().zip(&tried.moments.cells) {
        let weight = 1.0 / tried.fit.phi[group(cell.joint, cell.band)];
        energy[cell.fold] += weight * (&own.g * &change).dot(&change);
    }
    let total: f64 = energy.iter().sum();
    energy.iter().map(|one| one / total.max(f64::MIN_POSITIVE)).collect()
}

/// Change of all parameters when the candidate comes in; of the candidate's alone where a prior holds the others.
fn change(state: &State, tried: &Tried) -> DVector<f64> {
    let mut change = tried.fit.theta.clone();
    let own = state.fit.theta.len();
    let mut before = change.rows_mut(0, own);
    if tried.held {
        before.fill(0.0);
    } else {
        before -= &state.fit.theta;
    }
    change
}

/// What a candidate explains.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Relevance {
    /// RMS of the torque that it changes, per joint \[Nm\].
    pub rms: Vec<f64>,
    /// Share of the unmodelled mean square that it takes away, per joint.
    pub share: Vec<f64>,
    /// Joint in which it explains most.
    pub joint: usize,
}

/// Measures it.
pub fn relevance(evidence: &Evidence, state: &State, tried: &Tried, item: &Candidate) -> Relevance {
    let change = change(state, tried);
    let own = state.fit.theta.len();
    let (shift, gamma) = (change.rows(0, own), change.rows(own, change.len() - own));
    let mut found = Relevance { rms: Vec::new(), share: Vec::new(), joint: 0 };
    let without = if tried.held { tried.fit.theta.rows(0, own).into_owned() } else { state.fit.theta.clone() };
    for joint in 0..evidence.joints() {
        let mut fitted = &state.columns.m[joint] * shift;
        if let Some((_, part)) = item.rows.parts.iter().find(|(other, _)| *other == joint) {
            fitted += part * gamma;
        }
        let residual = &state.columns.r[joint] - &state.columns.m[joint] * &without;
        let floor = evidence.floor(joint).unwrap_or(0.0);
        let square = mean_square(evidence, joint, &residual);
        let before = (square - floor * floor).max(0.0);
        let taken = square - mean_square(evidence, joint, &(residual - &fitted));
        found.rms.push(mean_square(evidence, joint, &fitted).sqrt());
        found.share.push((taken / before.max(f64::MIN_POSITIVE)).clamp(-1.0, 1.0));
    }
    let touched = item.joints();
    let best = touched.into_iter().max_by(|&a, &b| found.share[a].total_cmp(&found.share[b]));
    found.joint = best.unwrap_or(0);
    found
}

/// Whether an effect is worth a term in the model.
pub fn matters(evidence: &Evidence, found: &Relevance, item: &Candidate, settings: &super::Settings) -> bool {
    item.joints().into_iter().any(|joint| {
        let least = match (settings.threshold, evidence.floor(joint)) {
            (Some(threshold), _) => threshold,
            (None, Some(floor)) => settings.least_floor * floor,
            (None, None) => 0.0,
        };
        let share = if evidence.repeats() { settings.least_share } else { settings.least_share_of_all };
        found.rms[joint] >= least && found.share[joint] >= share
    })
}
