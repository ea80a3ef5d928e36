//! The live watch: detects when the served model no longer predicts the torques, and searches for what changed.
//!
//! The detector takes one short stretch of samples after the other: the mean square `m` of measured minus modelled torque in the band, joint by joint,
//! relative to `u^2`, that of the motion that the model was identified from. For noise, `nu m / u^2` has about a chi-square distribution with `nu` degrees
//! of freedom, which the stretches of that motion tell by their scatter and their correlation. The cumulative sum of the log likelihood ratios of a
//! doubled error,
//!
//!   S <- max(0, S + nu/2 (m/u^2 (1 - 1/r^2) - ln r^2)),   r = 2,
//!
//! is an alarm at `S > h`. The mean time between false alarms of one joint is at least `e^h` stretches (Page, Biometrika 41, 1954; Lorden, Annals of
//! Mathematical Statistics 42, 1971); `h` is set for one in [`FALSE_ALARM_S`]. The same sum of the reverse ratio says that the model holds again.
//!
//! The search of [`mod@super::reference`] goes over all samples since the change, again whenever there are twice as many; the last part of them takes no
//! part in the search and judges what was found.

use super::evidence::Trial;
use super::input::Settings;
use super::reference::{self, Change};
use nalgebra::DMatrix;
use plumbline_core::symmetric_eigen;
use plumbline_identify::Experiment;
use plumbline_model::term::Motion;
use plumbline_model::{ModelError, Structure, TorqueModel};
use std::ops::Range;

/// Length of a stretch \[s\].
pub const STRETCH_S: f64 = 0.5;
/// Time excluded at both ends of a motion because of the filters \[s\].
pub const END_MARGIN_S: f64 = 0.4;
/// Time between two false alarms, on average, at least \[s\].
const FALSE_ALARM_S: f64 = 10.0 * 3600.0;
/// Error that is looked for, as a ratio to the usual one.
const LOST_RATIO: f64 = 2.0;
/// Mean square on a motion that was not identified from, as a ratio to that of the identification: errors of the parameters show there.
const UNSEEN_RATIO: f64 = 1.3;
/// Mean square that becomes usual on the motions that are watched, at most, as a ratio to that of the identification.
const MAX_USUAL_RATIO: f64 = 4.0;
/// Stretches that the identification counts for beside those that are watched.
const IDENTIFIED_STRETCHES: f64 = 10.0;
/// Degrees of freedom of a stretch: at least, and at most 2 B T of a band of 5 Hz.
const FREEDOM: (f64, f64) = (1.0, 10.0 * STRETCH_S);
/// Share of the estimated degrees of freedom that is relied on: some tens of stretches tell them to a fifth.
const RELIED_ON: f64 = 0.75;
/// Time between samples for which the spread of the parameters is computed \[s\]: it changes with the pose.
const SPREAD_STEP_S: f64 = 0.05;
/// Share of the search's window that is held out to accept the changes.
const JUDGED_RATIO: f64 = 0.25;
/// Largest error of the worst joint with the changes, as a share of the error without them, for a proposal.
const MAX_REMAINING_RATIO: f64 = 0.8;
/// Joints whose error is above this share of the worst joint's, both as ratios to the usual, tell when a change came.
const CONCERNED_RATIO: f64 = 0.5;
/// A change that grows is followed back to its begin in at most so many steps.
const MAX_ONSET_STEPS: usize = 10;
/// Largest error of a refined model on the held-out samples, as a ratio to that of the served one.
const MAX_REFINED_RATIO: f64 = 1.02;

/// Error in the band, per joint.
#[derive(Clone, Debug, PartialEq)]
pub struct Floor {
    /// RMS on the motion that the model was identified from \[Nm\].
    pub usual: Vec<f64>,
    /// Degrees of freedom of the mean square of a stretch.
    pub freedom: Vec<f64>,
    /// RMS of a stretch that is an alarm by itself \[Nm\].
    pub limit: Vec<f64>,
}

/// A change of the watch's state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum News {
    /// The model does not hold any more.
    Lost {
        /// Start of the first bad stretch \[s\].
        since: f64,
        /// Joint whose error is farthest above the usual one, from 0.
        joint: usize,
        /// Its RMS \[Nm\].
        rms: f64,
        /// What it usually is \[Nm\].
        floor: f64,
    },
    /// It holds again.
    Holds {
        /// Start of the first good stretch \[s\].
        since: f64,
    },
}

