//! Samples of one run on an even grid: resampled, spoiled ones replaced, periods averaged.

use super::EstimateError;
use super::faults::{interpolate, spoiled};
use super::gaps::{Beside, fill};
use super::periods::{Scatter, average, centre, weights};
use super::run::Run;
use super::settings::Settings;
use super::settling::settling;
use super::signal::SignalError;
use super::signal::resample::{MAX_CURVE_S, Sampling, resample};
use nalgebra::DMatrix;

/// Time on both sides of a drop-out that tells how far the period's torques are from those of the others \[s\].
const BESIDE_S: f64 = 0.03;
/// Longest stretch of lost or replaced samples of an aperiodic run that enters the regression \[s\].
const MAX_LINE_S: f64 = 0.02;

/// Samples of a run after resampling and averaging.
pub(super) struct Even {
    /// Positions, torques and, where used, measured velocities, N x 2n or N x 3n.
    pub values: DMatrix<f64>,
    pub sampling: Sampling,
    /// Whether the run is periodic.
    pub periodic: bool,
    /// Indices of the periods that are used.
    pub periods: Vec<usize>,
    /// Weights of their samples in the mean.
    pub weights: Vec<f64>,
    /// Positions of these periods, one below the other, P N x n \[rad\].
    pub q: DMatrix<f64>,
    pub scatter: Option<Scatter>,
    pub deviations: DMatrix<f64>,
    pub counted: Vec<bool>,
    /// See [`super::Experiment::settling`].
    pub settling: f64,
    /// Samples of an aperiodic run that were lost or spoiled in stretches too long for what was put there to be the signal.
    pub long_lines: Vec<bool>,
    /// Torques that were replaced, per joint.
    pub replaced: Vec<usize>,
}

