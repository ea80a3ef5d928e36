//! Effects that may come within a run, each with its columns and the time at which it explains most.

use super::record::Record;
use super::step::Step;
use crate::library::{specs, sudden};
use nalgebra::{DMatrix, DVector, DVectorView};
use plumbline_core::parallel;
use plumbline_model::term::Motion;
use plumbline_model::term::effect::{OperatingPoint, Spec};
use std::ops::Range;

/// A step is sought no nearer to the first and the last sample that count \[s\].
const MARGIN_S: f64 = 0.5;
/// Times apart at which it is sought first \[s\].
const COARSE_S: f64 = 0.1;
/// For so long after its begin a step acts along the run's own motion as it is \[s\],
const GIVING_WAY_S: f64 = 1.0;
/// later along the mean of so long \[s\].
const SMOOTHING_S: f64 = 0.3;
/// Columns count from this share of the largest on.
const LEAST_COLUMN_RATIO: f64 = 1e-9;

/// An effect that may come, with its columns in one run.
#[derive(Clone, Debug)]
pub(super) struct Coming {
    /// Which run.
    pub run: usize,
    /// What.
    pub spec: Spec,
    /// Number of columns.
    pub width: usize,
    /// Joint and columns along the run's own motion, P N x width: the arm gives way under a load that comes.
    own: Vec<(usize, DMatrix<f64>)>,
    /// The same where its motion deviates slowly from the mean one: it stays bent. The noise of its own accelerations is in the deviations too, and over a
    /// whole run a body would explain it.
    bent: Vec<(usize, DMatrix<f64>)>,
    /// The same along the mean motion, N x width.
    mean: Vec<(usize, DMatrix<f64>)>,
}

/// Every effect that may come suddenly, at every site, in every run.
pub(super) fn all(records: &[Record], operating_point: &OperatingPoint) -> Vec<Coming> {
    let specs = specs(&sudden(), operating_point.chain.len(), |_, _, _| true);
    let each = specs.iter().flat_map(|spec| (0..records.len()).map(move |run| (run, spec.clone())));
    each.filter_map(|(run, spec)| Coming::of(run, &records[run], spec, operating_point)).collect()
}

impl Coming {
    fn of(run: usize, record: &Record, spec: Spec, operating_point: &OperatingPoint) -> Option<Coming> {
        let term = spec.build(operating_point).ok()?;
        let along = |motion: &Motion| {
            let mut y = DMatrix::zeros(motion.samples() * record.joints(), term.columns().len());
            term.fill(&operating_point.chain, motion, &mut y, 0);
            y
        };
        // Directions that the mean motion does not excite have no columns of their own.
        let mean = along(&record.motion);
        let basis = independent(&mean)?;
        let (own, mean) = (along(&record.own) * &basis, mean * &basis);
        let (rows, samples) = (record.own.samples(), record.samples);
        let half = (SMOOTHING_S / record.dt / 2.0).round() as usize;
        let every =
            DMatrix::from_fn(own.nrows(), own.ncols(), |k, c| mean[(k / rows * samples + k % rows % samples, c)]);
        let mut bent = &own - &every;
        bent.as_mut_slice().chunks_mut(rows).for_each(|column| smooth(column, half));
        bent += every;
        let parts = |y: DMatrix<f64>| {
            let rows = y.nrows() / record.joints();
            let part = |joint: usize| (joint, y.rows(joint * rows, rows).into_owned());
            (0..record.joints()).map(part).filter(|(_, part)| part.iter().any(|value| *value != 0.0)).collect()
        };
        Some(Coming { run, spec, width: basis.ncols(), own: parts(own), bent: parts(bent), mean: parts(mean) })
    }

    /// Whether a step is of this effect.
    pub fn is_of(&self, step: &Step, record: &Record) -> bool {
        step.run == record.experiment.name && step.spec.is_same_effect(&self.spec)
    }

