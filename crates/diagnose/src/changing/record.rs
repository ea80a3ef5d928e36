//! The periods of one run on a grid that is as fine as slow effects need, and what is taken off them.

use super::EVENT_MARGIN_S;
use super::once::MAX_PERIODS;
use crate::fold::Cosines;
use nalgebra::DMatrix;
use plumbline_identify::signal::time_to_nearest;
use plumbline_identify::{ExcludedSpan, Experiment, Repeats};
use plumbline_model::term::Motion;
use std::f64::consts::PI;
use std::ops::Range;

/// Samples of the grid are means over at most this time \[s\].
const MAX_BLOCK_S: f64 = 0.01;
/// A joint that is slower for a while stands \[rad/s\],
const STANDING_SPEED: f64 = 0.01;
/// for this long \[s\].
const STANDING_S: f64 = 0.3;
/// Time over which a signal fades out before samples that don't count \[s\].
const FADE_S: f64 = 0.5;

/// Most samples of a motion in one of the grid.
pub(super) fn max_step(motion: &Motion) -> usize {
    (MAX_BLOCK_S / motion.dt * 1.001).floor().max(1.0) as usize
}

/// A motion on the grid.
pub(super) fn on_grid(of: &Motion, step: usize) -> Motion {
    let [q, dq, ddq] = [&of.q, &of.dq, &of.ddq].map(|x| blocks(x, step));
    Motion { dt: of.dt * step as f64, q, dq, ddq, ..of.clone() }
}

/// One run.
pub(super) struct Record<'a> {
    /// The run.
    pub experiment: &'a Experiment,
    /// Its periods' deviations at the full rate.
    pub repeats: &'a Repeats,
    /// Samples of the full rate in one of the grid.
    pub step: usize,
    /// Its begin, since that of the first run \[s\].
    pub start: f64,
    /// Time between samples \[s\].
    pub dt: f64,
    /// Samples of a period, N.
    pub samples: usize,
    /// The mean motion.
    pub motion: Motion,
    /// The motion of every period by itself, P N rows; of two the mean one, for no event is told from the rest there, and a body would explain what an
    /// arm does that gives way.
    pub own: Motion,
    /// Deviations of the torques from their mean, P N x n \[Nm\].
    pub tau: DMatrix<f64>,
    /// Samples that are not in the mean, P N.
    pub uncounted: Vec<bool>,
    /// Samples that don't count, those and events, P N.
    pub masked: Vec<bool>,
    /// Samples of the period at which a joint stands, N for each joint: friction holds any torque there, another one in every period.
    pub standing: Vec<Vec<bool>>,
    /// Weights with which each joint fades out before samples that don't count and in after them, P N.
    fades: Vec<Vec<f64>>,
    cosines: Cosines,
}

