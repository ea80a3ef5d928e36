//! Start of a periodic run: samples before the motion repeats.
//!
//! An arm that starts from standstill needs a second or so until its controller follows the motion as in every later period. The mean
//! period must not contain that: the torque of a mean of different motions is not the torque of the mean motion.

use nalgebra::DMatrix;
use std::ops::Range;

/// Length of a window \[s\].
const WINDOW_S: f64 = 0.1;
/// Least samples in it.
const MIN_WINDOW_SAMPLES: usize = 8;
/// Ratio to the usual mean square of a window above which the first period deviates.
const MIN_ENERGY_RATIO: f64 = 9.0;
/// Least mean square of a window that counts \[rad2\]: rounding of the stored positions is less.
const MIN_ENERGY: f64 = 1e-18;
/// Windows below that ratio after which the motion has settled.
const SETTLED_WINDOWS: usize = 3;

/// A start that lasts for more windows has to decay meanwhile: what does not came or went within the period.
const MIN_DECAY_WINDOWS: usize = 5;
/// Limits of the largest ratio of the mean square of its last third to that before: a strong one decays more than a weak one before it is over.
const DECAYED_RATIOS: [f64; 2] = [0.2, 0.5];

/// Samples at the start of the first period in which its positions differ from those of the other periods by more than periods differ
/// usually. `q`, P N x n \[rad\], `dt` apart \[s\]; samples with `left_out` set are ignored. 0 for a single period.
pub fn settling(q: &DMatrix<f64>, left_out: &[bool], samples: usize, dt: f64) -> usize {
    let periods = q.nrows() / samples;
    if periods < 2 {
        return 0;
    }
    let window = ((WINDOW_S / dt).round() as usize).max(MIN_WINDOW_SAMPLES);
    let of_joint = |q: &[f64]| ratios(q, left_out, samples, window);
    let joints: Vec<Vec<Option<f64>>> = q.column_iter().map(|column| of_joint(column.as_slice())).collect();
    let end = joints.iter().map(|ratios| end_of_start(ratios)).max().unwrap_or(0);
    // Nothing where too few samples tell.
    let mean = |windows: Range<usize>| -> Option<f64> {
        let of = |ratios: &Vec<Option<f64>>| ratios[windows.clone()].iter().copied().sum::<Option<f64>>();
        Some(joints.iter().map(of).sum::<Option<f64>>()? / windows.len() as f64)
    };
    // Half of the steps, on a logarithmic scale, that a steady decay to the least ratio that counts would take.
    let lasts = |(early, late): (f64, f64)| {
        let [least, most] = DECAYED_RATIOS;
        late > (MIN_ENERGY_RATIO / early).cbrt().clamp(least, most) * early
    };
    let last_third = end - end / 3;
    if end > MIN_DECAY_WINDOWS && mean(0..last_third).zip(mean(last_third..end)).is_some_and(lasts) {
        return 0;
    }
    // One window more, in which the rest of it vanishes.
    if end > 0 { ((end + 1) * window).min(samples) } else { 0 }
}

/// Per window of the first period, the mean square of its difference from the others as a ratio to what is usual; `None` where there are too few
/// samples to tell.
fn ratios(q: &[f64], left_out: &[bool], samples: usize, window: usize) -> Vec<Option<f64>> {
    let energies: Vec<_> = (0..q.len() / samples).map(|p| energies(q, left_out, samples, window, p)).collect();
    let (first, others) = (&energies[0], &energies[1..]);
    let mut sorted: Vec<f64> = first.iter().copied().flatten().collect();
    sorted.sort_by(f64::total_cmp);
    // A motion that never settles is another motion: its median is as large as its start.
    let usual = sorted.get(sorted.len() / 2).copied().unwrap_or_default();
    let ratio = |k: usize| {
        let beside: Vec<f64> = others.iter().filter_map(|own| own[k]).collect();
        let beside = beside.iter().sum::<f64>() / beside.len().max(1) as f64;
        first[k].map(|energy| energy / usual.max(beside).max(MIN_ENERGY))
    };
    (0..first.len()).map(ratio).collect()
}

/// Windows at the start of a period that deviate.
fn end_of_start(ratios: &[Option<f64>]) -> usize {
    let (mut end, mut quiet) = (0, 0);
    for (k, ratio) in ratios.iter().enumerate() {
        match ratio {
            Some(ratio) if *ratio > MIN_ENERGY_RATIO => (end, quiet) = (k + 1, 0),
            Some(_) => quiet += 1,
            None => {}
        }
        if quiet == SETTLED_WINDOWS {
            break;
        }
    }
    end
}

