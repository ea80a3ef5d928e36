//! The model that is delivered: the plain one with the effects that help.

use super::acting::Acting;
use super::errors::{self, Compared};
use super::evidence::{Evidence, Trial};
use super::fit::inverse;
use super::found::Found;
use super::input::{Input, Settings};
use super::library::{self, Candidate};
use super::outcome::Fitted;
use super::select::Selected;
use super::state::State;
use super::unseen::{Known, Residuals, Taken, Unseen};
use nalgebra::{DMatrix, DVector};
use plumbline_core::parallel;
use plumbline_identify::solve::{Equations, Estimator, Identification};
use plumbline_identify::{EstimateError, Modelled};
use plumbline_model::TorqueModel;
use plumbline_model::term::effect::{self, Spec};
use plumbline_model::term::{Column, Expected, Motion};
use std::cell::OnceCell;

/// Smallest share of what an effect should take on unseen runs, to be delivered, or of a joint's unmodelled power, to be proved there: these runs may differ by
/// something else.
pub(super) const MIN_EXPLAINED_RATIO: f64 = 0.5;
/// A joint is worse when the interval of its error's change lies above this share of the plain model's error. Joints share the rigid-body
/// parameters, so every effect changes each of them a little.
const MAX_WORSENING_RATIO: f64 = 0.05;
/// Standard deviations by which a parameter of an effect has to differ from zero.
const MIN_DEVIATIONS: f64 = 2.0;
/// The same of what the search started with in unknown noise, so that no gate has looked at it.
const MIN_DEVIATIONS_OF_SEED: f64 = 3.0;
/// Evidence over its penalty from which on an effect that no other trajectory shows needs none.
const BEYOND_DOUBT_RATIO: f64 = 8.0;
/// Largest change of a parameter, in its standard deviations, at which the operating point has converged.
const SETTLED_DEVIATIONS: f64 = 0.1;

/// What a delivery is made of.
pub struct Delivery<'a> {
    /// What is diagnosed.
    pub input: &'a Input<'a>,
    /// The runs that decide.
    pub unseen: &'a Evidence,
    /// The same without what acts in a part of the recording.
    pub unseen_without: &'a [Trial<'a>],
    /// The plain structure along the runs to identify from, alike.
    pub equations: &'a Equations<'a>,
    /// What acts in a part of the recording.
    pub acting: &'a Acting<'a>,
    /// The plain model.
    pub before: &'a Identification,
    /// Effects that the search started with.
    pub seeds: &'a [Candidate],
    /// How the diagnosis is done.
    pub settings: &'a Settings,
}

