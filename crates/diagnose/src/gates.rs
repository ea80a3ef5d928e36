//! What a candidate has to show besides a score: that it holds on trajectories it was not fitted to, and that it matters.

use super::evidence::{BAND_EDGES_HZ, Evidence, LOW_BANDS};
use super::fit::{Problem, group};
use super::library::Candidate;
use super::moments::Moments;
use super::outcome;
use super::rows::Rows;
use super::state::{State, Tried, mean_square_below};
use nalgebra::DVector;
use plumbline_model::term::effect::{Setting, Site};

/// A fold is informative between these shares of the fitted effect's energy: below, the effect hardly shows in it; above, it is the only fold
/// in which the effect shows.
const INFORMATIVE_RATIOS: (f64, f64) = (0.03, 0.8);
/// Share of the informative folds that have to agree.
const MIN_AGREEMENT_RATIO: f64 = 0.75;
/// Smallest number of folds in which an effect shows where the noise is unknown.
const MIN_SHOWING_FOLDS: usize = 3;
/// An effect shows also in a fold in which its torque has this energy, in units of the noise: five standard deviations. One fold with a jerk may have
/// most of it.
const MIN_FOLD_ENERGY: f64 = 25.0;
/// Noise is alike in blocks that are no farther apart than this.
const MAX_LAG: usize = 2;
/// Critical value of 95 % with Bartlett's weights, a polynomial of their width over the number of blocks, by Kiefer and Vogelsang.
const CRITICAL: [f64; 4] = [1.96, 2.9694, 0.4160, -0.5324];
/// A displacement above this share of its range, from its least to its largest value, is at the range's end.
const MAX_SETTING_SHARE: f64 = 0.99;
/// Largest share by which the mean square of any joint may rise on folds left out, where the noise is unknown.
const MAX_LEFT_OUT_LOSS_RATIO: f64 = 0.3;

/// How the folds judge a candidate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FoldTest {
    /// Informative folds that are predicted better when the effect is added.
    pub positive: usize,
    /// Informative folds.
    pub informative: usize,
    /// Where the noise is not known, by how much the errors of the informative folds that are predicted better fall, as a share of all that they fall or rise.
    pub agreement: f64,
    /// Folds in which the effect shows, the informative ones among them.
    pub showing: usize,
    /// Where the noise is not known, twice the gain in log likelihood on folds left out, `sum_j n_j ln(error_without / error_with)` over all joints.
    pub evidence: f64,
    /// Share of the mean square removed on folds left out, in the joint with the largest share: of all bands, or of the low ones alone, to which errors are
    /// reported.
    pub share: f64,
    /// The same of all bands in the joint with the smallest share; negative where the error rises.
    pub worst: f64,
}

impl FoldTest {
    /// The counts.
    pub fn counts(self) -> outcome::Folds {
        outcome::Folds { positive: self.positive, informative: self.informative }
    }

    /// Whether they confirm the candidate; `None` without an informative fold.
    pub fn confirm(self) -> Option<bool> {
        (self.informative > 0).then_some(self.positive as f64 >= MIN_AGREEMENT_RATIO * self.informative as f64)
    }

    /// Whether most of them do, and as many by what they gain and lose.
    pub fn confirm_by_weight(self) -> bool {
        2 * self.positive > self.informative && self.agreement >= MIN_AGREEMENT_RATIO
    }

    /// Whether a candidate is accepted on folds left out, `blocks` in all, where the noise is unknown, so that the likelihood of fitted data is
    /// optimistic. It needs several folds in which it shows, a gain above `penalty`, a reduction of one joint's mean square by `least_share`, and no
    /// joint whose error rises much.
    pub fn hold(&self, blocks: usize, penalty: f64, least_share: f64) -> bool {
        self.showing >= MIN_SHOWING_FOLDS.min(blocks / 2)
            && self.evidence > penalty
            && self.share >= least_share
            && self.worst > -MAX_LEFT_OUT_LOSS_RATIO
    }
}

