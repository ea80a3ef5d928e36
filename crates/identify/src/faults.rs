//! Samples that a sensor or a link has spoiled: spikes of single samples and torques that drop out to exactly zero. Both show in one channel
//! without any repetition of the motion.

use nalgebra::DMatrix;
use std::ops::Range;

/// Smallest height of a spike above the median of its neighbours, in standard deviations of white noise.
const MIN_SPIKE_DEVIATIONS: f64 = 20.0;
/// Smallest height in steps of the sensor.
const MIN_SPIKE_STEPS: f64 = 3.0;
/// Largest difference between the samples before and after a spike, as a share of its height; more is an edge.
const MAX_EDGE_RATIO: f64 = 0.3;
/// Samples on either side of the running median, and most samples of a spike.
const NEIGHBOURS: usize = 2;
/// Spikes in a larger share of the samples are the sensor's noise.
const MAX_SPIKES_RATIO: f64 = 2e-3;
/// Least samples of a drop-out.
const MIN_DROP_OUT_SAMPLES: usize = 5;
/// Least torque before and after a drop-out, in standard deviations of white noise.
const MIN_DROP_OUT_DEVIATIONS: f64 = 8.0;
/// Values that are nearer are the same: no sensor resolves that, and files round.
const SAME_VALUE: f64 = 1e-9;

/// Columns of `values` with spoiled samples, and their rows. Drop-outs are sought in `torques`, some of the columns.
pub(super) fn spoiled(values: &DMatrix<f64>, torques: Range<usize>) -> Vec<(usize, Vec<bool>)> {
    let mut spoiled = Vec::new();
    for (column, x) in values.as_slice().chunks(values.nrows().max(1)).enumerate() {
        // A column without two different values has nothing that stands out.
        let Some(resolution) = resolution(x) else { continue };
        let noise = noise(x);
        let mut rows = spikes(x, noise, resolution);
        if torques.contains(&column) {
            drop_outs(x, noise, resolution).into_iter().for_each(|out| rows[out].fill(true));
        }
        if rows.contains(&true) {
            spoiled.push((column, rows));
        }
    }
    spoiled
}

/// Standard deviation of white noise in a smooth signal, from its second differences.
fn noise(x: &[f64]) -> f64 {
    let mut sizes: Vec<f64> = x.windows(3).map(|w| (w[1] - 0.5 * (w[0] + w[2])).abs()).collect();
    let half = sizes.len() / 2;
    if sizes.is_empty() {
        return 0.0;
    }
    let (_, median, _) = sizes.select_nth_unstable_by(half, f64::total_cmp);
    1.4826 * *median / 1.5_f64.sqrt()
}

/// Smallest difference between two values that are not equal but for rounding; `None` where all are.
pub(super) fn resolution(x: &[f64]) -> Option<f64> {
    let mut sorted = x.to_vec();
    sorted.sort_unstable_by(f64::total_cmp);
    sorted.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > SAME_VALUE).reduce(f64::min)
}

fn spikes(x: &[f64], noise: f64, resolution: f64) -> Vec<bool> {
    let mut found = vec![false; x.len()];
    let least = (MIN_SPIKE_DEVIATIONS * noise).max(MIN_SPIKE_STEPS * resolution);
    if x.len() <= 2 * NEIGHBOURS {
        return found;
    }
    for k in NEIGHBOURS..x.len() - NEIGHBOURS {
        let mut around: [f64; 2 * NEIGHBOURS + 1] = std::array::from_fn(|m| x[k - NEIGHBOURS + m]);
        around.sort_unstable_by(f64::total_cmp);
        let height = (x[k] - around[NEIGHBOURS]).abs();
        let edge = (x[k + NEIGHBOURS] - x[k - NEIGHBOURS]).abs();
        found[k] = height > least && edge < MAX_EDGE_RATIO * height;
    }
    let count = found.iter().filter(|spike| **spike).count();
    if count as f64 > MAX_SPIKES_RATIO * x.len() as f64 {
        found.fill(false);
    }
    found
}

