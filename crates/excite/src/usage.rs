//! Shares of each joint's limits that a motion uses.

use super::ExciteError;
use super::fourier::Fourier;
use super::limits::{Bounds, Peak};

/// Minimum share of one of its limits (range, speed, acceleration or jerk) that every joint must use.
///
/// Standard deviations of a joint's parameters are inversely proportional to the amplitude. At a tenth of the limit they are ten times larger,
/// which a hundred times as many runs would compensate.
pub const MIN_USAGE: f64 = 0.1;
/// Share of the limits below which a random motion is drawn again: at a quarter of the limit a run is worth a sixteenth.
pub const TARGET_USAGE: f64 = 0.25;
const SAMPLES: usize = 400;

/// Shares of one joint's limits less margins that a motion uses.
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
    /// The largest share. A motion with a long period is bounded by the range only, one with a short period by the acceleration
    /// limit only.
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

/// The joint (from 0) with the smallest usage.
pub fn least_usage(usage: &[Usage]) -> Option<(usize, Usage)> {
    let joints = usage.iter().copied().enumerate();
    joints.min_by(|(_, one), (_, other)| one.largest().total_cmp(&other.largest()))
}

/// Checks that every joint uses at least [`MIN_USAGE`] of one limit. `limited_by` is the limit that bounded the motion, where known, and `draws`
/// the number of random motions tried.
///
/// # Errors
/// [`ExciteError::Frozen`] with the joint.
pub fn check_usage(usage: &[Usage], limited_by: Option<Peak>, draws: usize) -> Result<(), ExciteError> {
    match least_usage(usage) {
        // NaN is an error too.
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
    fn shares_refer_to_limits_less_margins_and_the_least_used_joint_is_reported() {
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