/// Cross-validation: fits with and without the candidate, each fold left out in turn, and compares what the others predict of that fold:
/// [`Problem::surprise`] where the noise is known, the errors where it is not or the other parameters have a prior.
pub fn folds(problem: &Problem, state: &State, tried: &Tried) -> FoldTest {
    let count = problem.evidence.folds().len();
    let mut found = FoldTest::default();
    if count < 2 {
        return found;
    }
    let (phi, own) = (&tried.fit.phi, state.moments(problem.evidence));
    let moments = tried.moments(problem.evidence, state);
    let alone = alone(problem, state, tried);
    let energies = energies(problem, state, tried, &moments);
    let total = energies.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let within = |(fold, energy): (usize, &f64)| {
        (INFORMATIVE_RATIOS.0..=INFORMATIVE_RATIOS.1).contains(&(energy / total)) && !alone.contains(&fold)
    };
    let informative: Vec<bool> = energies.iter().enumerate().map(within).collect();
    found.informative = informative.iter().filter(|informative| **informative).count();
    let shows = |fold: &usize| informative[*fold] || energies[*fold] >= MIN_FOLD_ENERGY && !alone.contains(fold);
    found.showing = (0..energies.len()).filter(shows).count();
    let known = problem.evidence.repeats();
    if known && !tried.held {
        let surprises = |moments| problem.surprise(moments, phi).into_iter();
        let falls = surprises(&moments).zip(surprises(own)).map(|(with, without)| with < without);
        found.positive = falls.zip(informative).filter(|(falls, informative)| *falls && *informative).count();
        return found;
    }
    let with = problem.left_out(&moments, phi);
    let without = if tried.held { Vec::new() } else { problem.left_out(own, phi) };
    // Per joint: weighted and plain error and that of the low bands, each without and with the candidate.
    let mut errors = vec![[[0.0; 2]; 3]; problem.evidence.joints()];
    let (mut falls, mut rises) = (0.0, 0.0);
    for (fold, informative) in informative.into_iter().enumerate() {
        // With known noise, only the sign of the change is used.
        if known && !informative {
            continue;
        }
        let error_with = problem.of_fold(&moments, &with[fold], fold, phi);
        // With a prior, the other parameters are those of the fit with the candidate.
        let held = || with[fold].rows(0, state.fit.theta.len()).into_owned();
        let theta = without.get(fold).cloned().unwrap_or_else(held);
        let error_without = problem.of_fold(own, &theta, fold, phi);
        for (sums, own) in errors.iter_mut().zip(error_without.iter().zip(&error_with)) {
            for (sum, (without, with)) in sums.iter_mut().zip(own.0.iter().zip(own.1)) {
                sum[0] += without;
                sum[1] += with;
            }
        }
        if informative {
            let weighed = |errors: &[[f64; 3]]| errors.iter().map(|own| own[0]).sum::<f64>();
            let fall = weighed(&error_without) - weighed(&error_with);
            found.positive += usize::from(fall > 0.0);
            falls += fall.max(0.0);
            rises += (-fall).max(0.0);
        }
    }
    found.agreement = falls / (falls + rises).max(f64::MIN_POSITIVE);
    let rows = problem.evidence.per_joint() as f64;
    let gain = |[without, with]: [f64; 2]| (without.max(f64::MIN_POSITIVE) / with.max(f64::MIN_POSITIVE)).ln();
    let share = |errors: [f64; 2]| 1.0 - (-gain(errors)).exp();
    found.evidence = errors.iter().map(|own| rows * gain(own[0])).sum();
    let shares = errors.iter().flat_map(|own| [1, 2].map(|bands| share(own[bands])));
    found.share = shares.fold(f64::NEG_INFINITY, f64::max);
    found.worst = errors.iter().map(|own| share(own[1])).fold(f64::INFINITY, f64::min);
    found
}

/// RMS of each joint on folds left out in turn \[Nm\], of two models: parameters from all other folds, weights of the first.
pub fn left_out(problem: &Problem, before: &State, after: &State) -> Vec<[f64; 2]> {
    let (evidence, phi) = (problem.evidence, &before.fit.phi);
    let mut errors = vec![[0.0; 2]; evidence.joints()];
    for (which, state) in [before, after].into_iter().enumerate() {
        for (fold, theta) in evidence.folds().iter().zip(problem.left_out(state.moments(evidence), phi)) {
            let (first, count) = (fold.rows.start, fold.rows.len());
            for (joint, sum) in errors.iter_mut().enumerate() {
                let columns = state.columns.m[joint].rows(first, count);
                let residual = state.columns.r[joint].rows(first, count) - columns * &theta;
                let sigma = &evidence.sigma(joint)[fold.rows.clone()];
                sum[which] += residual.iter().zip(sigma).map(|(row, sigma)| (row * sigma).powi(2)).sum::<f64>();
            }
        }
    }
    errors.into_iter().map(|sums| sums.map(|sum| (sum / evidence.samples()).sqrt())).collect()
}