impl Delivery<'_> {
    /// The model with the effects that help, and for each effect that it has not the reason, a sentence. They have to help in the selection's fit, of which
    /// `taken` tells what it takes from the residuals `before` it (as far as the unseen runs show them), and must do no harm in the model that is
    /// delivered: identified once more upon its own load, an effect near a resonance may come out as another one. An effect that passes this may
    /// be withheld for another reason: see [`Delivery::reason`].
    ///
    /// # Errors
    /// As [`Equations::identify`].
    pub fn of(
        &self,
        selected: &Selected,
        before: &Residuals,
        taken: &[Option<Taken>],
        confirmed: &[bool],
    ) -> Result<(Fitted, Vec<Option<String>>), EstimateError> {
        let too_little = |taken: &[Option<Taken>], found: &Found, least: f64| {
            let joint = found.relevance.joint;
            let share = taken[joint]?.falls_short(least)?;
            Some(match share {
                share if share < 0.0 => {
                    format!("on unseen runs the effects add to what the plain model lacks in joint {}", joint + 1)
                }
                share => format!(
                    "on unseen runs the effects explain {:.0} % of what they should in joint {}",
                    100.0 * share,
                    joint + 1
                ),
            })
        };
        let items = &selected.state.items;
        let least = |item: &Candidate| if selected.state.has_in_most_joints(item) { 0.0 } else { MIN_EXPLAINED_RATIO };
        // What acts in a part is in no model.
        let everywhere: Vec<bool> = items.iter().map(|item| item.span.is_all()).collect();
        let found = selected.found.iter().zip(items).zip(&everywhere);
        let of_item = |((found, item), all): ((&Found, &Candidate), &bool)| {
            too_little(taken, found, least(item)).filter(|_| *all)
        };
        let mut withheld: Vec<Option<String>> = found.map(of_item).collect();
        loop {
            let kept: Vec<bool> = withheld.iter().zip(&everywhere).map(|(why, all)| why.is_none() && *all).collect();
            let after = self.extended(&selected.state, &kept)?;
            if !kept.contains(&true) {
                return Ok((after, withheld));
            }
            let unseen = Unseen::of_model(self.unseen, &after, self.unseen_without);
            let known = Known {
                theta: &DVector::from_column_slice(&after.identification.beta),
                information: &inverse(&after.identification.covariance),
                phi: &selected.state.fit.phi,
            };
            let taken = unseen.taken(before, &unseen.residuals(known));
            for (index, why) in withheld.iter_mut().enumerate().filter(|(index, _)| kept[*index]) {
                *why = too_little(&taken, &selected.found[index], 0.0);
            }
            if withheld.iter().zip(&kept).any(|(why, kept)| *kept && why.is_some()) {
                continue;
            }
            // One at a time, the lowest score first: the others change without it.
            let Some((index, why)) = self.reason(selected, &kept, &after, confirmed) else {
                return Ok((after, withheld));
            };
            withheld[index] = Some(why);
        }
    }

    /// The effect that the model `after` must not have, and why: its parameters can't be by its physics; they are zero within
    /// their errors, and most joints have no such effect; its joint is predicted worse than by the plain model on unseen runs, or another one is and all
    /// together are no worse without it; or it is unconfirmed and not beyond doubt, and the joint that it shows most in is not predicted better there,
    /// nor surely its own, or all together are no worse without it.
    fn reason(
        &self,
        selected: &Selected,
        kept: &[bool],
        after: &Fitted,
        confirmed: &[bool],
    ) -> Option<(usize, String)> {
        let items = &selected.state.items;
        let score = |index: &usize| selected.found[*index].score;
        let mut candidates: Vec<usize> = (0..items.len()).filter(|&index| kept[index]).collect();
        candidates.sort_by(|a, b| score(a).total_cmp(&score(b)));
        let seed = |item: &Candidate| self.seeds.iter().any(|seed| seed.alike(item));
        for &index in &candidates {
            if let Some(why) = implausible(after, &items[index].spec) {
                return Some((index, why));
            }
            let least = if seed(&items[index]) { MIN_DEVIATIONS_OF_SEED } else { MIN_DEVIATIONS };
            if is_zero(after, &items[index].spec, least) && !selected.state.has_in_most_joints(&items[index]) {
                return Some((index, "in the whole model its parameters are zero within their errors".into()));
            }
        }
        let compared = self.compared(after, self.input.veto)?;
        let errors = OnceCell::new();
        let without = || errors.get_or_init(|| self.errors_without(selected, kept, &candidates));
        for joint in worse(&compared) {
            let why = format!("with it, unseen runs are predicted worse: {}", words(&compared, joint));
            if let Some(own) = candidates.iter().find(|&&index| items[index].spec.site.joints().contains(&joint)) {
                return Some((*own, why));
            }
            // The joints share the rigid body's parameters. What an effect costs another joint is weighed against what it takes elsewhere.
            let costliest = without().iter().min_by(|(_, a), (_, b)| a[joint].total_cmp(&b[joint]));
            if let Some((index, _)) = costliest.filter(|(_, errors)| rise(errors, &compared) <= 0.0) {
                return Some((*index, why));
            }
        }
        // One trajectory may be the only one that shows an effect, and against known noise show it beyond doubt.
        let doubtful = |index: &usize| {
            let Found { evidence, penalty, .. } = selected.found[*index];
            let beyond_doubt = self.knows_noise() && evidence > BEYOND_DOUBT_RATIO * penalty;
            !confirmed[*index] && !beyond_doubt
        };
        let unconfirmed: Vec<usize> = candidates.iter().copied().filter(doubtful).collect();
        for &index in &unconfirmed {
            let joint = selected.found[index].relevance.joint;
            // A link that swings on its gear may show most in the joint that carries it.
            let rows = items[index].joints();
            let mut own = items[index].spec.site.joints().into_iter().filter(|joint| rows.contains(joint));
            let own_is_better = own.any(|joint| compared.change.intervals[joint][1] < 0.0);
            if compared.change.validate_rms[joint] >= 0.0 && !own_is_better {
                let words = words(&compared, joint);
                return Some((index, format!("it is unconfirmed, and unseen runs are predicted no better: {words}")));
            }
        }
        if unconfirmed.is_empty() {
            return None;
        }
        let rises = without().iter().map(|(index, errors)| (*index, rise(errors, &compared)));
        let least = rises.filter(|(index, _)| unconfirmed.contains(index)).min_by(|(_, a), (_, b)| a.total_cmp(b));
        let (index, rise) = least.filter(|(_, rise)| *rise <= 0.0)?;
        let percent = 100.0 * rise;
        let why = "it is unconfirmed, and unseen runs are predicted no worse without it";
        Some((index, format!("{why}: {percent:+.1} % in the mean of the joints")))
    }

    /// Errors of each joint on the runs that decide, without each of these effects in turn.
    fn errors_without(&self, selected: &Selected, kept: &[bool], candidates: &[usize]) -> Vec<(usize, Vec<f64>)> {
        let Ok(weights) = self.weights(&selected.state) else { return Vec::new() };
        let errors = |&index: &usize| {
            let mut fewer = kept.to_vec();
            fewer[index] = false;
            let without = self.weighted(&selected.state, &fewer, weights.as_deref()).ok()?;
            Some((index, self.compared(&without, self.input.veto)?.after.validate_rms))
        };
        parallel(candidates, self.settings.threads, errors).into_iter().flatten().collect()
    }

    /// Errors of the plain model and of another one on runs; `None` where there are none.
    pub fn compared(&self, after: &Fitted, runs: &[Trial]) -> Option<Compared> {
        let plain = Fitted { structure: self.input.structure.clone(), identification: self.before.clone() };
        let nothing = |_: &Trial, motion: &Motion| DMatrix::zeros(motion.samples(), motion.joints());
        self.errors(&plain, nothing, after, runs)
    }

    /// The same of two models of the arm without what acts in a part of the recording.
    pub fn compared_with(&self, before: &Fitted, after: &Fitted, runs: &[Trial]) -> Option<Compared> {
        self.errors(before, |trial, motion| self.acting.torque(trial, motion), after, runs)
    }

    /// Errors of two models on runs; `acts` is what acts in a part of the recording beside the first.
    fn errors(
        &self,
        before: &Fitted,
        acts: impl Fn(&Trial, &Motion) -> DMatrix<f64> + Sync,
        after: &Fitted,
        runs: &[Trial],
    ) -> Option<Compared> {
        if runs.is_empty() {
            return None;
        }
        // Evaluated causally as in the loop; a regressor may use later samples.
        let model = |fitted: &Fitted| {
            TorqueModel::new("", fitted.structure.clone(), Vec::new(), &fitted.identification.values()).ok()
        };
        let (plain, after) = (model(before)?, model(after)?);
        let each = parallel(runs, self.settings.threads, |trial| {
            let before = Modelled::of(trial.experiment, |motion| plain.predict(motion) + acts(trial, motion));
            (before, Modelled::of(trial.experiment, |motion| after.predict(motion) + self.acting.torque(trial, motion)))
        });
        let pairs: Vec<_> =
            runs.iter().zip(each).map(|(trial, (plain, after))| (trial.experiment, plain, after)).collect();
        errors::compare(&pairs, self.settings.judged_by)
    }

    /// Whether all runs to identify from repeat.
    fn knows_noise(&self) -> bool {
        self.equations.experiments().iter().all(|experiment| experiment.scatter.is_some())
    }

    /// Standard deviation of each joint's residual under the model that the search starts from, where the noise is not known; `None` where it is, or another
    /// estimator is asked for.
    ///
    /// The weights of the joints stay as they are there: a joint that an effect repairs would weigh more otherwise, and the parameters that
    /// it shares with the others would follow what it still lacks.
    fn weights(&self, state: &State) -> Result<Option<Vec<f64>>, EstimateError> {
        let Delivery { input, equations, seeds, .. } = *self;
        if input.options.estimator != Estimator::Wls || self.knows_noise() {
            return Ok(None);
        }
        let specs: Vec<Spec> = seeds.iter().map(|seed| seed.spec.clone()).collect();
        let operating_point = input.structure.operating_point(state.fit.theta.as_slice());
        let terms = effect::assemble(&specs, &operating_point).ok().filter(|_| !specs.is_empty());
        Ok(Some(match terms.and_then(|terms| input.structure.clone().with(terms).ok()) {
            Some(structure) => equations.extended(structure)?.identify(input.options)?.sigma,
            None => self.before.sigma.clone(),
        }))
    }

    /// Identified as a whole.
    fn extended(&self, state: &State, kept: &[bool]) -> Result<Fitted, EstimateError> {
        self.weighted(state, kept, self.weights(state)?.as_deref())
    }

    /// The same with these [weights](Self::weights).
    fn weighted(&self, state: &State, kept: &[bool], weights: Option<&[f64]>) -> Result<Fitted, EstimateError> {
        let Delivery { input, equations, before, .. } = *self;
        let experiments = equations.experiments();
        let plain = || Fitted { structure: input.structure.clone(), identification: before.clone() };
        let specs: Vec<Spec> =
            state.items.iter().zip(kept).filter(|(_, kept)| **kept).map(|(item, _)| item.spec.clone()).collect();
        if specs.is_empty() {
            let as_before = experiments.iter().all(|experiment| experiment.as_recorded().is_none());
            return match self.acting.is_empty() && as_before {
                true => Ok(plain()),
                false => Ok(Fitted { identification: equations.identify(input.options)?, ..plain() }),
            };
        }
        let mut beta = state.fit.theta.as_slice().to_vec();
        let mut fitted = plain();
        // Once more at the operating point just found.
        for _ in 0..2 {
            let operating_point = input.structure.operating_point(&beta);
            let terms = effect::assemble(&specs, &operating_point).ok();
            let Some(structure) = terms.and_then(|terms| input.structure.clone().with(terms).ok()) else {
                return Ok(plain());
            };
            let equations = equations.extended(structure)?;
            let identification = match weights {
                Some(sigma) => equations.identify_weighted(sigma)?,
                None => equations.identify(input.options)?,
            };
            let plain = 0..input.structure.columns().len();
            let near = plain.into_iter().all(|c| {
                identification.std[c]
                    .is_none_or(|std| (identification.beta[c] - beta[c]).abs() <= SETTLED_DEVIATIONS * std)
            });
            beta.clone_from(&identification.beta);
            fitted = Fitted { structure: equations.structure().clone(), identification };
            if near {
                break;
            }
        }
        Ok(fitted)
    }
}