impl Even {
    /// Of a run.
    ///
    /// # Errors
    /// Samples that can't be processed; too few periods or samples.
    pub fn of(run: &Run, settings: &Settings) -> Result<Even, EstimateError> {
        let signal = |source| EstimateError::Signal { run: run.name.clone(), source };
        let n = run.joints();
        if run.tau.shape() != run.q.shape() {
            return Err(signal(SignalError::Shape { what: "tau", found: run.tau.nrows(), expected: run.q.nrows() }));
        }
        let dq = run.dq.as_ref().filter(|_| settings.measured_velocities && run.period.is_none());
        if let Some(found) = dq.map(DMatrix::nrows).filter(|&found| found != run.q.nrows()) {
            return Err(signal(SignalError::Shape { what: "dq", found, expected: run.q.nrows() }));
        }
        let mut values = DMatrix::zeros(run.q.nrows(), if dq.is_some() { 3 * n } else { 2 * n });
        values.columns_mut(0, n).copy_from(&run.q);
        values.columns_mut(n, n).copy_from(&run.tau);
        if let Some(dq) = dq {
            values.columns_mut(2 * n, n).copy_from(dq);
        }
        let spoiled = spoiled(&values, n..2 * n);
        let measured = (!spoiled.is_empty()).then(|| values.clone());
        spoiled.iter().for_each(|(column, rows)| interpolate(values.column_mut(*column).as_mut_slice(), rows));
        let mut replaced = vec![0; n];
        let mut count = |column: usize, rows: usize| {
            if let Some(replaced) = column.checked_sub(n).and_then(|joint| replaced.get_mut(joint)) {
                *replaced = rows;
            }
        };
        let mut even = resample(&run.t, &values, None).map_err(signal)?;
        let Some(period) = run.period else {
            let mut lines = even.filled.clone();
            for (column, rows) in &spoiled {
                count(*column, rows.iter().filter(|row| **row).count());
                let own = on_grid(rows, &run.t, lines.len(), even.sampling.dt);
                lines.iter_mut().zip(own).for_each(|(all, own)| *all |= own);
            }
            return Ok(Even {
                long_lines: long_stretches(lines, even.sampling.dt, MAX_LINE_S),
                values: even.values,
                sampling: even.sampling,
                periodic: false,
                periods: Vec::new(),
                weights: Vec::new(),
                q: DMatrix::zeros(0, n),
                scatter: None,
                deviations: DMatrix::zeros(0, 2 * n),
                counted: Vec::new(),
                settling: 0.0,
                replaced,
            });
        };

        // A whole number of samples per period, so that the periods are aligned.
        let samples = (period / even.sampling.dt).round();
        if !(samples >= 16.0 && samples.is_finite()) {
            return Err(EstimateError::Period { run: run.name.clone(), period, dt: even.sampling.dt });
        }
        let samples = samples as usize;
        let dt = period / samples as f64;
        if (dt - even.sampling.dt).abs() > 1e-12 {
            even = resample(&run.t, &values, Some(dt)).map_err(signal)?;
        }
        let found = even.values.nrows() / samples;
        let skipped = settings.skip_periods;
        if found <= skipped {
            return Err(EstimateError::Periods { run: run.name.clone(), found, skipped, period });
        }
        let first = skipped * samples;
        let mut rest = even.values.rows(first, (found - skipped) * samples).into_owned();
        let mut left_out = vec![false; rest.nrows()];
        settings.left_out(&run.name).for_each(|one| one.mark(&mut left_out, first, dt));
        let mut filled = even.filled[first..found * samples].to_vec();
        let settling = settling(&rest.columns(0, n).into_owned(), &left_out, samples, dt);
        left_out[..settling].fill(true);
        // What is lost for longer is no motion between its ends.
        let long = long_stretches(filled.clone(), dt, MAX_CURVE_S);
        left_out.iter_mut().zip(&long).for_each(|(left_out, long)| *left_out |= long);
        let measured = measured.map(|measured| resample(&run.t, &measured, Some(dt)).map_err(signal)).transpose()?;
        let whole = rest.nrows();
        let (mut alone, mut replaced_rows) = (vec![false; whole], filled.clone());
        for column in 0..rest.ncols() {
            let own = spoiled.iter().find(|(own, _)| *own == column).zip(measured.as_ref());
            let mut values = rest.column_mut(column);
            let Some(((_, rows), measured)) = own else {
                fill(values.as_mut_slice(), &filled, &left_out, samples, Beside::Level(1));
                continue;
            };
            let rows = &on_grid(rows, &run.t, even.values.nrows(), dt)[first..first + whole];
            replaced_rows.iter_mut().zip(rows).for_each(|(replaced, spoiled)| *replaced |= spoiled);
            let measured = measured.values.column(column);
            let measured = &measured.as_slice()[first..first + whole];
            // One sample of a torque has more noise than the mean of a period may have.
            let beside = if (n..2 * n).contains(&column) { (BESIDE_S / dt).ceil() as usize } else { 1 };
            let of_period =
                Missing { filled: &filled, spoiled: rows, left_out: &left_out, long: &long, samples, beside, dt };
            count(column, of_period.repair(values.as_mut_slice(), measured, &mut alone));
        }
        left_out.iter_mut().zip(&alone).for_each(|(left_out, alone)| *left_out |= alone);
        let mut lost: Vec<bool> = (0..whole).map(|row| long[row] || alone[row]).collect();
        // A start that is not settled does not go on from the end of the period.
        lost[0] |= settling > 0;
        let mut no_deviation = long_stretches(replaced_rows, dt, MAX_LINE_S);
        let mut unusable: Vec<bool> = (0..whole).map(|row| row < settling || lost[row]).collect();
        let mut periods: Vec<usize> = (skipped..found).collect();
        // Periods that are excluded as a whole are removed.
        let gone = left_out.chunks(samples).enumerate().filter(|(_, period)| period.iter().all(|left_out| *left_out));
        let gone: Vec<usize> = gone.map(|(k, _)| k).collect();
        for k in gone.into_iter().rev() {
            rest = rest.remove_rows(k * samples, samples);
            for rows in [&mut filled, &mut left_out, &mut unusable, &mut lost, &mut no_deviation] {
                rows.drain(k * samples..(k + 1) * samples);
            }
            periods.remove(k);
        }
        if periods.is_empty() {
            return Err(EstimateError::Periods { run: run.name.clone(), found, skipped: found, period });
        }
        let weights = weights(&left_out, &unusable, &lost, samples, dt);
        // What is left out is in the mean where nothing else is, and is not like the others.
        let mut averaged = average(&rest, &weights, &either(&filled, &left_out), samples, dt);
        // Torques that other periods stand in for have their deviation, and that of two samples on both sides, which is no noise. Positions go on, for a
        // step would be a blow in the accelerations.
        let no_deviation = either(&no_deviation, &left_out);
        if averaged.scatter.is_some() && no_deviation.contains(&true) {
            averaged.counted.iter_mut().zip(&no_deviation).for_each(|(counted, none)| *counted &= !none);
            let mut torques = averaged.deviations.columns(n, n).into_owned();
            centre(&mut torques, &averaged.counted, samples);
            averaged.deviations.columns_mut(n, n).copy_from(&torques);
        }
        Ok(Even {
            periods,
            weights,
            q: rest.columns(0, n).into_owned(),
            values: averaged.mean,
            sampling: even.sampling,
            periodic: true,
            scatter: averaged.scatter,
            deviations: averaged.deviations,
            counted: averaged.counted,
            settling: settling as f64 * dt,
            long_lines: Vec::new(),
            replaced,
        })
    }
}

