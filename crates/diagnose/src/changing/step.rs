//! What comes at once within a run: a tool that is picked up, a base that is pushed, a sensor whose zero jumps.
//!
//!   tau(t) += H(t - t0) Y(q, dq, ddq) theta
//!
//! `Y` are the columns of an effect that may come suddenly, along the run's own motion, and `t0` is the time at which the likelihood is largest.

use super::record::Record;
use super::transient::Event;
use nalgebra::DMatrix;
use plumbline_identify::{Experiment, Repeats};
use plumbline_model::term::effect::Spec;

/// Rows between which the same effect comes once at most.
pub(super) const MIN_ROWS_APART: usize = 100;

/// An effect that comes within a run and stays to its end.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Name of the run.
    pub run: String,
    /// When it comes, since the first sample of the run \[s\].
    pub time: f64,
    /// Earlier than `time` where it may have come then as well: nothing tells when in what one period alone has recorded \[s\].
    pub earliest: f64,
    /// The row of its run's record.
    pub(super) row: usize,
    /// What comes.
    pub spec: Spec,
    /// Twice the gain in log likelihood.
    pub evidence: f64,
    /// Score.
    pub score: f64,
    /// RMS of what it does about the mean of the periods, per joint, in its run \[Nm\].
    pub rms: Vec<f64>,
    /// What it does, P N x n at the grid of the run's record; the mean over the periods is not taken off \[Nm\].
    pub(super) torque: DMatrix<f64>,
    /// The part of it that it does because the run's own motion is not the mean one, P N x n \[Nm\].
    pub(super) by_own_motion: DMatrix<f64>,
    /// Indices of these periods in the recording, P.
    pub(super) periods: Vec<usize>,
}

impl Step {
    /// Whether it comes with an event of a run, or less than so long before or after it \[s\].
    pub(super) fn has(&self, event: &Event, record: &Record, margin: f64) -> bool {
        let around = record.time(event.first) - margin..=record.time(event.last - 1) + margin;
        self.run == record.experiment.name && around.contains(&self.time)
    }

    /// Takes what it does off the deviations of an experiment's periods.
    pub(super) fn take_off_deviations(&self, experiment: &mut Experiment) {
        let samples = experiment.motion.samples();
        let torque = experiment.repeats.as_ref().map(|repeats| self.resampled(&self.torque, repeats, samples));
        torque.inspect(|torque| experiment.take_off_deviations(torque));
    }

    /// What it does to the mean of an experiment's periods, N x n \[Nm\]; `None` without repeats.
    pub(super) fn of_mean(&self, experiment: &Experiment) -> Option<DMatrix<f64>> {
        self.mean(&self.torque, experiment)
    }

    /// What it does to that mean and would not do along the mean motion: an arm bends under a load in the periods in which it carries it.
    pub(super) fn of_mean_by_own_motion(&self, experiment: &Experiment) -> Option<DMatrix<f64>> {
        self.mean(&self.by_own_motion, experiment)
    }

    fn mean(&self, torque: &DMatrix<f64>, experiment: &Experiment) -> Option<DMatrix<f64>> {
        let (repeats, samples) = (experiment.repeats.as_ref()?, experiment.motion.samples());
        let torque = self.resampled(torque, repeats, samples);
        let (mut mean, mut count) = (DMatrix::zeros(samples, torque.ncols()), vec![0.0; samples]);
        for row in (0..torque.nrows()).filter(|&row| repeats.counted[row]) {
            let mut mean = mean.row_mut(row % samples);
            mean += torque.row(row);
            count[row % samples] += 1.0;
        }
        mean.row_iter_mut().zip(count).for_each(|(mut mean, count)| mean /= f64::max(count, 1.0));
        Some(mean)
    }

    fn resampled(&self, torque: &DMatrix<f64>, repeats: &Repeats, samples: usize) -> DMatrix<f64> {
        let own = torque.nrows() / self.periods.len();
        let step = samples / own;
        let period = |row: usize| self.periods.iter().position(|period| *period == repeats.periods[row / samples]);
        DMatrix::from_fn(repeats.tau.nrows(), repeats.tau.ncols(), |row, joint| {
            period(row).map_or(0.0, |period| torque[(period * own + (row % samples) / step, joint)])
        })
    }
}
