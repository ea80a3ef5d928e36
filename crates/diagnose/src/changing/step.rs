//! What comes at once within a run: a tool that is picked up, a base that is pushed, a sensor whose zero jumps.
//!
//!   tau(t) += H(t - t0) Y(q, dq, ddq) theta
//!
//! `Y` are the columns of an effect that may come suddenly, along the mean motion, and `t0` is the time at which the likelihood is largest.

use super::record::Record;
use crate::library::{specs, sudden};
use nalgebra::{DMatrix, DVector};
use plumbline_core::parallel;
use plumbline_identify::Repeats;
use plumbline_model::term::effect::{OperatingPoint, Spec};

/// A step is sought no nearer to the ends of a run \[s\].
const MARGIN_S: f64 = 0.5;
/// Times apart at which it is sought first \[s\].
const COARSE_S: f64 = 0.1;
/// Rows between which the same effect comes once at most.
pub(super) const MIN_ROWS_APART: usize = 100;
/// Columns count from this share of the largest on.
const LEAST_COLUMN_RATIO: f64 = 1e-9;

/// An effect that comes within a run and stays to its end.
#[derive(Clone, Debug, PartialEq)]
pub struct Step {
    /// Name of the run.
    pub run: String,
    /// When it comes, since the first sample of the run \[s\].
    pub time: f64,
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
    /// Indices of these periods in the recording, P.
    pub(super) periods: Vec<usize>,
}

impl Step {
    /// What it does to the deviations of an experiment's periods, at its own samples \[Nm\].
    pub(super) fn at_the_samples_of(&self, repeats: &Repeats, samples: usize) -> DMatrix<f64> {
        let own = self.torque.nrows() / self.periods.len();
        let step = samples / own;
        let period = |row: usize| self.periods.iter().position(|period| *period == repeats.periods[row / samples]);
        DMatrix::from_fn(repeats.tau.nrows(), repeats.tau.ncols(), |row, joint| {
            period(row).map_or(0.0, |period| self.torque[(period * own + (row % samples) / step, joint)])
        })
    }
}

/// An effect that may come, with its columns in one run.
#[derive(Clone, Debug)]
pub(super) struct Coming {
    /// Which run.
    pub run: usize,
    /// What.
    pub spec: Spec,
    /// Number of columns.
    pub width: usize,
    /// Joint and columns over one period, N x width.
    pub columns: Vec<(usize, DMatrix<f64>)>,
    /// The same without samples at which the joint stands.
    moving: Vec<(usize, DMatrix<f64>)>,
}

/// Every effect that may come suddenly, at every site, in every run.
pub(super) fn coming(records: &[Record], operating_point: &OperatingPoint) -> Vec<Coming> {
    let specs = specs(&sudden(), operating_point.chain.len(), |_, _| true);
    let each = specs.iter().flat_map(|spec| (0..records.len()).map(move |run| (run, spec.clone())));
    each.filter_map(|(run, spec)| Coming::of(run, &records[run], spec, operating_point)).collect()
}

impl Coming {
    fn of(run: usize, record: &Record, spec: Spec, operating_point: &OperatingPoint) -> Option<Coming> {
        let term = spec.build(operating_point).ok()?;
        let width = term.columns().len();
        let (samples, joints) = (record.samples, record.joints());
        let mut y = DMatrix::zeros(samples * joints, width);
        term.fill(&operating_point.chain, &record.motion, &mut y, 0);
        // Directions that the motion does not excite have no columns of their own.
        let y = independent(y)?;
        let part = |joint: usize| (joint, y.rows(joint * samples, samples).into_owned());
        let columns: Vec<(usize, DMatrix<f64>)> =
            (0..joints).map(part).filter(|(_, part)| part.iter().any(|value| *value != 0.0)).collect();
        let mut moving = columns.clone();
        for (joint, part) in &mut moving {
            let stands = record.standing[*joint].iter().enumerate().filter(|(_, stands)| **stands);
            stands.for_each(|(k, _)| part.row_mut(k).fill(0.0));
        }
        Some(Coming { run, spec, width: y.ncols(), columns, moving })
    }