/// Folds that are the only one in which a candidate acts, or the only one in which it does not: without such a fold, nothing tells the candidate
/// from the other columns.
fn alone(problem: &Problem, state: &State, tried: &Tried) -> Vec<usize> {
    let evidence = problem.evidence;
    let mut acts = vec![false; evidence.folds().len()];
    tried.cross(evidence, state).cells.iter().for_each(|(cell, _)| acts[evidence.cells()[*cell].fold] = true);
    let only = |value: bool| {
        let mut folds = (0..acts.len()).filter(|&fold| acts[fold] == value);
        folds.next().filter(|_| folds.next().is_none())
    };
    [true, false].into_iter().filter_map(only).collect()
}

/// Energy of the torque that the candidate changes in each fold, in units of the noise.
fn energies(problem: &Problem, state: &State, tried: &Tried, moments: &Moments) -> Vec<f64> {
    let change = change(state, tried);
    let mut energy = vec![0.0; problem.evidence.folds().len()];
    for (cell, own) in problem.evidence.cells().iter().zip(&moments.cells) {
        let weight = 1.0 / tried.fit.phi[group(cell.joint, cell.band)];
        energy[cell.fold] += weight * (&own.g * &change).dot(&change);
    }
    energy
}

/// Change of all parameters when the candidate is added; only the candidate's own where the others have a prior.
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

/// How much more noise lies along what a candidate does than the weights by band say, at least 1: slow noise of motions that do not repeat is alike in
/// blocks that follow each other, and strongest at frequencies of which a block has few.
///
/// Of the products `s_b` of each block's residual, left out of the fit, with the effect as it were in the whole recording:
/// `sum_b (s_b^2 + 2 sum_l w_l s_b s_(b+l))` with Bartlett's `w` (Newey and West, Econometrica 55, 1987) over what the weights expect, times what few
/// blocks know less of that sum (Kiefer and Vogelsang, Econometric Theory 21, 2005).
pub fn dispersion(problem: &Problem, state: &State, tried: &Tried, item: &Candidate, everywhere: &Rows) -> f64 {
    let (evidence, own) = (problem.evidence, state.fit.theta.len());
    let gamma = tried.fit.theta.rows(own, item.rows.width);
    let left_out = problem.left_out(&tried.moments(evidence, state), &tried.fit.phi);
    let (mut products, mut expected) = (vec![0.0; evidence.folds().len()], 0.0);
    for joint in item.joints() {
        let (Some(here), Some(everywhere)) = (item.rows.of(joint), everywhere.of(joint)) else { continue };
        let effect = &*everywhere * gamma;
        for cell in evidence.cells().iter().filter(|cell| cell.joint == joint) {
            let (first, count) = (cell.rows.start, cell.rows.len());
            let weight = 1.0 / tried.fit.phi[group(joint, cell.band)];
            let (theta, effect) = (&left_out[cell.fold], effect.rows(first, count));
            let residual = state.columns.r[joint].rows(first, count)
                - state.columns.m[joint].rows(first, count) * theta.rows(0, own)
                - here.rows(first, count) * theta.rows(own, item.rows.width);
            products[cell.fold] += weight * effect.dot(&residual);
            expected += weight * effect.norm_squared();
        }
    }
    let apart = |lag: usize| {
        let run = |fold: usize| evidence.folds()[fold].experiment;
        let pairs = (lag..products.len()).filter(|&fold| run(fold) == run(fold - lag));
        pairs.map(|fold| products[fold] * products[fold - lag]).sum::<f64>()
    };
    let weighed = |lag: usize| 2.0 * (1.0 - lag as f64 / (MAX_LAG + 1) as f64) * apart(lag);
    let sum = apart(0) + (1..=MAX_LAG).map(weighed).sum::<f64>();
    let width = (MAX_LAG + 1) as f64 / products.len() as f64;
    let few_blocks = CRITICAL.iter().rev().fold(0.0, |sum, c| sum * width + c) / CRITICAL[0];
    (few_blocks.powi(2) * sum / f64::max(expected, f64::MIN_POSITIVE)).max(1.0)
}

/// What a candidate explains.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Relevance {
    /// RMS of the torque that it changes, per joint \[Nm\].
    pub rms: Vec<f64>,
    /// Share of the unmodelled mean square that it removes, per joint.
    pub share: Vec<f64>,
    /// Joint in which it explains most, against the noise there where that is known.
    pub joint: usize,
    /// RMS and share in the low bands alone, per joint. Noise that grows with the frequency, as that of an encoder's steps does, would hide
    /// there what spoils the torque of every slow motion.
    pub low: Vec<(f64, f64)>,
    /// Whether it is one effect of the whole arm, whose torques in all joints count together.
    pub of_arm: bool,
}