    /// Rows of the run at which it is sought; `None` where there are none.
    pub fn begins(&self, record: &Record) -> Option<Range<usize>> {
        let margin = (MARGIN_S / record.dt).ceil() as usize;
        let first = record.masked.iter().position(|masked| !masked)? + margin;
        let last = record.masked.iter().rposition(|masked| !masked)?.saturating_sub(margin);
        (first < last).then_some(first..last)
    }

    /// Row of the run at which a step explains most of `rest`, the centred deviations of each joint in this run weighed by `weights`.
    pub fn best_row(&self, record: &Record, rest: &[Vec<f64>], weights: &[f64]) -> Option<usize> {
        let Range { start: first, end: last } = self.begins(record)?;
        let coarse = ((COARSE_S / record.dt).round() as usize).max(1);
        let gains = self.gains(record, rest, weights, first..last, coarse);
        let (row, _) = gains.into_iter().max_by(|a, b| a.1.total_cmp(&b.1))?;
        let near = row.saturating_sub(coarse).max(first)..(row + coarse + 1).min(last);
        self.gains(record, rest, weights, near, 1).into_iter().max_by(|a, b| a.1.total_cmp(&b.1)).map(|(row, _)| row)
    }

    /// Squares that a step at some rows r explains: `b' G^-1 b` with
    ///
    ///   G = sum_(row >= r) c c' - sum_k s_k s_k' / P_k,   b = sum_(row >= r) c d
    ///
    /// `c` the columns of a row and `d` its deviation, `s_k` the sum of the columns from r on at sample k of the period, `P_k` the number of periods in
    /// which k counts.
    fn gains(
        &self,
        record: &Record,
        rest: &[Vec<f64>],
        weights: &[f64],
        rows: Range<usize>,
        every: usize,
    ) -> Vec<(usize, f64)> {
        let wanted: Vec<usize> = rows.step_by(every).collect();
        let mut counts = vec![0.0; record.samples];
        for row in (0..record.masked.len()).filter(|&row| !record.masked[row]) {
            counts[row % record.samples] += 1.0;
        }
        let mut total = vec![(DMatrix::zeros(self.width, self.width), DVector::zeros(self.width)); wanted.len()];
        for (joint, columns) in &self.own {
            let own = sums(record, *joint, columns, &rest[*joint], &counts, &wanted);
            for ((g, b), (own_g, own_b)) in total.iter_mut().zip(own) {
                *g += own_g * weights[*joint];
                *b += own_b * weights[*joint];
            }
        }
        let ridge = 1e-9 * total.first().map_or(0.0, |(g, _)| g.diagonal().max());
        let gain = |(g, b): (DMatrix<f64>, DVector<f64>)| {
            let g = g + DMatrix::identity(self.width, self.width) * ridge;
            g.cholesky().map_or(0.0, |g| b.dot(&g.solve(&b)))
        };
        wanted.into_iter().zip(total.into_iter().map(gain)).collect()
    }

    /// Its torque from a row of the run on, P N x n \[Nm\].
    pub fn torque(&self, record: &Record, row: usize, theta: &[f64]) -> DMatrix<f64> {
        sum(record, &self.since(record, row), theta)
    }

    /// What its torque would be along the mean motion.
    pub fn torque_along_mean(&self, record: &Record, row: usize, theta: &[f64]) -> DMatrix<f64> {
        sum(record, &self.since_along_mean(record, row), theta)
    }

    /// Its columns along the mean motion from a row of the run on, as a signal of the whole run for each joint.
    pub fn since_along_mean(&self, record: &Record, row: usize) -> Vec<(usize, Vec<Vec<f64>>)> {
        signals(&self.mean, record, row)
    }

    /// The same along the run's own motion.
    pub fn since(&self, record: &Record, row: usize) -> Vec<(usize, Vec<Vec<f64>>)> {
        let mut columns = signals(&self.bent, record, row);
        let settled = (row + (GIVING_WAY_S / record.dt) as usize).min(record.tau.nrows());
        for (joint, columns) in &mut columns {
            let Some((_, own)) = self.own.iter().find(|(other, _)| other == joint) else { continue };
            for (column, own) in columns.iter_mut().zip(own.column_iter()) {
                column[row..settled].copy_from_slice(&own.as_slice()[row..settled]);
            }
        }
        columns
    }
}