    /// Row of the run at which a step explains most of `rest`, the centred deviations of each joint in this run weighed by `weights`.
    pub fn best_row(&self, record: &Record, rest: &[Vec<f64>], weights: &[f64]) -> Option<usize> {
        let margin = (MARGIN_S / record.dt).ceil() as usize;
        let rows = record.tau.nrows();
        if rows <= 2 * margin {
            return None;
        }
        let coarse = ((COARSE_S / record.dt).round() as usize).max(1);
        let gains = self.gains(record, rest, weights, margin..rows - margin, coarse);
        let (row, _) = gains.into_iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let near = row.saturating_sub(coarse).max(margin)..(row + coarse + 1).min(rows - margin);
        self.gains(record, rest, weights, near, 1).into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(row, _)| row)
    }

    /// Squares that a step at some rows explains: `b' G^-1 b` with
    ///
    ///   G = sum_k P s_k (1 - s_k) c_k c_k',   b = sum_(row >= r) c_k d_row
    ///
    /// `c_k` the columns at sample k of the period, `s_k` the share of the P periods in which k comes at or after row r, `d` the deviations.
    fn gains(
        &self,
        record: &Record,
        rest: &[Vec<f64>],
        weights: &[f64],
        rows: std::ops::Range<usize>,
        every: usize,
    ) -> Vec<(usize, f64)> {
        let (samples, periods, width) = (record.samples, record.periods(), self.width);
        let square = |upto: usize| {
            let mut sum = DMatrix::zeros(width, width);
            for (joint, columns) in &self.moving {
                let part = columns.rows(0, upto);
                sum += part.tr_mul(&part) * weights[*joint];
            }
            sum
        };
        let project = |from: usize, to: usize, b: &mut DVector<f64>| {
            for (joint, columns) in &self.moving {
                for row in from..to {
                    let value = weights[*joint] * rest[*joint][row];
                    for c in 0..width {
                        b[c] -= columns[(row % samples, c)] * value;
                    }
                }
            }
        };
        let whole = square(samples);
        let ridge = 1e-9 * whole.diagonal().max();
        let mut b = DVector::zeros(width);
        project(0, rows.start, &mut b);
        let mut below = square(rows.start % samples);
        let (mut gains, mut last) = (Vec::new(), rows.start);
        for row in rows.step_by(every) {
            project(last, row, &mut b);
            for sample in last..row {
                if sample % samples == 0 {
                    below.fill(0.0);
                }
                for (joint, columns) in &self.moving {
                    let c = columns.row(sample % samples);
                    below += c.tr_mul(&c) * weights[*joint];
                }
            }
            if row.is_multiple_of(samples) {
                below.fill(0.0);
            }
            last = row;
            // Samples of the period before the row's own are after it in one period less.
            let after = periods - row / samples;
            let factor = |after: usize| after as f64 * (periods - after) as f64 / periods as f64;
            let mut g = &below * factor(after - 1) + (&whole - &below) * factor(after);
            for c in 0..width {
                g[(c, c)] += ridge;
            }
            let gain = g.cholesky().map_or(0.0, |g| b.dot(&g.solve(&b)));
            gains.push((row, gain));
        }
        gains
    }

    /// Its torque from a row of the run on, P N x n \[Nm\].
    pub fn torque(&self, record: &Record, row: usize, theta: &[f64]) -> DMatrix<f64> {
        let mut tau = DMatrix::zeros(record.tau.nrows(), record.joints());
        for (joint, columns) in self.since(record, row) {
            for (column, value) in columns.iter().zip(theta) {
                tau.column_mut(joint).iter_mut().zip(column).for_each(|(tau, column)| *tau += value * column);
            }
        }
        tau
    }

    /// Its columns from a row of the run on, as a signal of the whole run for each joint.
    pub fn since(&self, record: &Record, row: usize) -> Vec<(usize, Vec<Vec<f64>>)> {
        let column = |part: &DMatrix<f64>, c: usize| {
            let at = |k: usize| if k < row { 0.0 } else { part[(k % record.samples, c)] };
            (0..record.tau.nrows()).map(at).collect()
        };
        self.columns.iter().map(|(joint, part)| (*joint, (0..self.width).map(|c| column(part, c)).collect())).collect()
    }
}

/// An orthonormal basis of the columns; `None` where all are zero.
fn independent(y: DMatrix<f64>) -> Option<DMatrix<f64>> {
    let scale: Vec<f64> = y.column_iter().map(|column| column.norm()).collect();
    let largest = scale.iter().copied().fold(0.0, f64::max);
    let used: Vec<usize> = (0..y.ncols()).filter(|&c| scale[c] > LEAST_COLUMN_RATIO * largest).collect();
    if used.is_empty() {
        return None;
    }
    let mut y = y.select_columns(&used);
    y.column_iter_mut().for_each(|mut column| {
        column.normalize_mut();
    });
    let eigen = plumbline_core::symmetric_eigen(y.tr_mul(&y))?;
    let kept: Vec<usize> = (0..used.len()).filter(|&k| eigen.eigenvalues[k] > LEAST_COLUMN_RATIO).collect();
    Some(y * eigen.eigenvectors.select_columns(&kept))
}

/// Where each of these would come, by the deviations `rest` (joint, run, row) with the weight of each joint.
pub(super) fn times(
    coming: &[Coming],
    records: &[Record],
    rest: &[Vec<Vec<f64>>],
    weights: &[Vec<f64>],
) -> Vec<Option<usize>> {
    parallel(coming, plumbline_core::threads(), |one| {
        one.best_row(&records[one.run], &rest[one.run], &weights[one.run])
    })
}
