//! How much of each joint's limits a motion uses, and which joint it leaves frozen.

use super::ExciteError;
use super::fourier::Fourier;
use super::limits::{Bounds, Peak};

/// Least share of one of its limits (range, speed, acceleration or jerk) that a motion has to use of every joint.
///
/// The standard deviation of what a joint's motion determines grows with the inverse of its amplitude: at a tenth it is ten times that
/// of a motion that uses the limit, the same as one run in place of a hundred.
pub const MIN_USAGE: f64 = 0.1;
/// What a random motion is drawn again for, up to a number of times: a motion of a quarter of what a joint can do is worth one of sixteen.
pub const WANTED_USAGE: f64 = 0.25;
/// Samples of one period that peaks are taken from.
const SAMPLES: usize = 400;

/// Shares of one joint's limits, less their margins, that a motion uses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Usage {
    /// Distance between the highest and the lowest position, of the joint's range.
    pub range: f64,
    /// Highest speed, of the highest speed that the joint has anywhere.
    pub speed: f64,
    /// Highest acceleration.
    pub acceleration: f64,
    /// Highest jerk.
    pub jerk: f64,
}

impl Usage {
    /// The limit that the motion uses most of. A slow motion with a long period is near the ends of the range alone, a fast one with a
    /// short period near the acceleration limit alone.
    pub fn largest(&self) -> f64 {
        self.range.max(self.speed).max(self.acceleration).max(self.jerk)
    }
}

/// Usage of every joint, n.
pub fn usage(bounds: &Bounds, fourier: &Fourier) -> Vec<Usage> {
    let (limits, margins) = (bounds.limits, &bounds.margins);
    let of_joint = |j: usize| {
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        let (mut dq, mut ddq, mut jerk) = (0.0_f64, 0.0_f64, 0.0_f64);
        for k in 0..SAMPLES {
            let point = fourier.at(j, k as f64 * fourier.period / SAMPLES as f64);
            (low, high) = (low.min(point.q), high.max(point.q));
            (dq, ddq, jerk) = (dq.max(point.dq.abs()), ddq.max(point.ddq.abs()), jerk.max(point.jerk.abs()));
        }
        Usage {
            range: (high - low) / (limits.q_max[j] - limits.q_min[j] - 2.0 * margins.position),
            speed: dq / (limits.dq[j] * margins.velocity),
            acceleration: ddq / (limits.ddq[j] * margins.acceleration),
            jerk: jerk / (limits.jerk[j] * margins.jerk),
        }
    };
    (0..fourier.joints()).map(of_joint).collect()
}

/// The joint (from 0) that a motion uses least, with its usage.
pub fn least_usage(usage: &[Usage]) -> Option<(usize, Usage)> {
    let joints = usage.iter().copied().enumerate();
    joints.min_by(|(_, one), (_, other)| one.largest().total_cmp(&other.largest()))
}

/// Errors when a motion uses less than [`MIN_USAGE`] of every limit of some joint. `limited_by` is what kept the motion small, where that is
/// known, and `draws` the number of random motions that were tried.
pub fn check_usage(usage: &[Usage], limited_by: Option<Peak>, draws: usize) -> Result<(), ExciteError> {
    match least_usage(usage) {
        // Also where the usage is not a number.
        Some((j, usage)) if usage.largest().is_nan() || usage.largest() < MIN_USAGE => {
            Err(ExciteError::Frozen { joint: j + 1, usage, limited_by, draws })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::Margins;
    use plumbline_core::{Limits, MAX_JOINTS};
    use plumbline_model::{Chain, Joint, JointKind, Placement};

    #[test]
    fn shares_are_of_the_limits_less_their_margins_and_the_least_joint_is_named() {
        let joint = |a: f64| Joint { kind: JointKind::Revolute, a, alpha: 0.0, d: 0.0, theta: 0.0 };
        let chain = Chain::modified(vec![joint(0.0), joint(0.5)], Placement::identity());
        let all = |x: f64| [x; MAX_JOINTS];
        let limits = Limits {
            q_min: all(-1.0),
            q_max: all(1.0),
            dq: all(2.0),
            ddq: all(50.0),
            jerk: all(1e4),
            tau: all(20.0),
            dtau: all(100.0),
        };
        let bounds = Bounds::new(&chain, &limits, Margins { position: 0.1, velocity: 0.5, ..Margins::default() });
        // A period of 2 pi seconds: amplitude, speed and acceleration are one number.
        let mut fourier = Fourier::still(std::f64::consts::TAU, vec![0.0; 2], 1).unwrap();
        (fourier.a[(0, 0)], fourier.a[(1, 0)]) = (0.45, 0.02);
        let shares = usage(&bounds, &fourier);
        let near = |one: f64, other: f64| (one - other).abs() < 1e-4;
        assert!(near(shares[0].range, 0.5) && near(shares[0].speed, 0.45), "{shares:?}");
        assert!(near(shares[0].acceleration, 0.01), "{shares:?}");
        assert!(check_usage(&shares[..1], None, 1).is_ok());
        let error = check_usage(&shares, None, 100).unwrap_err();
        let words = "joint 2 is frozen: it uses 2.2 % of its range and 2.0 % of its speed in the best of 100 random motions, expected \
                     at least 10 % of its range, speed, acceleration or jerk";
        assert_eq!(error.to_string(), words);
        fourier.a[(1, 0)] = f64::NAN;
        assert!(matches!(check_usage(&usage(&bounds, &fourier), None, 1), Err(ExciteError::Frozen { joint: 2, .. })));
    }
}