/// `G` and `b` of [`Coming::gains`] for one joint at rows in their order; `counts` are `P_k`.
fn sums(
    record: &Record,
    joint: usize,
    columns: &DMatrix<f64>,
    rest: &[f64],
    counts: &[f64],
    wanted: &[usize],
) -> Vec<(DMatrix<f64>, DVector<f64>)> {
    let (width, samples) = (columns.ncols(), record.samples);
    let (mut g, mut b) = (DMatrix::zeros(width, width), DVector::zeros(width));
    let mut later = DMatrix::zeros(width, samples);
    let mut sums = Vec::new();
    // From the end, where nothing has come.
    let mut row = rest.len();
    for &from in wanted.iter().rev() {
        while row > from {
            row -= 1;
            if record.masked[row] || record.standing[joint][row % samples] {
                continue;
            }
            let c = columns.row(row).transpose();
            let (mut later, share) = (later.column_mut(row % samples), 1.0 / counts[row % samples]);
            g.ger(1.0 - share, &c, &c, 1.0);
            g.ger(-share, &c, &later, 1.0);
            g.ger(-share, &later, &c, 1.0);
            b.axpy(rest[row], &c, 1.0);
            later += c;
        }
        sums.push((g.clone(), b.clone()));
    }
    sums.reverse();
    sums
}

/// Torque of signals with these parameters, P N x n.
fn sum(record: &Record, columns: &[(usize, Vec<Vec<f64>>)], theta: &[f64]) -> DMatrix<f64> {
    let mut tau = DMatrix::zeros(record.tau.nrows(), record.joints());
    for (joint, columns) in columns {
        for (column, value) in columns.iter().zip(theta) {
            tau.column_mut(*joint).iter_mut().zip(column).for_each(|(tau, column)| *tau += value * column);
        }
    }
    tau
}

/// The mean of so many samples before and after each.
fn smooth(x: &mut [f64], half: usize) {
    let sums: Vec<f64> = [0.0]
        .into_iter()
        .chain(x.iter().scan(0.0, |sum, x| {
            *sum += x;
            Some(*sum)
        }))
        .collect();
    for (k, x) in x.iter_mut().enumerate() {
        let (first, last) = (k.saturating_sub(half), (k + half + 1).min(sums.len() - 1));
        *x = (sums[last] - sums[first]) / (last - first) as f64;
    }
}

/// Columns of a run, or of each of its periods, as signals that are zero before a row.
fn signals(parts: &[(usize, DMatrix<f64>)], record: &Record, row: usize) -> Vec<(usize, Vec<Vec<f64>>)> {
    let rows = record.tau.nrows();
    let signal = |column: DVectorView<f64>| {
        let at = |k: usize| if k < row { 0.0 } else { column[k % column.len()] };
        (0..rows).map(at).collect()
    };
    parts.iter().map(|(joint, part)| (*joint, part.column_iter().map(signal).collect())).collect()
}

/// What makes an orthonormal basis of columns when they are multiplied by it; `None` where all are zero.
fn independent(y: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let scale: Vec<f64> = y.column_iter().map(|column| column.norm()).collect();
    let largest = scale.iter().copied().fold(0.0, f64::max);
    let used: Vec<usize> = (0..y.ncols()).filter(|&c| scale[c] > LEAST_COLUMN_RATIO * largest).collect();
    if used.is_empty() {
        return None;
    }
    let mut of_used = DMatrix::zeros(y.ncols(), used.len());
    used.iter().enumerate().for_each(|(k, &c)| of_used[(c, k)] = 1.0 / scale[c]);
    let normed = y * &of_used;
    let eigen = plumbline_core::symmetric_eigen(normed.tr_mul(&normed))?;
    let kept: Vec<usize> = (0..used.len()).filter(|&k| eigen.eigenvalues[k] > LEAST_COLUMN_RATIO).collect();
    Some(of_used * eigen.eigenvectors.select_columns(&kept))
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