impl Record<'_> {
    /// Of a run whose periods were kept, and its begin since that of the first run \[s\]; `None` without repeats.
    pub fn of(experiment: &Experiment, start: f64) -> Option<Record<'_>> {
        let repeats = experiment.repeats.as_ref()?;
        let all = experiment.motion.samples();
        let most = max_step(&experiment.motion);
        let step = (1..=most).rev().find(|step| all.is_multiple_of(*step)).unwrap_or(1);
        let mut own = on_grid(&experiment.own_motion()?, step);
        let tau = blocks(&repeats.tau, step);
        let mut uncounted: Vec<bool> = repeats.counted.chunks_exact(step).map(|rows| rows.contains(&false)).collect();
        // Where something came, the mean of the recorded periods ends elsewhere than it begins, and its accelerations have a blow there. Within the run
        // the deviations have the opposite one.
        let (ends, rows) = ((EVENT_MARGIN_S / own.dt) as usize, uncounted.len());
        uncounted[..ends.min(rows)].fill(true);
        uncounted[rows.saturating_sub(ends)..].fill(true);
        let mean = |x: &DMatrix<f64>| mean_of_periods(x, &uncounted, all / step);
        let motion =
            Motion { q: mean(&own.q), dq: mean(&own.dq), ddq: mean(&own.ddq), ..on_grid(&experiment.motion, step) };
        if tau.nrows() <= MAX_PERIODS * motion.samples() {
            let repeated =
                |x: &DMatrix<f64>| DMatrix::from_fn(tau.nrows(), x.ncols(), |row, j| x[(row % x.nrows(), j)]);
            own = Motion { q: repeated(&motion.q), dq: repeated(&motion.dq), ddq: repeated(&motion.ddq), ..own };
        }
        let masked = uncounted.clone();
        let mut record = Record {
            experiment,
            repeats,
            step,
            start,
            dt: motion.dt,
            samples: all / step,
            standing: standing(&motion),
            cosines: Cosines::new(tau.nrows()),
            motion,
            own,
            tau,
            uncounted,
            masked: Vec::new(),
            fades: Vec::new(),
        };
        record.mask(masked);
        Some(record)
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.tau.ncols()
    }

    /// Number of periods, P.
    pub fn periods(&self) -> usize {
        self.tau.nrows() / self.samples
    }

    /// Time of a row since the first sample of the run \[s\], in the middle of its block.
    pub fn time(&self, row: usize) -> f64 {
        let before = self.experiment.timeline.before_periods();
        before + self.since_begin(self.repeats.periods[row / self.samples] * self.samples + row % self.samples)
    }

    /// The same of a row where all periods of the run are counted.
    pub fn since_begin(&self, row: usize) -> f64 {
        let middle = (self.step - 1) as f64 / (2.0 * self.step as f64);
        (row as f64 + middle) * self.dt
    }

    /// Whether at all of these rows more periods count than could disagree.
    pub fn has_majority(&self, rows: Range<usize>) -> bool {
        self.has_periods(rows, MAX_PERIODS + 1)
    }

    /// Whether at all of these rows so many periods count.
    pub fn has_periods(&self, mut rows: Range<usize>, least: usize) -> bool {
        let counted = |row: usize| {
            (row % self.samples..self.uncounted.len()).step_by(self.samples).filter(|&row| !self.uncounted[row]).count()
        };
        rows.all(|row| counted(row) >= least)
    }

    /// Number of these rows that count.
    pub fn counted(&self, rows: Range<usize>) -> usize {
        self.uncounted[rows].iter().filter(|uncounted| !**uncounted).count()
    }

    /// Whether a sample shows nothing of a joint's torque: it is not in the mean, or the joint stands and its friction holds any torque.
    pub fn hides(&self, row: usize, joint: usize) -> bool {
        self.uncounted[row] || self.standing[joint][row % self.samples]
    }

    /// Lets these samples not count; whether that changes anything.
    pub fn mask(&mut self, masked: Vec<bool>) -> bool {
        if self.masked == masked {
            return false;
        }
        let fade = |standing: &Vec<bool>| {
            let out = |row: usize| masked[row] || standing[row % self.samples];
            fade(masked.len(), self.dt, out)
        };
        self.fades = self.standing.iter().map(fade).collect();
        self.masked = masked;
        true
    }

    /// Whether each row is in one of these stretches of the run.
    pub fn rows_in(&self, spans: &[ExcludedSpan]) -> Vec<bool> {
        let inside = |row: usize| spans.iter().any(|span| (span.from..span.to).contains(&self.time(row)));
        (0..self.masked.len()).map(inside).collect()
    }

    /// A signal, P N x n, behind a low-pass with a window (Hann) of this length \[s\]; samples that are not in the mean have no part in it.
    pub fn smoothed(&self, x: &DMatrix<f64>, seconds: f64) -> DMatrix<f64> {
        let half = (0.5 * seconds / self.dt).round() as isize;
        let weight = |k: isize| (0.5 * PI * k as f64 / (half + 1) as f64).cos().powi(2);
        let weights: Vec<f64> = (-half..=half).map(weight).collect();
        let rows = x.nrows() as isize;
        let mut out = DMatrix::zeros(x.nrows(), x.ncols());
        for row in 0..rows {
            let mut sum = 0.0;
            for (weight, other) in weights.iter().zip(row - half..=row + half) {
                if (0..rows).contains(&other) && !self.uncounted[other as usize] {
                    sum += weight;
                    for joint in 0..x.ncols() {
                        out[(row as usize, joint)] += weight * x[(other as usize, joint)];
                    }
                }
            }
            if sum > 0.0 {
                out.row_mut(row as usize).unscale_mut(sum);
            }
        }
        out
    }

    /// Whether nothing counts from one row up to another.
    pub fn masked_between(&self, one: usize, other: usize) -> bool {
        self.masked[one.min(other)..one.max(other)].iter().all(|masked| *masked)
    }

    /// Coefficients of a joint's signal up to a frequency, of the cosines over the whole run, which has no step where a period ends. The signal fades out
    /// before samples that don't count: slow noise that is cut off has all frequencies.
    pub fn coefficients(&self, joint: usize, x: &[f64], highest: f64) -> Vec<f64> {
        let faded: Vec<f64> = x.iter().zip(&self.fades[joint]).map(|(x, weight)| x * weight).collect();
        let mut rows = vec![0.0; self.coefficient_count(highest)];
        self.cosines.transform(&faded, &mut rows);
        rows
    }

    /// Number of the coefficients up to a frequency \[Hz\].
    pub fn coefficient_count(&self, highest: f64) -> usize {
        let rows = self.tau.nrows();
        ((2.0 * highest * rows as f64 * self.dt) as usize + 1).min(rows)
    }

    /// Independent numbers in one coefficient of the deviations: less than one by what the mean over the periods and the fades take.
    pub fn freedom(&self, joint: usize) -> f64 {
        let fades = &self.fades[joint];
        let free = |k: usize| {
            let rows = (k..fades.len()).step_by(self.samples);
            let count = rows.clone().filter(|&row| !self.masked[row]).count();
            let squares: f64 = rows.map(|row| fades[row] * fades[row]).sum();
            squares * (1.0 - 1.0 / count.max(1) as f64)
        };
        (0..self.samples).map(free).sum::<f64>() / fades.len() as f64
    }

    /// Samples that are not in the mean or in one of these events.
    pub fn without(&self, events: &[bool]) -> Vec<bool> {
        either(&self.uncounted, events)
    }

    /// Takes the mean over the periods off a signal, P N, without what is masked; that becomes zero.
    pub fn centre(&self, x: &mut [f64]) {
        for k in 0..self.samples {
            let rows = (k..x.len()).step_by(self.samples);
            let counted = rows.clone().filter(|&row| !self.masked[row]);
            let (sum, count) = counted.fold((0.0, 0.0), |(sum, count), row| (sum + x[row], count + 1.0));
            let mean = sum / f64::max(count, 1.0);
            rows.for_each(|row| x[row] = if self.masked[row] { 0.0 } else { x[row] - mean });
        }
    }

    /// [`Record::centre`] of every joint, P N x n.
    pub fn centred_all(&self, mut x: DMatrix<f64>) -> DMatrix<f64> {
        let rows = x.nrows();
        x.as_mut_slice().chunks_mut(rows).for_each(|column| self.centre(column));
        x
    }

    /// Deviations of one joint as [`Record::centre`] leaves them.
    pub fn centred(&self, joint: usize) -> Vec<f64> {
        let mut x = self.tau.column(joint).iter().copied().collect::<Vec<f64>>();
        self.centre(&mut x);
        x
    }
}