/// Detector over consecutive stretches.
#[derive(Clone, Debug)]
pub struct Watch {
    floor: Floor,
    /// RMS on the motion that the model was identified from, per joint \[Nm\].
    identified: Vec<f64>,
    /// Stretches that a model held on, and their sums of squares per joint \[Nm2\].
    held: (f64, Vec<f64>),
    /// For the other state than the present one.
    sums: Sums,
    /// Since when the model does not hold \[s\].
    lost: Option<f64>,
    /// What is usual while nothing explains that, and its sums until another change shows above it.
    beside: Option<(Floor, Option<Sums>)>,
}

/// Sum of each joint, and the start of the first stretch that it has summed \[s\].
type Sums = Vec<(f64, f64)>;

impl Floor {
    /// Of the motion that the model was identified from, prepared like those that will be watched.
    pub fn of(model: &TorqueModel, experiment: &Experiment) -> Floor {
        Floor::from_stretches(&stretches(model, experiment))
    }

    /// From the RMS of stretches, per joint \[Nm\].
    pub fn from_stretches(stretches: &[Vec<f64>]) -> Floor {
        let (count, joints) = (stretches.len().max(1) as f64, stretches.first().map_or(0, Vec::len));
        let square = |joint: usize| stretches.iter().map(|rms| rms[joint].powi(2)).sum::<f64>() / count;
        let square: Vec<f64> = (0..joints).map(square).collect();
        let freedom = freedom(stretches, &square);
        let usual: Vec<f64> = square.iter().map(|square| square.sqrt()).collect();
        let limit = |(usual, freedom): (&f64, &f64)| {
            let (gain, cost) = (1.0 - LOST_RATIO.powi(-2), 2.0 * LOST_RATIO.ln());
            usual * (UNSEEN_RATIO * (2.0 * threshold(joints) / freedom + cost) / gain).sqrt()
        };
        let limit = usual.iter().zip(&freedom).map(limit).collect();
        Floor { usual, freedom, limit }
    }

    /// Another usual RMS of a joint \[Nm\], to which its limit is proportional.
    fn set_usual(&mut self, joint: usize, usual: f64) {
        self.limit[joint] *= usual / self.usual[joint].max(f64::MIN_POSITIVE);
        self.usual[joint] = usual;
    }

    /// Log likelihood ratio of a doubled error in a stretch with this RMS.
    fn ratio(&self, joint: usize, rms: f64) -> f64 {
        let square = (rms / self.usual[joint].max(f64::MIN_POSITIVE)).powi(2) / UNSEEN_RATIO;
        0.5 * self.freedom[joint] * (square * (1.0 - LOST_RATIO.powi(-2)) - 2.0 * LOST_RATIO.ln())
    }
}

/// Degrees of freedom of the mean square of a stretch, per joint, for sums over stretches; `square` is the mean of that.
fn freedom(stretches: &[Vec<f64>], square: &[f64]) -> Vec<f64> {
    let apart = |k: usize, joint: usize| stretches[k][joint].powi(2) / square[joint] - 1.0;
    let covariance = |lag: usize, joint: usize| {
        let products = (lag..stretches.len()).map(|k| apart(k, joint) * apart(k - lag, joint));
        products.sum::<f64>() / stretches.len() as f64
    };
    let variances: Vec<f64> = (0..square.len()).map(|joint| covariance(0, joint).max(f64::MIN_POSITIVE)).collect();
    let of_all = |of: &dyn Fn(usize) -> f64| (0..square.len()).map(of).sum::<f64>() / square.len() as f64;
    // In slow noise a stretch is like the one before, and their sums vary more.
    let correlation = of_all(&|joint| covariance(1, joint) / variances[joint]).max(0.0);
    let own = |variance: &f64| (RELIED_ON * 2.0 / (variance * (1.0 + 2.0 * correlation))).clamp(FREEDOM.0, FREEDOM.1);
    let own: Vec<f64> = variances.iter().map(own).collect();
    // Some tens of stretches tell little of one joint, and the others have noise of the same kind: halfway between.
    let all = of_all(&|joint| own[joint].ln()).exp();
    own.iter().map(|own| (own * all).sqrt()).collect()
}

/// RMS of measured minus modelled torque over each stretch of a motion without its ends, per joint \[Nm\].
fn stretches(model: &TorqueModel, experiment: &Experiment) -> Vec<Vec<f64>> {
    let residual = residual(model, experiment);
    let inside = inside(experiment);
    let stretch = ((STRETCH_S / experiment.motion.dt) as usize).clamp(1, inside.len().max(1));
    // The last samples count most.
    let begin = inside.start + inside.len() % stretch;
    (begin..inside.end).step_by(stretch).map(|first| rms(&residual, first..first + stretch)).collect()
}