/// Joints that the second model predicts worse than the first.
pub fn worse(compared: &Compared) -> impl Iterator<Item = usize> {
    let pairs = compared.change.intervals.iter().zip(&compared.before.validate_rms);
    pairs.enumerate().filter(|(_, ([low, _], before))| *low > MAX_WORSENING_RATIO * **before).map(|(joint, _)| joint)
}

/// Change of a joint's error with its interval.
pub fn words(compared: &Compared, joint: usize) -> String {
    let (change, [low, high]) = (compared.change.validate_rms[joint], compared.change.intervals[joint]);
    format!("{change:+.4} [{low:.4}, {high:.4}] Nm in joint {}", joint + 1)
}

/// Mean of `ln` of errors without an effect over those with it: each joint counts alike.
fn rise(without: &[f64], with: &Compared) -> f64 {
    let joints = without.iter().zip(&with.after.validate_rms);
    joints.map(|(without, with)| (without / with).ln()).sum::<f64>() / without.len() as f64
}

/// Estimates of the linear parameters of an effect, by name: some effects are columns of a term of the whole arm.
fn own<'a>(fitted: &'a Fitted, columns: &'a [Column]) -> impl Iterator<Item = (&'a Column, f64, Option<f64>)> {
    let Fitted { structure, identification } = fitted;
    let values = structure.columns().iter().zip(identification.values());
    values
        .filter(|(column, _)| columns.iter().any(|own| own.name == column.name))
        .map(|(column, (value, std))| (column, value, std))
}