/// Samples that are in one of the two masks.
pub(super) fn either(one: &[bool], other: &[bool]) -> Vec<bool> {
    one.iter().zip(other).map(|(one, other)| *one || *other).collect()
}

/// Samples at which each joint stands, N for each joint; turning points are shorter.
fn standing(motion: &Motion) -> Vec<Vec<bool>> {
    let least = (STANDING_S / motion.dt).ceil() as usize;
    let of_joint = |speeds: &[f64]| {
        let slow: Vec<bool> = speeds.iter().map(|speed| speed.abs() < STANDING_SPEED).collect();
        let mut stands = vec![false; slow.len()];
        for (first, last) in stretches(&slow) {
            if last - first >= least {
                stands[first..last].fill(true);
            }
        }
        stands
    };
    motion.dq.as_slice().chunks(motion.samples()).map(of_joint).collect()
}

/// Weights of samples, 0 where they are out, 1 far from there, with a smooth rise between.
fn fade(rows: usize, dt: f64, out: impl Fn(usize) -> bool) -> Vec<f64> {
    let smooth = |x: f64| x * x * (3.0 - 2.0 * x);
    time_to_nearest(rows, dt, false, out).into_iter().map(|time| smooth((time / FADE_S).min(1.0))).collect()
}

/// Every period minus the median of all, P N.
pub(super) fn from_median(mut x: Vec<f64>, samples: usize) -> Vec<f64> {
    let mut values = Vec::new();
    for k in 0..samples {
        values.clear();
        values.extend(x[k..].iter().step_by(samples));
        let middle = median(&mut values);
        x[k..].iter_mut().step_by(samples).for_each(|value| *value -= middle);
    }
    x
}

/// Stretches of true values, as first and one after last.
pub(super) fn stretches(flags: &[bool]) -> Vec<(usize, usize)> {
    let mut found = Vec::new();
    let mut start = None;
    for (k, &flag) in flags.iter().chain([&false]).enumerate() {
        match (start, flag) {
            (None, true) => start = Some(k),
            (Some(first), false) => {
                found.push((first, k));
                start = None;
            }
            _ => {}
        }
    }
    found
}

/// Median; of an even number of values the mean of the middle two. Changes their order.
pub(super) fn median(values: &mut [f64]) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let half = values.len() / 2;
    let even = values.len().is_multiple_of(2);
    let (below, &mut upper, _) = values.select_nth_unstable_by(half, f64::total_cmp);
    if even { 0.5 * (upper + below.iter().copied().fold(f64::NEG_INFINITY, f64::max)) } else { upper }
}

/// Median and median distance from it.
pub(super) fn spread(values: &[f64]) -> (f64, f64) {
    let middle = median(&mut values.to_vec());
    (middle, median(&mut values.iter().map(|value| (value - middle).abs()).collect::<Vec<_>>()))
}

/// Mean over the periods that count at each of `samples`; over all where none does.
pub(super) fn mean_of_periods(x: &DMatrix<f64>, uncounted: &[bool], samples: usize) -> DMatrix<f64> {
    DMatrix::from_fn(samples, x.ncols(), |k, j| {
        let all = (k..x.nrows()).step_by(samples);
        let mut rows: Vec<usize> = all.clone().filter(|&row| !uncounted[row]).collect();
        if rows.is_empty() {
            rows.extend(all);
        }
        rows.iter().map(|&row| x[(row, j)]).sum::<f64>() / rows.len() as f64
    })
}

/// Means of `step` rows each.
pub(super) fn blocks(x: &DMatrix<f64>, step: usize) -> DMatrix<f64> {
    let mean = |k: usize, j: usize| x.view((k * step, j), (step, 1)).sum() / step as f64;
    DMatrix::from_fn(x.nrows() / step, x.ncols(), mean)
}