/// Sum of log likelihood ratios that is an alarm.
fn threshold(joints: usize) -> f64 {
    (joints.max(1) as f64 * FALSE_ALARM_S / STRETCH_S).ln()
}

impl Watch {
    /// Before the first stretch.
    pub fn new(floor: Floor) -> Watch {
        let joints = floor.usual.len();
        let identified = floor.usual.clone();
        Watch {
            floor,
            identified,
            held: (0.0, vec![0.0; joints]),
            sums: vec![(0.0, 0.0); joints],
            lost: None,
            beside: None,
        }
    }

    /// What is usual: on the motions that are watched it may be more than on the one that the model was identified from.
    pub fn usual(&self) -> &Floor {
        &self.floor
    }

    /// The same, and more while nothing explains an error.
    pub fn floor(&self) -> &Floor {
        self.beside.as_ref().map_or(&self.floor, |(floor, _)| floor)
    }

    /// [`Watch::look`] under a model of which something is known to these standard deviations only \[Nm\].
    pub fn look_within(&mut self, start: f64, rms: &[f64], spread: &[f64]) -> Option<News> {
        let share = |joint: usize| self.floor.usual[joint] / self.floor.usual[joint].hypot(spread[joint]);
        let rms: Vec<f64> = (0..rms.len()).map(|joint| rms[joint] * share(joint)).collect();
        self.look(start, &rms)
    }

    /// Takes a stretch that begins at `start` \[s\] with its RMS per joint in the band \[Nm\]; returns a change of state, or another alarm beside an error
    /// that nothing explains.
    pub fn look(&mut self, start: f64, rms: &[f64]) -> Option<News> {
        let sign = if self.lost.is_some() { -1.0 } else { 1.0 };
        add(&mut self.sums, &self.floor, sign, start, rms);
        let over = threshold(self.sums.len());
        if self.lost.is_some() {
            // Every joint has to hold.
            if self.sums.iter().all(|(sum, _)| *sum > over) {
                let since = self.sums.iter().map(|(_, since)| *since).fold(f64::NEG_INFINITY, f64::max);
                self.reset();
                return Some(News::Holds { since });
            }
            let (floor, watched) = self.beside.as_mut()?;
            let sums = watched.as_mut()?;
            add(sums, floor, 1.0, start, rms);
            let news = alarm(sums, floor, rms);
            // Once, until that is explained or not.
            news.iter().for_each(|_| *watched = None);
            return news;
        }
        let news = alarm(&self.sums, &self.floor, rms);
        match news {
            Some(News::Lost { since, .. }) => {
                self.reset();
                self.lost = Some(since);
            }
            _ => self.hold(rms),
        }
        news
    }

    /// Nothing explains the error since the model was lost, which has this RMS per joint \[Nm\]: another change is looked for beside it.
    pub fn accept(&mut self, rms: &[f64]) {
        if self.lost.is_none() {
            return;
        }
        let mut floor = self.floor.clone();
        for (joint, rms) in rms.iter().enumerate() {
            let usual = rms.max(floor.usual[joint]);
            floor.set_usual(joint, usual);
        }
        self.beside = Some((floor, Some(vec![(0.0, 0.0); self.sums.len()])));
    }

    /// Another change than the unexplained one has been found: under the model with it, that one is still there.
    pub fn go_on(&mut self) {
        self.sums.fill((0.0, 0.0));
        let anew = vec![(0.0, 0.0); self.sums.len()];
        self.beside.iter_mut().for_each(|(_, sums)| *sums = Some(anew.clone()));
    }

    /// Counts a stretch without an alarm. What is usual is bounded: an error that grows by and by is an alarm in the end.
    fn hold(&mut self, rms: &[f64]) {
        let (count, sums) = &mut self.held;
        *count += 1.0;
        for (joint, sum) in sums.iter_mut().enumerate() {
            let identified = self.identified[joint].powi(2);
            *sum += rms[joint].powi(2).min(MAX_USUAL_RATIO * identified);
            let mean = (*sum + IDENTIFIED_STRETCHES * identified) / (*count + IDENTIFIED_STRETCHES);
            self.floor.set_usual(joint, mean.max(identified).sqrt());
        }
    }

    /// When the model stopped to hold, while it does not \[s\].
    pub fn lost_since(&self) -> Option<f64> {
        self.lost
    }