/// Why the parameters of an effect can't be by its physics: below zero, or far from what its torque was computed with.
fn implausible(fitted: &Fitted, spec: &Spec) -> Option<String> {
    let term = spec.build(&fitted.structure.operating_point(&fitted.identification.beta)).ok()?;
    let columns = term.columns();
    let (names, values): (Vec<&str>, Vec<f64>) =
        own(fitted, &columns).map(|(column, value, _)| (&*column.name, value)).unzip();
    if library::allows(term.expects(), &spec.settings, &values) {
        return None;
    }
    let (name, value) = names.into_iter().zip(values).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
    let why = match (term.expects(), spec.settings.first()) {
        (Expected::FirstSetting, Some(setting)) if value > 0.0 => {
            return Some(format!("{name} came out as {value:.2e}, and its torque was computed with {setting:.2e}"));
        }
        (Expected::AtMost(_), _) => "it can't be as large",
        _ => "it can't be below 0",
    };
    let digits = if value.abs() < 1e-3 { format!("{value:.2e}") } else { format!("{value:.3}") };
    Some(format!("{name} came out as {digits}, and {why}"))
}

/// Whether every linear parameter of an effect is within so many standard deviations of zero.
fn is_zero(fitted: &Fitted, spec: &Spec, deviations: f64) -> bool {
    let Ok(term) = spec.build(&fitted.structure.operating_point(&fitted.identification.beta)) else { return false };
    let columns = term.columns();
    let mut values = own(fitted, &columns).peekable();
    values.peek().is_some() && values.all(|(_, value, std)| std.is_some_and(|std| value.abs() < deviations * std))
}

#[cfg(test)]
mod tests;