/// Measures it.
pub fn relevance(evidence: &Evidence, state: &State, tried: &Tried, item: &Candidate) -> Relevance {
    let change = change(state, tried);
    let own = state.fit.theta.len();
    let (shift, gamma) = (change.rows(0, own), change.rows(own, change.len() - own));
    let mut found = Relevance { of_arm: item.spec.site == Site::Arm, ..Relevance::default() };
    let mut worth = Vec::new();
    let without = if tried.held { tried.fit.theta.rows(0, own).into_owned() } else { state.fit.theta.clone() };
    for joint in 0..evidence.joints() {
        let mut fitted = &state.columns.m[joint] * shift;
        if let Some(part) = item.rows.of(joint) {
            fitted += &*part * gamma;
        }
        let residual = &state.columns.r[joint] - &state.columns.m[joint] * &without;
        let left = &residual - &fitted;
        // RMS of the change, mean square removed, and its share of what is unmodelled, in the lowest bands.
        let below = |bands: usize| {
            let square = |rows: &DVector<f64>| mean_square_below(evidence, joint, rows, bands);
            let floor = evidence.floor_below(joint, bands).unwrap_or(0.0);
            let before = square(&residual);
            let taken = before - square(&left);
            let unmodelled = (before - floor * floor).max(f64::MIN_POSITIVE);
            (square(&fitted).sqrt(), taken, (taken / unmodelled).clamp(-1.0, 1.0))
        };
        let (rms, taken, share) = below(BAND_EDGES_HZ.len());
        // Normalised by the noise floor: a large share of a tiny residual is irrelevant.
        let floor = evidence.floor(joint).unwrap_or(0.0);
        worth.push(if floor > 0.0 { taken / (floor * floor) } else { share });
        found.rms.push(rms);
        found.share.push(share);
        let (rms, _, share) = below(LOW_BANDS);
        found.low.push((rms, share));
    }
    // Not always one that it acts in: base parameters may have taken it over, and spoil the torque elsewhere.
    let best = (0..evidence.joints()).max_by(|&a, &b| worth[a].total_cmp(&worth[b]));
    found.joint = best.unwrap_or(0);
    found
}

/// Whether an effect is worth a term in the model: in one joint it removes a share of what is unmodelled, and its torque exceeds a share of the
/// noise of the mean period; or so in the low bands, in the noise of one period, as errors are measured and reported run by run. Of an effect of the whole arm
/// the torques over these shares of the noise are summed as squares.
pub fn matters(evidence: &Evidence, found: &Relevance, settings: &super::Settings) -> bool {
    let share = if evidence.repeats() { settings.least_share } else { settings.least_share_of_all };
    // Size in units of what is enough.
    let size = |joint: usize, floor: Option<f64>, (rms, explained): (f64, f64)| {
        let least = settings.threshold.or(floor.map(|floor| settings.least_floor * floor)).unwrap_or(0.0);
        let least = settings.usual.get(joint).map_or(least, |usual| usual.max(least));
        if explained < share {
            0.0
        } else if least > 0.0 {
            rms / least
        } else {
            1.0
        }
    };
    // Also a joint that it does not act in: the base parameters may have taken it over, and spoil the torque there.
    let joints = 0..evidence.joints();
    let all = joints.clone().map(|joint| size(joint, evidence.floor(joint), (found.rms[joint], found.share[joint])));
    let low = joints.map(|joint| size(joint, evidence.floor_of_periods_below(joint, LOW_BANDS, 1.0), found.low[joint]));
    let together = settings.threshold.is_none() && found.of_arm;
    let enough = |sizes: Vec<f64>| match together {
        true => sizes.iter().map(|size| size * size).sum::<f64>() >= 1.0,
        false => sizes.iter().any(|size| *size >= 1.0),
    };
    enough(all.collect()) || enough(low.collect())
}

/// Whether the data show how large a displacement is: one within a step of the encoder can't be told from its rounding, which repeats in every period and
/// is in no scatter, and at the upper end of what is searched the likelihood has no maximum.
pub fn shows(evidence: &Evidence, item: &Candidate) -> bool {
    let Some(form) = item.spec.form() else { return true };
    let joint = item.spec.site.joints().first().copied();
    let step = joint.filter(|_| evidence.repeats()).map_or(0.0, |joint| evidence.encoder_step(joint));
    let inside = |setting: &Setting, value: f64| value > step && setting.share(value) < MAX_SETTING_SHARE;
    let mut settings = form.settings.iter().zip(&item.spec.settings);
    settings.all(|(setting, value)| !setting.is_displacement() || inside(setting, *value))
}

#[cfg(test)]
mod tests;