    /// Starts anew, under another model.
    pub fn reset(&mut self) {
        self.sums.fill((0.0, 0.0));
        (self.lost, self.beside) = (None, None);
    }
}

/// Adds the log likelihood ratios of a stretch.
fn add(sums: &mut Sums, floor: &Floor, sign: f64, start: f64, rms: &[f64]) {
    for (joint, (sum, since)) in sums.iter_mut().enumerate() {
        if *sum <= 0.0 {
            *since = start;
        }
        *sum = (*sum + sign * floor.ratio(joint, rms[joint])).max(0.0);
    }
}

/// The alarm of sums after a stretch, if they are one.
fn alarm(sums: &Sums, floor: &Floor, rms: &[f64]) -> Option<News> {
    let over = threshold(sums.len());
    let since = sums.iter().filter(|(sum, _)| *sum > over).map(|(_, since)| *since).min_by(f64::total_cmp)?;
    let above = |joint: &usize| rms[*joint] / floor.usual[*joint].max(f64::MIN_POSITIVE);
    let worst = (0..rms.len()).max_by(|a, b| above(a).total_cmp(&above(b)))?;
    Some(News::Lost { since, joint: worst, rms: rms[worst], floor: floor.usual[worst] })
}

/// Sample at which a change came, in a residual that has it at its end. `usual` is the RMS without it, `local` a number of samples: what a change does
/// may grow with the motion, so what is found is looked for again in what ends so much later, until it comes no earlier.
pub fn onset(residual: &DMatrix<f64>, usual: &[f64], local: usize) -> usize {
    let mut at = begin(residual, usual, residual.nrows() / 4);
    for _ in 0..MAX_ONSET_STEPS {
        let end = (at + local).min(residual.nrows());
        let earlier = begin(&residual.rows(0, end).into_owned(), usual, local);
        if earlier >= at {
            break;
        }
        at = earlier;
    }
    at
}

/// The sample from which on most of the square, less half of what it is in the `last` samples, adds up, in the joint where that is largest; or in the
/// first of those that are nearly as far above the usual, if more than so many samples lie between.
fn begin(residual: &DMatrix<f64>, usual: &[f64], last: usize) -> usize {
    let count = residual.nrows();
    let end = rms(residual, count.saturating_sub(last.max(1))..count);
    let over = |joint: &usize| end[*joint] / usual[*joint].max(f64::MIN_POSITIVE);
    let begins = |joint: usize| begin_in(residual, usual, joint, end[joint]);
    let Some(worst) = (0..end.len()).max_by(|a, b| over(a).total_cmp(&over(b))) else { return 0 };
    let concerned = |joint: &usize| over(joint) >= CONCERNED_RATIO * over(&worst);
    let own = begins(worst);
    (0..end.len()).filter(concerned).map(begins).filter(|begin| begin + last < own).min().unwrap_or(own)
}

fn begin_in(residual: &DMatrix<f64>, usual: &[f64], joint: usize, end: f64) -> usize {
    // The low-pass spreads a step over both sides: half of it is at the step.
    let level = (0.25 * end.powi(2)).max(LOST_RATIO * usual[joint].powi(2));
    let (mut sum, mut best) = (0.0, (0.0, residual.nrows().saturating_sub(1)));
    for k in (0..residual.nrows()).rev() {
        sum += residual[(k, joint)].powi(2).min(4.0 * level) - level;
        if sum > best.0 {
            best = (sum, k);
        }
    }
    best.1
}

/// Changes that were found, and the model with them.
#[derive(Clone, Debug)]
pub struct Remedy {
    /// The changes.
    pub changes: Vec<Change>,
    /// The model with them.
    pub model: TorqueModel,
    /// RMS per joint in the band on the samples that took no part, of the served model \[Nm\].
    pub before: Vec<f64>,
    /// The same of the model with the changes \[Nm\].
    pub after: Vec<f64>,
    /// How well the changes are known: one model for each independent direction of their parameters, with one standard deviation of them and nothing else.
    /// The squares of these models' torques add up to the variance of the torque.
    pub deviations: Vec<TorqueModel>,
}

/// What a search ended with.
#[derive(Clone, Debug)]
pub enum Found {
    /// Something that lowers the error.
    Remedy(Box<Remedy>),
    /// Nothing that does: how many changes were tried, and the error per joint \[Nm\].
    Nothing {
        /// Effects that were found but do not lower the held-out error.
        tried: usize,
        /// RMS per joint in the band of the served model \[Nm\].
        before: Vec<f64>,
    },
}

