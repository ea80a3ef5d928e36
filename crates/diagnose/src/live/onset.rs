//! When a change came.

use super::{LOST_RATIO, over, rms, worst};
use nalgebra::DMatrix;

/// Joints whose error is above this share of the worst joint's, both as ratios to the usual, tell when a change came.
const CONCERNED_RATIO: f64 = 0.5;
/// A change that grows is followed back to its begin in at most so many steps.
const MAX_ONSET_STEPS: usize = 10;

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
    let over = |joint: usize| over(&end, usual, joint);
    let begins = |joint: usize| begin_in(residual, usual, joint, end[joint]);
    let Some(worst) = worst(&end, usual) else { return 0 };
    let concerned = |joint: &usize| over(*joint) >= CONCERNED_RATIO * over(worst);
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

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

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
}