/// Mean square, per window, of a period's difference from the mean of the other periods after the first; with two periods zero for the second.
/// `None` where less than half of a window's samples can be compared.
fn energies(q: &[f64], left_out: &[bool], samples: usize, window: usize, period: usize) -> Vec<Option<f64>> {
    let others: Vec<usize> = (1..q.len() / samples).filter(|&other| other != period).collect();
    if others.is_empty() {
        return vec![Some(0.0); samples.div_ceil(window)];
    }
    let difference = |k: usize| {
        let row = period * samples + k;
        let used = others.iter().map(|other| other * samples + k).filter(|&row| !left_out[row]);
        let (sum, count) = used.fold((0.0, 0.0), |(sum, count), row| (sum + q[row], count + 1.0));
        // The mean of few periods has noise of its own.
        (count > 0.0 && !left_out[row]).then(|| (q[row] - sum / count) / f64::sqrt(1.0 + 1.0 / count))
    };
    let differences: Vec<Option<f64>> = (0..samples).map(difference).collect();
    let mean_square = |part: &[Option<f64>]| {
        let used: Vec<f64> = part.iter().copied().flatten().collect();
        (2 * used.len() >= part.len()).then(|| used.iter().map(|value| value * value).sum::<f64>() / used.len() as f64)
    };
    differences.chunks(window).map(mean_square).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const DT: f64 = 1e-3;
    const SAMPLES: usize = 5000;

    /// A sine with encoder noise of 20 urad, and slow noise of the controller of 50 urad; `start` is added to the first period.
    fn positions(seed: u64, periods: usize, start: impl Fn(f64) -> f64) -> DMatrix<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut slow = 0.0;
        DMatrix::from_fn(periods * SAMPLES, 1, |k, _| {
            let (white, drive): (f64, f64) = (StandardNormal.sample(&mut rng), StandardNormal.sample(&mut rng));
            let pole = 0.99_f64;
            slow = pole * slow + 5e-5 * (1.0 - pole * pole).sqrt() * drive;
            let t = k as f64 * DT;
            (t * 2.0 * std::f64::consts::PI / 5.0).sin() + 2e-5 * white + slow + start(t)
        })
    }

    #[test]
    fn a_start_from_standstill_is_found_up_to_where_it_has_decayed() {
        for periods in [2, 3, 10] {
            for seed in 0..10 {
                // 5 mrad that decay with 0.2 s: below the noise after 0.9 s.
                let q = positions(seed, periods, |t| 5e-3 * (-t / 0.2).exp());
                let found = settling(&q, &vec![false; q.nrows()], SAMPLES, DT) as f64 * DT;
                assert!((0.6..=1.6).contains(&found), "{periods} periods, seed {seed}: {found} s");
            }
        }
    }

    #[test]
    fn what_comes_within_the_first_period_is_no_start() {
        for seed in 0..10 {
            // A load is picked up after 2.9 s: until then the controller is elsewhere by 0.5 mrad.
            let q = positions(300 + seed, 5, |t| if t < 2.9 { 5e-4 } else { 0.0 });
            assert_eq!(settling(&q, &vec![false; q.nrows()], SAMPLES, DT), 0, "seed {seed}");
            // After a start of its own, and in another pose.
            let level = |t: f64| [2e-3, 1.4e-3, 0.0][usize::from(t > 1.5) + usize::from(t > 2.2)];
            let q = positions(400 + seed, 5, |t| level(t) + 1e-3 * (-t / 0.2).exp());
            assert_eq!(settling(&q, &vec![false; q.nrows()], SAMPLES, DT), 0, "seed {seed}");
        }
    }

    #[test]
    fn a_motion_that_is_drawn_in_has_a_start() {
        for seed in 0..10 {
            // From rest to the whole motion within 1.5 s.
            let q = positions(500 + seed, 4, |t| {
                let s = (t / 1.5).min(1.0);
                -(1.0 - s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)) * (t * 2.0 * std::f64::consts::PI / 5.0).sin()
            });
            let found = settling(&q, &vec![false; q.nrows()], SAMPLES, DT) as f64 * DT;
            assert!((1.2..=1.8).contains(&found), "seed {seed}: {found} s");
        }
    }

    #[test]
    fn samples_that_are_left_out_do_not_hide_a_start() {
        for seed in 0..10 {
            let q = positions(200 + seed, 5, |t| 5e-3 * (-t / 0.2).exp());
            // Most samples of the first 0.4 s, as outliers with their margins would be.
            let left_out: Vec<bool> = (0..q.nrows()).map(|k| k < 400 && k % 10 > 1).collect();
            let found = settling(&q, &left_out, SAMPLES, DT) as f64 * DT;
            assert!((0.6..=1.6).contains(&found), "seed {seed}: {found} s");
        }
    }

    #[test]
    fn a_motion_that_repeats_loses_next_to_nothing() {
        for periods in [1, 2, 3, 10] {
            for seed in 0..20 {
                let q = positions(100 + seed, periods, |_| 0.0);
                let found = settling(&q, &vec![false; q.nrows()], SAMPLES, DT) as f64 * DT;
                assert!(found <= 0.7, "{periods} periods, seed {seed}: {found} s");
            }
        }
    }

    #[test]
    fn another_motion_is_no_start() {
        let q = positions(3, 4, |t| if t < 5.0 { 1e-3 * (3.0 * t).sin() } else { 0.0 });
        assert!(settling(&q, &vec![false; q.nrows()], SAMPLES, DT) < SAMPLES / 2);
    }
}