/// Searches the time since a model was lost. `find` and `judge` are two motions of it, prepared alike. `served` is the model that is served now: the
/// lost one, or one with changes from fewer samples, which then are refined. `floor` is what the lost model's errors were before. One change with which
/// they are so again is more likely than several.
pub fn search(
    lost: &TorqueModel,
    served: &TorqueModel,
    find: &Experiment,
    judge: &Experiment,
    floor: &Floor,
    settings: &Settings,
) -> Found {
    let trials = [Trial::alone(find)];
    let with = |changes: Vec<Change>| reference::extended(lost, &changes).ok().map(|model| (changes, model));
    let usual = |motion: &Experiment, model: &TorqueModel| holds(model, motion, floor, 0.0);
    let explains = |(_, model): &(Vec<Change>, TorqueModel)| usual(find, model) && usual(judge, model);
    let mut alone =
        reference::single_changes(lost, &trials, settings).into_iter().filter_map(|change| with(vec![change]));
    // What alone would not double the error is not named beside others.
    let least = |usual: &f64| (LOST_RATIO * LOST_RATIO - 1.0).sqrt() * usual;
    let seen = Settings { usual: floor.usual.iter().map(least).collect(), ..settings.clone() };
    let several = || with(reference::changes(lost, &trials, &seen, &|_| {}).effects);
    let error = |model: &TorqueModel| rms(&residual(model, judge), inside(judge));
    let (before, now) = (error(lost), error(served));
    let Some((effects, extended)) = alone.find(explains).or_else(several) else {
        return Found::Nothing { tried: 0, before: now };
    };
    let after = error(&extended);
    let worst = |rms: &[f64]| rms.iter().copied().fold(0.0, f64::max);
    let enough = (MAX_REMAINING_RATIO * worst(&before)).min(MAX_REFINED_RATIO * worst(&now));
    if effects.is_empty() || worst(&after) > enough {
        return Found::Nothing { tried: effects.len(), before: now };
    }
    let deviations = deviations(lost, &effects, &extended).unwrap_or_default();
    Found::Remedy(Box::new(Remedy { changes: effects, model: extended, before, after, deviations }))
}

/// [`Remedy::deviations`] of a model that `lost` is extended to.
fn deviations(lost: &TorqueModel, changes: &[Change], extended: &TorqueModel) -> Result<Vec<TorqueModel>, ModelError> {
    let mut found = Vec::new();
    for (which, change) in changes.iter().enumerate() {
        let Some(eigen) = symmetric_eigen(change.covariance.clone()) else { continue };
        for (variance, direction) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            let mut moved = changes.to_vec();
            let parameters = moved[which].parameters.iter_mut().zip(direction.iter());
            parameters.for_each(|(own, share)| own.value += variance.max(0.0).sqrt() * share);
            let moved = reference::extended(lost, &moved)?.beta();
            let values: Vec<(f64, Option<f64>)> =
                moved.iter().zip(extended.beta()).map(|(moved, own)| (moved - own, None)).collect();
            let (structure, mountings) = (extended.structure().clone(), extended.mountings().to_vec());
            found.push(TorqueModel::new(extended.robot(), structure, mountings, &values)?);
        }
    }
    Ok(found)
}

/// Standard deviation of a model's torque in the band over some of a motion's samples, per joint \[Nm\]: [`Remedy::deviations`].
pub fn spread(deviations: &[TorqueModel], experiment: &Experiment, samples: Range<usize>) -> Vec<f64> {
    let mut squares = vec![0.0; experiment.motion.joints()];
    for model in deviations {
        let torque = in_band(experiment, &model.predict(&experiment.motion));
        squares.iter_mut().zip(rms(&torque, samples.clone())).for_each(|(sum, rms)| *sum += rms * rms);
    }
    squares.into_iter().map(f64::sqrt).collect()
}

/// Standard deviation of the torque of parameters with a covariance over some of a motion's samples, per joint \[Nm\].
pub fn parameter_spread(
    structure: &Structure,
    covariance: &DMatrix<f64>,
    experiment: &Experiment,
    samples: Range<usize>,
) -> Vec<f64> {
    let motion = &experiment.motion;
    let step = ((SPREAD_STEP_S / motion.dt) as usize).clamp(1, samples.len().max(1));
    let part =
        |values: &DMatrix<f64>| values.rows_with_step(samples.start, samples.len() / step, step - 1).into_owned();
    let part = Motion {
        dt: step as f64 * motion.dt,
        q: part(&motion.q),
        dq: part(&motion.dq),
        ddq: part(&motion.ddq),
        periodic: false,
        ..motion.clone()
    };
    let rows = structure.regressor(&part);
    let variances: Vec<f64> =
        (&rows * covariance).row_iter().zip(rows.row_iter()).map(|(spread, row)| spread.dot(&row).max(0.0)).collect();
    // Joint by joint.
    variances.chunks(part.samples().max(1)).map(|own| (own.iter().sum::<f64>() / own.len() as f64).sqrt()).collect()
}