/// What a column of a periodic run lacks, by rows of the even grid.
struct Missing<'a> {
    /// Lost in all columns, for a moment: they follow the motion's own curve, and are good enough for other periods.
    filled: &'a [bool],
    /// Spoiled in this column.
    spoiled: &'a [bool],
    left_out: &'a [bool],
    /// Lost in all columns, for longer.
    long: &'a [bool],
    /// Samples of a period.
    samples: usize,
    /// Samples on each side of a gap that tell how the period differs from the others.
    beside: usize,
    /// Time between them \[s\].
    dt: f64,
}

impl Missing<'_> {
    /// Puts into the column what the other periods have there, and returns how many spoiled samples that were: of stretches that are too long for a line
    /// also what others have that are left out. What every period does, and the only one, is `measured`. Marks spoiled samples as `alone` of which some other
    /// periods have a part and none has all; otherwise the line across it stays.
    fn repair(&self, values: &mut [f64], measured: &[f64], alone: &mut [bool]) -> usize {
        let Missing { filled, spoiled, left_out, long, samples, beside, dt } = *self;
        let level = Beside::Level(beside);
        let found = fill(values, &either(filled, spoiled), &either(left_out, spoiled), samples, level);
        let rows = spoiled.len();
        let others =
            |row: usize| (row % samples..rows).step_by(samples).filter(move |&other| other != row && !long[other]);
        let settled = |row: usize| others(row).any(|other| !left_out[other]);
        // A start that has not settled stands in with its motion, too; but the motion does not go on from the end of the period before into it. A gap across that
        // end follows its own ends.
        let no_line = long_stretches(spoiled.to_vec(), dt, MAX_CURVE_S);
        let joined: Vec<bool> = (0..rows).map(|row| no_line[row] && !found[row]).collect();
        let (mut open, mut first) = (vec![false; rows], 0);
        for stretch in joined.chunk_by(|a, b| a == b) {
            let own = first..first + stretch.len();
            first = own.end;
            let crosses = own.start / samples != (own.end - 1) / samples;
            open[own.clone()].fill(stretch[0] && crosses && own.into_iter().any(|row| !settled(row)));
        }
        let at_last = fill(values, &open, &either(long, spoiled), samples, Beside::Line(beside));
        let mut replaced = 0;
        for row in (0..rows).filter(|&row| spoiled[row]) {
            if found[row] || at_last[row] {
                replaced += 1;
                continue;
            }
            let any = settled(row);
            let one_has_it = others(row).any(|other| !(spoiled[other] || any && left_out[other]));
            if one_has_it && (any || no_line[row]) {
                alone[row] = true;
            } else if any || rows == samples {
                values[row] = measured[row];
            }
        }
        replaced
    }
}

/// Rows that are in one of two masks.
fn either(one: &[bool], other: &[bool]) -> Vec<bool> {
    one.iter().zip(other).map(|(one, other)| one | other).collect()
}

/// Samples of an even grid that begins at the first time stamp, from rows at uneven times \[s\], with those that were lost between two of them.
fn on_grid(rows: &[bool], t: &[f64], samples: usize, dt: f64) -> Vec<bool> {
    let mut grid = vec![false; samples];
    // The nearest sample: the others are interpolated from rows that were replaced.
    let at = |row: usize| (((t[row] - t[0]) / dt).round() as usize).min(samples - 1);
    for row in (0..rows.len()).filter(|&row| rows[row]) {
        let first = if row > 0 && rows[row - 1] { at(row - 1) } else { at(row) };
        grid[first..=at(row)].fill(true);
    }
    grid
}

/// Stretches that are longer than `most` \[s\].
fn long_stretches(mut out: Vec<bool>, dt: f64, most: f64) -> Vec<bool> {
    let least = (most / dt).ceil() as usize;
    for stretch in out.chunk_by_mut(|a, b| a == b) {
        if stretch.len() <= least {
            stretch.fill(false);
        }
    }
    out
}
