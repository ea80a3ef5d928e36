//! Limits that the arm checks commands against.
//!
//! Source: "Robot and interface specifications" of Franka's documentation (github.com/frankarobotics/docs) and
//! `rate_limiting.h` of libfranka. An arm of protocol version 9 or 10 serves its own as URDF ([`from_urdf`]), which are the ones to
//! go by: the offsets of the tables differ between sources.

mod guard;
mod urdf;

pub use urdf::{UrdfError, from_urdf};

use plumbline_core::JointVec;

/// Limits of the seven joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RobotLimits {
    /// Lowest position \[rad\].
    pub q_min: [f64; 7],
    /// Highest position \[rad\].
    pub q_max: [f64; 7],
    /// Highest speed anywhere \[rad/s\].
    pub dq: [f64; 7],
    /// What is taken off the speed from which the joint could still brake before the end of its range \[rad/s\].
    pub dq_offset: [f64; 7],
    /// The deceleration of that braking \[rad/s2\]; 0 for a joint whose speed limit is the same everywhere.
    pub dq_dec: [f64; 7],
    /// Ends of the range that this speed limit reckons with, lower and upper; they can lie a little outside `q_min` and `q_max` \[rad\].
    pub dq_ends: [[f64; 7]; 2],
    /// Highest acceleration \[rad/s2\].
    pub ddq: [f64; 7],
    /// Highest jerk \[rad/s3\].
    pub jerk: [f64; 7],
    /// Highest torque \[Nm\].
    pub tau: [f64; 7],
    /// Highest rate of the commanded torque \[Nm/s\].
    pub dtau: [f64; 7],
}

const TAU: [f64; 7] = [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0];

/// Panda and FER.
pub fn panda() -> RobotLimits {
    let q_min = [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973];
    let q_max = [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973];
    RobotLimits {
        q_min,
        q_max,
        dq: [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61],
        dq_offset: [0.0; 7],
        dq_dec: [0.0; 7],
        dq_ends: [q_min, q_max],
        ddq: [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0],
        jerk: [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10_000.0, 10_000.0],
        tau: TAU,
        dtau: [1000.0; 7],
    }
}

/// FR3 with system image 5.9 or later.
pub fn fr3() -> RobotLimits {
    let q_min = [-2.9007, -1.8361, -2.9007, -3.0770, -2.8763, 0.4398, -3.0508];
    let q_max = [2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508];
    RobotLimits {
        q_min,
        q_max,
        dq: [2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26],
        dq_offset: [0.6599, 0.2517, 0.2000, 0.3533, 0.5757, 0.4878, 0.4628],
        dq_dec: [6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0],
        dq_ends: [q_min, q_max],
        ddq: [10.0; 7],
        jerk: [5000.0; 7],
        tau: TAU,
        dtau: [1000.0; 7],
    }
}

/// FR3 with an earlier system image.
pub fn fr3_before_5_9() -> RobotLimits {
    RobotLimits {
        q_min: [-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159],
        q_max: [2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159],
        dq_offset: [0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35],
        dq_ends: [
            [-2.75010, -1.79180, -2.90650, -3.0481, -2.81010, 0.54092, -3.01960],
            [2.75010, 1.79180, 2.90650, -0.1458, 2.81010, 4.52050, 3.01960],
        ],
        ..fr3()
    }
}

impl RobotLimits {
    /// Lowest and highest velocity of joint `j` (from 0) at position `q`:
    /// `min(dq, max(0, sqrt(2 dec (end - q)) - offset))` and its mirror image. `None` past the last joint.
    pub fn velocities(&self, j: usize, q: f64) -> Option<(f64, f64)> {
        let (most, offset, dec) = (*self.dq.get(j)?, *self.dq_offset.get(j)?, *self.dq_dec.get(j)?);
        if dec == 0.0 {
            return Some((-most, most));
        }
        let [low, high] = &self.dq_ends;
        // Not `clamp`, which panics where `most` is negative or no number.
        let speed = |room: f64| ((2.0 * dec * room).max(0.0).sqrt() - offset).max(0.0).min(most);
        Some((-speed(q - low.get(j)?), speed(high.get(j)? - q)))
    }
}

/// Seven numbers in the room of a fixed-size message.
pub(super) fn widen(joints: &[f64; 7]) -> JointVec {
    let mut wide = JointVec::default();
    for (to, from) in wide.iter_mut().zip(joints) {
        *to = *from;
    }
    wide
}

/// The first seven numbers of a fixed-size message.
pub(super) fn narrow(wide: &JointVec) -> [f64; 7] {
    let [a, b, c, d, e, f, g, _] = *wide;
    [a, b, c, d, e, f, g]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_speed_of_an_fr3_falls_towards_its_ends() {
        let limits = fr3();
        assert_eq!(limits.velocities(0, 0.0), Some((-2.62, 2.62)));
        // -0.6599 + sqrt(2 * 6 * 0.1) = 0.43554...
        let (low, high) = limits.velocities(0, 2.9007 - 0.1).unwrap();
        assert!((high - 0.435545).abs() < 1e-6 && low == -2.62, "{low} {high}");
        assert_eq!(limits.velocities(0, 2.9007).unwrap().1, 0.0);
        assert_eq!(limits.velocities(0, 4.0).unwrap().1, 0.0);
        // The old table: -0.30 + sqrt(12 (2.75010 - q)), libfranka 0.10 to 0.17.
        let (_, high) = fr3_before_5_9().velocities(0, 2.65010).unwrap();
        assert!((high - (1.2f64.sqrt() - 0.30)).abs() < 1e-12);
        assert_eq!(panda().velocities(6, 2.8973), Some((-2.61, 2.61)));
        assert_eq!(panda().velocities(7, 0.0), None);
    }

    #[test]
    fn the_guards_envelope_is_never_wider_than_the_arms() {
        for robot in [fr3(), fr3_before_5_9()] {
            let guard = robot.for_guard(1.0);
            let (limits, envelope) = (guard.limits, guard.envelope.unwrap());
            for j in 0..7 {
                for step in 0..=100 {
                    let q = robot.q_min[j] + (robot.q_max[j] - robot.q_min[j]) * f64::from(step) / 100.0;
                    let (low, high) = robot.velocities(j, q).unwrap();
                    assert!(envelope.at(j, limits.q_max[j] - q, limits.dq[j]).0 <= high + 1e-12);
                    assert!(envelope.at(j, q - limits.q_min[j], limits.dq[j]).0 <= -low + 1e-12);
                }
            }
        }
        assert_eq!(panda().for_guard(1.0).envelope, None);
    }
}