/// Whether a model predicts a motion with the usual errors: a watch over it would not be alarmed, and errors of the last `seconds` are nearer to the usual
/// ones than to doubled ones. False where the motion has no stretch.
pub fn holds(model: &TorqueModel, experiment: &Experiment, floor: &Floor, seconds: f64) -> bool {
    let stretches = stretches(model, experiment);
    let mut watch = Watch::new(floor.clone());
    let mut quiet = |(k, rms): (usize, &Vec<f64>)| watch.look(k as f64 * STRETCH_S, rms).is_none();
    let last = &stretches[stretches.len().saturating_sub((seconds / STRETCH_S).ceil() as usize)..];
    let ratio = |joint: usize| last.iter().map(|rms| floor.ratio(joint, rms[joint])).sum::<f64>();
    !stretches.is_empty()
        && stretches.iter().enumerate().all(&mut quiet)
        && (0..floor.usual.len()).all(|joint| ratio(joint) <= 0.0)
}

/// Sample that divides a window into the part to search and the held-out part.
pub fn divide(samples: usize) -> usize {
    ((1.0 - JUDGED_RATIO) * samples as f64) as usize
}

/// Measured minus modelled torque in the band, N x n \[Nm\].
pub fn residual(model: &TorqueModel, experiment: &Experiment) -> DMatrix<f64> {
    in_band(experiment, &(&experiment.tau - model.predict(&experiment.motion)))
}

fn in_band(experiment: &Experiment, torque: &DMatrix<f64>) -> DMatrix<f64> {
    let stacked = DMatrix::from_column_slice(torque.len(), 1, torque.as_slice());
    DMatrix::from_column_slice(torque.nrows(), torque.ncols(), experiment.filter(&stacked).as_slice())
}

/// Samples without the ends.
fn inside(experiment: &Experiment) -> Range<usize> {
    let samples = experiment.motion.samples();
    let ends = ((END_MARGIN_S / experiment.motion.dt) as usize).min(samples / 3);
    ends..samples - ends
}