/// Stretches of exact zeros that a torque jumps to and back from, or whose noise would not leave it at zero.
fn drop_outs(x: &[f64], noise: f64, resolution: f64) -> Vec<Range<usize>> {
    let (least, noisy) = ((MIN_DROP_OUT_DEVIATIONS * noise).max(MIN_SPIKE_STEPS * resolution), noise > resolution);
    let mut found = Vec::new();
    let mut first = 0;
    while first < x.len() {
        let zeros = x[first..].iter().take_while(|value| **value == 0.0).count();
        let jumps = |neighbour: Option<&f64>| neighbour.is_none_or(|value| value.abs() > least);
        let before = first.checked_sub(1).and_then(|row| x.get(row));
        let inside = zeros < x.len() && (noisy || jumps(before) && jumps(x.get(first + zeros)));
        if zeros >= MIN_DROP_OUT_SAMPLES && inside {
            found.push(first..first + zeros);
        }
        first += zeros.max(1);
    }
    found
}

/// A straight line across the rows that are `out`; at the ends the nearest value.
pub(super) fn interpolate(x: &mut [f64], out: &[bool]) {
    let mut row = 0;
    while row < x.len() {
        if !out[row] {
            row += 1;
            continue;
        }
        let end = (row..x.len()).find(|&k| !out[k]).unwrap_or(x.len());
        let before = row.checked_sub(1).map(|k| x[k]);
        let after = x.get(end).copied();
        let (Some(left), Some(right)) = (before.or(after), after.or(before)) else { return };
        let length = (end - row + 1) as f64;
        for (k, value) in x[row..end].iter_mut().enumerate() {
            *value = left + (right - left) * (k + 1) as f64 / length;
        }
        row = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Replaces spoiled samples, and returns them.
    fn replace_spoiled(values: &mut DMatrix<f64>, torques: Range<usize>) -> Vec<(usize, Vec<bool>)> {
        let spoiled = spoiled(values, torques);
        spoiled.iter().for_each(|(column, rows)| interpolate(values.column_mut(*column).as_mut_slice(), rows));
        spoiled
    }

    /// A swinging torque with a step of friction where it turns back, and noise.
    fn torque() -> Vec<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let at = |k: usize| {
            let angle = 0.01 * k as f64;
            8.0 * angle.sin() + 2.0 * (50.0 * angle.cos()).tanh() + rng.random_range(-0.05..0.05)
        };
        (0..4000).map(at).collect()
    }

    #[test]
    fn spikes_and_drop_outs_are_replaced_and_edges_are_not() {
        let clean = torque();
        let mut values = DMatrix::from_column_slice(4000, 1, &clean);
        assert!(replace_spoiled(&mut values, 0..1).is_empty());
        assert_eq!(values.as_slice(), clean);
        let mut bad = clean.clone();
        bad[700] += 15.0;
        bad[701] += 12.0;
        bad[1400..1600].fill(0.0);
        let mut values = DMatrix::from_column_slice(4000, 1, &bad);
        let spoiled = replace_spoiled(&mut values, 0..1);
        let rows: Vec<usize> = (0..4000).filter(|&row| spoiled[0].1[row]).collect();
        assert_eq!(rows, [700, 701].into_iter().chain(1400..1600).collect::<Vec<_>>());
        assert!((values[700] - clean[700]).abs() < 0.3 && (values[1400] - clean[1399]).abs() < 0.3);
        // Coarse values are zero where the torque crosses zero.
        let coarse = clean.iter().map(|value| (value / 0.4).round() * 0.4).collect::<Vec<f64>>();
        assert!(coarse[905..930].windows(MIN_DROP_OUT_SAMPLES).any(|zeros| zeros == [0.0; MIN_DROP_OUT_SAMPLES]));
        assert!(replace_spoiled(&mut DMatrix::from_column_slice(4000, 1, &coarse), 0..1).is_empty());
        // A position that is zero for a while stands.
        let mut still = DMatrix::from_column_slice(4000, 1, &bad);
        assert!(!replace_spoiled(&mut still, 1..2)[0].1[1500]);
    }
}
