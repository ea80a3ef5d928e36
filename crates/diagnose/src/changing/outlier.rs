//! Single samples that are off, and stamps and rows that came twice.

use super::record::{from_median, spread};
use nalgebra::DMatrix;
use plumbline_identify::{ExcludedSpan, Experiment, Repeats};

/// Robust standard deviations that make an outlier.
const MIN_DEVIATIONS: f64 = 6.5;
/// Least outlier of a position in steps of its encoder: a period that differs by one step is not off.
const MIN_STEPS: f64 = 2.5;
/// Samples on either side of the running median.
const MEDIAN_SAMPLES: usize = 2;
/// Samples left out on either side of an outlier.
const MARGIN_SAMPLES: usize = 4;
/// Stretches of more samples than this are no single samples.
const MAX_OUTLIER_SAMPLES: usize = 3;

/// What is wrong with single samples of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hygiene {
    /// Name of the run.
    pub run: String,
    /// Torque samples that are off, per joint.
    pub torques: Vec<usize>,
    /// Position samples that are off, per joint.
    pub positions: Vec<usize>,
    /// Rows whose time stamp did not advance.
    pub repeated_stamps: usize,
    /// Rows that repeat the one before.
    pub repeated_rows: usize,
    /// Samples that were missing.
    pub missing: usize,
}

/// Counts them, and says what should be left out for them. `masked` are samples at the full rate, period below period, in which more happens than single samples.
pub(super) fn hygiene(experiment: &Experiment, masked: &[bool]) -> (Hygiene, Vec<ExcludedSpan>) {
    let sampling = &experiment.sampling;
    let mut found = Hygiene {
        run: experiment.name.clone(),
        repeated_stamps: sampling.repeated_stamps,
        repeated_rows: sampling.repeated_rows,
        missing: sampling.missing,
        torques: experiment.replaced.clone(),
        ..Hygiene::default()
    };
    let Some(repeats) = experiment.repeats.as_ref().filter(|repeats| repeats.periods.len() >= super::LEAST_PERIODS)
    else {
        return (found, Vec::new());
    };
    let samples = experiment.motion.samples();
    let mut spoiled = vec![false; repeats.tau.nrows()];
    let mut count = |values: &DMatrix<f64>, resolution: &[f64]| -> Vec<usize> {
        let of_joint = |(joint, column): (usize, &[f64])| {
            let step = resolution.get(joint).copied().unwrap_or(0.0);
            let rows = outliers(column, samples, masked, MIN_STEPS * step);
            for row in &rows {
                let last = (row + MARGIN_SAMPLES + 1).min(spoiled.len());
                spoiled[row.saturating_sub(MARGIN_SAMPLES)..last].fill(true);
            }
            rows.len()
        };
        values.as_slice().chunks(values.nrows()).enumerate().map(of_joint).collect()
    };
    for (sum, count) in found.torques.iter_mut().zip(count(&repeats.tau, &[])) {
        *sum += count;
    }
    found.positions = count(&repeats.q, &experiment.resolution);
    (found, left_out(experiment, repeats, &spoiled, samples))
}

/// Rows of a column of deviations that stick out of their neighbours, and of the same samples of the other periods, by more than `least`.
fn outliers(column: &[f64], samples: usize, masked: &[bool], least: f64) -> Vec<usize> {
    let x = from_median(column.to_vec(), samples);
    let (mut high, mut rough) = (vec![0.0; x.len()], vec![0.0; x.len()]);
    for row in MEDIAN_SAMPLES..x.len() - MEDIAN_SAMPLES {
        let mut near: [f64; 2 * MEDIAN_SAMPLES + 1] = std::array::from_fn(|k| x[row + k - MEDIAN_SAMPLES]);
        rough[row] = x[row] - (near.iter().sum::<f64>() - x[row]) / (2 * MEDIAN_SAMPLES) as f64;
        near.sort_by(f64::total_cmp);
        high[row] = x[row] - near[MEDIAN_SAMPLES];
    }
    // The difference from the running median leaves the neighbours of an outlier alone, but is no Gaussian of Gaussian noise: its scale
    // comes from that from the mean of the neighbours. Of a signal with few steps the median deviation is one of them: then the largest of all
    // but a twentieth says more.
    let (_, deviation) = spread(&rough);
    let mut sizes: Vec<f64> = rough.iter().map(|value| value.abs()).collect();
    let most = sizes.len() - 1 - sizes.len() / 20;
    let (_, &mut most, _) = sizes.select_nth_unstable_by(most, f64::total_cmp);
    let scale = f64::max(1.4826 * deviation, most / 1.96);
    let spread = scale / (1.0 + 1.0 / (2 * MEDIAN_SAMPLES) as f64).sqrt();
    let least = least.max(MIN_DEVIATIONS * spread);
    let sticks = |(row, value): (usize, &f64)| spread > 0.0 && value.abs() > least && !masked[row];
    let sticks: Vec<bool> = high.iter().enumerate().map(sticks).collect();
    let single =
        super::record::stretches(&sticks).into_iter().filter(|(first, last)| last - first <= MAX_OUTLIER_SAMPLES);
    single.flat_map(|(first, last)| first..last).collect()
}

/// Stretches of spoiled rows in the run's own time.
fn left_out(experiment: &Experiment, repeats: &Repeats, spoiled: &[bool], samples: usize) -> Vec<ExcludedSpan> {
    let dt = experiment.motion.dt;
    let mut found = Vec::new();
    for (period, rows) in repeats.periods.iter().zip(spoiled.chunks(samples)) {
        for (first, last) in super::record::stretches(rows) {
            let time = |row: usize| (period * samples + row) as f64 * dt;
            found.push(ExcludedSpan { run: experiment.name.clone(), from: time(first), to: time(last) });
        }
    }
    found
}