/// RMS per joint over some of the samples \[Nm\].
pub fn rms(residual: &DMatrix<f64>, samples: Range<usize>) -> Vec<f64> {
    let count = samples.len().max(1) as f64;
    let part = residual.rows(samples.start, samples.len());
    part.column_iter().map(|column| (column.norm_squared() / count).sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    const JOINTS: usize = 7;

    /// RMS of stretches of noise with `freedom` degrees of freedom and this size, per joint.
    fn stretch(rng: &mut ChaCha8Rng, freedom: usize, size: f64) -> Vec<f64> {
        let square =
            |_| (0..freedom).map(|_| rng.sample::<f64, _>(StandardNormal).powi(2)).sum::<f64>() / freedom as f64;
        (0..JOINTS).map(square).map(|square: f64| size * square.sqrt()).collect()
    }

    fn watch(rng: &mut ChaCha8Rng, freedom: usize) -> Watch {
        let seen: Vec<Vec<f64>> = (0..80).map(|_| stretch(rng, freedom, 0.02)).collect();
        Watch::new(Floor::from_stretches(&seen))
    }

    #[test]
    fn degrees_of_freedom_are_those_of_sums_over_stretches() {
        let mut rng = ChaCha8Rng::seed_from_u64(10);
        let mut of = |means_of_two: bool| {
            let mut last = stretch(&mut rng, 3, 0.02);
            let mut next = |_| {
                let new = stretch(&mut rng, 3, 0.02);
                let mixed: Vec<f64> =
                    new.iter().zip(&last).map(|(new, last)| (0.5 * (new * new + last * last)).sqrt()).collect();
                last = new.clone();
                if means_of_two { mixed } else { new }
            };
            Floor::from_stretches(&(0..2000).map(&mut next).collect::<Vec<_>>()).freedom
        };
        let within = |freedom: &[f64], expected: f64| {
            assert!(freedom.iter().all(|own| (own / expected - 1.0).abs() < 0.1), "{freedom:?}, not {expected}")
        };
        within(&of(false), RELIED_ON * 3.0);
        // Means of neighbours have twice the degrees of freedom, and their sums those of the stretches themselves.
        within(&of(true), RELIED_ON * 3.0);
        // Few stretches of one joint, drawn to those of all.
        let scatter = |freedom: &[f64]| {
            let (least, most) = freedom.iter().fold((f64::MAX, 0.0f64), |(a, b), own| (a.min(*own), b.max(*own)));
            most / least
        };
        let few: Vec<Vec<f64>> = (0..30).map(|_| stretch(&mut rng, 3, 0.02)).collect();
        assert!(scatter(&Floor::from_stretches(&few).freedom) < 1.8);
    }

    #[test]
    fn a_hundred_hours_of_noise_are_at_most_ten_alarms() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        for freedom in [2, 5] {
            let mut alarms = 0;
            for _ in 0..20 {
                let mut watch = watch(&mut rng, freedom);
                // Errors of the parameters add a tenth.
                for k in 0..36_000 {
                    let rms = stretch(&mut rng, freedom, 0.022);
                    alarms += usize::from(
                        watch.look(k as f64 * STRETCH_S, &rms).is_some_and(|news| matches!(news, News::Lost { .. })),
                    );
                }
            }
            println!("{freedom} degrees of freedom: {alarms} alarms in 100 h");
            assert!(alarms <= 10, "{alarms} alarms in 100 h");
        }
    }

    #[test]
    fn a_large_error_is_an_alarm_at_once_and_a_doubled_one_in_seconds() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for (size, stretches) in [(0.5, 1), (0.08, 4), (0.05, 24)] {
            for _ in 0..50 {
                let mut watch = watch(&mut rng, 5);
                (0..100).for_each(|k| assert_eq!(watch.look(k as f64 * 0.5, &stretch(&mut rng, 5, 0.02)), None));
                let mut needed = 0;
                let news = loop {
                    let mut rms = stretch(&mut rng, 5, 0.02);
                    rms[3] = stretch(&mut rng, 5, size)[3];
                    needed += 1;
                    if let Some(news) = watch.look(50.0 + 0.5 * (needed - 1) as f64, &rms) {
                        break news;
                    }
                    assert!(needed <= stretches, "{size}");
                };
                let News::Lost { since, joint, floor, .. } = news else { panic!("{news:?}") };
                assert!(needed <= stretches && joint == 3 && (floor - 0.02).abs() < 0.01, "{news:?} after {needed}");
                assert!((since - 50.0).abs() <= 0.5 * needed as f64 && watch.lost_since() == Some(since), "{news:?}");
                // Reported once; it holds again after some seconds, and once.
                let mut again = 0;
                for k in 0..200 {
                    let rms = stretch(&mut rng, 5, if k < 40 { 0.1 } else { 0.02 });
                    match watch.look(100.0 + 0.5 * k as f64, &rms) {
                        Some(News::Holds { since }) => {
                            assert!(k >= 42 && since >= 119.0 && watch.lost_since().is_none(), "{k} {since}");
                            again += 1;
                        }
                        other => assert_eq!(other, None),
                    }
                }
                assert_eq!(again, 1);
            }
        }
    }

    #[test]
    fn another_model_starts_anew() {
        let mut watch = watch(&mut ChaCha8Rng::seed_from_u64(3), 5);
        assert!(watch.look(0.0, &[1.0; JOINTS]).is_some() && watch.lost_since().is_some());
        watch.reset();
        assert_eq!((watch.lost_since(), watch.look(2.0, &[0.01; JOINTS])), (None, None));
    }

    #[test]
    fn an_error_within_what_is_known_is_no_alarm() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        for (spread, alarms) in [(0.0, true), (0.06, false)] {
            let mut watch = watch(&mut rng, 5);
            let lost = (0..40).any(|k| {
                let rms = stretch(&mut rng, 5, 0.06);
                watch.look_within(k as f64 * STRETCH_S, &rms, &[spread; JOINTS]).is_some()
            });
            assert_eq!(lost, alarms, "known to {spread} Nm");
        }
    }

    #[test]
    fn an_error_that_was_always_there_is_usual_up_to_twice_the_identified_one() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut watch = watch(&mut rng, 5);
        let identified = watch.floor().usual[0];
        for k in 0..80 {
            assert_eq!(watch.look(k as f64 * STRETCH_S, &stretch(&mut rng, 5, 1.5 * identified)), None, "stretch {k}");
        }
        let usual = watch.usual().usual[0] / identified;
        assert!((1.3..1.6).contains(&usual), "{usual}");
        (0..1000).for_each(|_| watch.hold(&[1.0; JOINTS]));
        let usual = watch.usual().usual[0] / identified;
        assert!((1.9..=2.0).contains(&usual), "{usual}");
    }

    #[test]
    fn another_change_shows_beside_one_that_nothing_explains() {
        let mut rng = ChaCha8Rng::seed_from_u64(8);
        let mut watch = watch(&mut rng, 5);
        let mut look = |watch: &mut Watch, sizes: [f64; 2]| -> Vec<(usize, News)> {
            let news = |k: usize| {
                let mut rms = stretch(&mut rng, 5, 0.02);
                (rms[2], rms[4]) = (stretch(&mut rng, 5, sizes[0])[2], stretch(&mut rng, 5, sizes[1])[4]);
                watch.look(k as f64 * STRETCH_S, &rms).map(|news| (k, news))
            };
            (0..60).filter_map(news).collect()
        };
        assert!(matches!(look(&mut watch, [0.1, 0.02])[..], [(0..3, News::Lost { joint: 2, .. })]));
        // Nothing is new before it is known that nothing explains it.
        assert_eq!(look(&mut watch, [0.1, 0.3]), []);
        watch.accept(&[0.02, 0.02, 0.1, 0.02, 0.02, 0.02, 0.02]);
        assert_eq!(look(&mut watch, [0.1, 0.02]), []);
        let usual = (watch.usual().usual[2], watch.floor().usual[2]);
        assert!(usual.0 < 0.05 && usual.1 == 0.1, "{usual:?}");
        assert!(matches!(look(&mut watch, [0.1, 0.3])[..], [(0..3, News::Lost { joint: 4, .. })]));
        // The other change is in the model that is served now.
        watch.go_on();
        assert_eq!(look(&mut watch, [0.1, 0.02]), []);
        assert!(matches!(look(&mut watch, [0.02, 0.02])[..], [(_, News::Holds { .. })]));
        assert_eq!((watch.lost_since(), watch.floor() == watch.usual()), (None, true));
    }

    #[test]
    fn a_change_is_dated_by_the_first_joint_that_it_concerns() {
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let residual = DMatrix::from_fn(2000, 3, |k, joint| {
            let noise = 0.02 * rng.sample::<f64, _>(StandardNormal);
            // The last is worse than usual all the time.
            noise * if joint == 2 { 1.8 } else { 1.0 }
                + if k >= [900, 1300, 2000][joint] { [0.4, 0.5, 0.0][joint] } else { 0.0 }
        });
        let found = onset(&residual, &[0.02; 3], 250);
        assert!(found.abs_diff(900) <= 5, "{found}");
    }

    #[test]
    fn a_change_that_grows_is_dated_to_its_begin() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        for at in [900, 1300] {
            // A tenth of what it is at the end, from the first sample on.
            let value = |k: usize| if k < at { 0.0 } else { 0.2 + 1.8 * (k - at) as f64 / (2000 - at) as f64 };
            let residual = DMatrix::from_fn(2000, 1, |k, _| 0.02 * rng.sample::<f64, _>(StandardNormal) + value(k));
            let found = onset(&residual, &[0.02], 250);
            assert!(found.abs_diff(at) <= 100, "{found}, not {at}");
            assert!(begin(&residual, &[0.02], 500) > at + 150, "once is not enough");
        }
    }

    #[test]
    fn the_onset_is_where_the_residual_begins() {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        for size in [0.08, 0.5, 5.0] {
            for at in [300, 1200, 1700] {
                // A step of a swinging torque, after a low-pass of 0.1 s.
                let value = |k: usize| {
                    let rise = (0.5 + (k as f64 - at as f64) / 100.0).clamp(0.0, 1.0);
                    rise * size * (1.0 + 0.5 * (k as f64 * 0.006).sin())
                };
                let residual = DMatrix::from_fn(2000, 2, |k, j| {
                    0.02 * rng.sample::<f64, _>(StandardNormal) + if j == 1 { value(k) } else { 0.0 }
                });
                let found = onset(&residual, &[0.02, 0.02], 250);
                assert!(found.abs_diff(at) <= 60, "{size}: {found}, not {at}");
            }
        }
    }

    #[test]
    fn a_window_leaves_a_quarter_to_judge_by() {
        assert_eq!(divide(10_000), 7_500);
        let residual = DMatrix::from_row_slice(4, 1, &[1.0, 3.0, 3.0, 3.0]);
        assert_eq!(rms(&residual, 1..4), [3.0]);
    }
}
