//! The limits a motion must keep, and how near it comes to each of them.

use super::fourier::Fourier;
use crate::joint::{JointVec, Limits, MAX_JOINTS, Workspace};
use crate::model::chain::Chain;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Samples per second at which a finished motion is verified \[Hz\].
pub const VERIFY_RATE: f64 = 1000.0;

/// What a planned motion leaves free of each limit, for tracking errors and noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Margins {
    /// Kept away from both ends of a joint's range \[rad\].
    pub position: f64,
    /// Share of the velocity limit that may be used.
    pub velocity: f64,
    /// Share of the acceleration limit that may be used.
    pub acceleration: f64,
    /// Share of the jerk limit that may be used.
    pub jerk: f64,
    /// Share of the torque limit that may be used.
    pub torque: f64,
    /// Share of the torque rate limit that may be used.
    pub torque_rate: f64,
    /// Kept away from the box and from the sphere round the base \[m\].
    pub workspace: f64,
}

impl Default for Margins {
    fn default() -> Margins {
        Margins {
            position: 0.05,
            velocity: 0.9,
            acceleration: 0.9,
            jerk: 0.9,
            torque: 0.9,
            torque_rate: 0.9,
            workspace: 0.02,
        }
    }
}

/// Everything a motion of one arm is held to.
#[derive(Clone, Copy, Debug)]
pub struct Bounds<'a> {
    /// The arm.
    pub chain: &'a Chain,
    /// Limits of its joints.
    pub limits: &'a Limits,
    /// Where its end effector may be (paper eq. 14); `None` leaves it free.
    pub workspace: Option<&'a Workspace>,
    /// What to leave free of each limit.
    pub margins: Margins,
}

/// Torque that a nominal model needs at a position, velocity and acceleration \[Nm\].
pub type NominalTorque<'a> = &'a dyn Fn(&JointVec, &JointVec, &JointVec) -> JointVec;

/// What a limit is about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Lower end of a joint's range \[rad\].
    PositionMin,
    /// Upper end of a joint's range \[rad\].
    PositionMax,
    /// Speed \[rad/s\].
    Velocity,
    /// Acceleration \[rad/s2\].
    Acceleration,
    /// Jerk \[rad/s3\].
    Jerk,
    /// Torque of the nominal model \[Nm\].
    Torque,
    /// Torque rate of the nominal model \[Nm/s\].
    TorqueRate,
    /// Lower side of the box along x, y or z \[m\].
    BoxMin(usize),
    /// Upper side of the box along x, y or z \[m\].
    BoxMax(usize),
    /// Distance from the base frame's origin \[m\].
    BaseSphere,
}

impl Quantity {
    fn describe(self) -> (String, &'static str) {
        let axis = |i: usize| ["x", "y", "z"].get(i).copied().unwrap_or("?");
        match self {
            Quantity::PositionMin => ("position".into(), "rad"),
            Quantity::PositionMax => ("position".into(), "rad"),
            Quantity::Velocity => ("velocity".into(), "rad/s"),
            Quantity::Acceleration => ("acceleration".into(), "rad/s2"),
            Quantity::Jerk => ("jerk".into(), "rad/s3"),
            Quantity::Torque => ("torque".into(), "Nm"),
            Quantity::TorqueRate => ("torque rate".into(), "Nm/s"),
            Quantity::BoxMin(i) | Quantity::BoxMax(i) => (format!("end effector {}", axis(i)), "m"),
            Quantity::BaseSphere => ("end effector distance from the base".into(), "m"),
        }
    }

    /// Whether the value must stay above the limit rather than below.
    fn is_lower(self) -> bool {
        matches!(self, Quantity::PositionMin | Quantity::BoxMin(_) | Quantity::BaseSphere)
    }
}

/// The point of a motion that comes nearest to one limit, or breaks it most.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Peak {
    /// What the limit is about.
    pub quantity: Quantity,
    /// Joint, counted from 1; `None` for the end effector.
    pub joint: Option<usize>,
    /// When \[s\].
    pub time: f64,
    /// Value there, without sign where the limit is on the size.
    pub value: f64,
    /// The limit less its margin.
    pub limit: f64,
}

impl Peak {
    /// What is left of the limit less its margin; negative when it is broken. Unit of the quantity.
    pub fn headroom(&self) -> f64 {
        if self.quantity.is_lower() { self.value - self.limit } else { self.limit - self.value }
    }

    /// Whether the limit is broken. A value that is not a number breaks every limit.
    pub fn is_violation(&self) -> bool {
        let headroom = self.headroom();
        headroom.is_nan() || headroom < -1e-9 * self.limit.abs().max(1.0)
    }
}

impl fmt::Display for Peak {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (what, unit) = self.quantity.describe();
        if let Some(joint) = self.joint {
            write!(f, "joint {joint} ")?;
        }
        let side = if self.quantity.is_lower() { "at least" } else { "at most" };
        write!(f, "{what} {:.4} {unit} at {:.3} s, expected {side} {:.4} {unit}", self.value, self.time, self.limit)
    }
}

/// How near a motion comes to every limit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Check {
    /// One peak per limit and joint.
    pub peaks: Vec<Peak>,
}

impl Check {
    /// The limits that are broken.
    pub fn violations(&self) -> impl Iterator<Item = &Peak> {
        self.peaks.iter().filter(|peak| peak.is_violation())
    }

    /// Whether every limit is kept.
    pub fn is_feasible(&self) -> bool {
        self.violations().next().is_none()
    }

    fn note(&mut self, slot: &mut usize, quantity: Quantity, joint: Option<usize>, time: f64, value: f64, limit: f64) {
        let peak = Peak { quantity, joint, time, value, limit };
        match self.peaks.get_mut(*slot) {
            None => self.peaks.push(peak),
            Some(known) if peak.headroom().is_nan() || peak.headroom() < known.headroom() => *known = peak,
            Some(_) => {}
        }
        *slot += 1;
    }
}

/// Walks one period of a motion (`samples` even steps) and notes the peak of every quantity.
///
/// `torque` adds the torque and torque-rate limits. At 1 kHz ([`verify`]) this is the promise that a plan makes; a coarse grid is
/// for searching.
pub fn check(bounds: &Bounds, fourier: &Fourier, samples: usize, torque: Option<NominalTorque>) -> Check {
    let n = fourier.joints();
    let (limits, margins) = (bounds.limits, &bounds.margins);
    let dt = fourier.period / samples as f64;
    let mut check = Check::default();
    let mut last_tau: Option<JointVec> = None;
    for k in 0..=samples {
        let time = k as f64 * dt;
        let mut slot = 0;
        let (mut q, mut dq, mut ddq) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for j in 0..n {
            let point = fourier.at(j, time);
            (q[j], dq[j], ddq[j]) = (point.q, point.dq, point.ddq);
            let joint = Some(j + 1);
            let mut note = |quantity, value, limit| check.note(&mut slot, quantity, joint, time, value, limit);
            note(Quantity::PositionMin, point.q, limits.q_min[j] + margins.position);
            note(Quantity::PositionMax, point.q, limits.q_max[j] - margins.position);
            note(Quantity::Velocity, point.dq.abs(), limits.dq[j] * margins.velocity);
            note(Quantity::Acceleration, point.ddq.abs(), limits.ddq[j] * margins.acceleration);
            note(Quantity::Jerk, point.jerk.abs(), limits.jerk[j] * margins.jerk);
        }
        if let Some(workspace) = bounds.workspace {
            let at = bounds.chain.end_effector(&q[..n]);
            let mut note = |quantity, value, limit| check.note(&mut slot, quantity, None, time, value, limit);
            for axis in 0..3 {
                note(Quantity::BoxMin(axis), at[axis], workspace.box_min[axis] + margins.workspace);
                note(Quantity::BoxMax(axis), at[axis], workspace.box_max[axis] - margins.workspace);
            }
            note(Quantity::BaseSphere, at.norm(), workspace.base_radius + margins.workspace);
        }
        if let Some(torque) = torque {
            let tau = torque(&q, &dq, &ddq);
            let before = last_tau.unwrap_or(tau);
            for j in 0..n {
                let joint = Some(j + 1);
                let rate = (tau[j] - before[j]).abs() / dt;
                check.note(&mut slot, Quantity::Torque, joint, time, tau[j].abs(), limits.tau[j] * margins.torque);
                check.note(&mut slot, Quantity::TorqueRate, joint, time, rate, limits.dtau[j] * margins.torque_rate);
            }
            last_tau = Some(tau);
        }
    }
    check
}

/// [`check`] at 1 kHz.
pub fn verify(bounds: &Bounds, fourier: &Fourier, torque: Option<NominalTorque>) -> Check {
    check(bounds, fourier, (fourier.period * VERIFY_RATE).round().max(1.0) as usize, torque)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::chain::{Joint, JointKind, Placement};

    /// One revolute joint about z with the end effector 0.5 m out along x.
    fn pendulum() -> Chain {
        let joint = Joint { kind: JointKind::Revolute, a: 0.0, alpha: 0.0, d: 0.0, theta: 0.0 };
        let mut flange = Placement::identity();
        flange.origin.x = 0.5;
        Chain::modified(vec![joint], flange)
    }

    fn limits() -> Limits {
        let all = |x: f64| [x; MAX_JOINTS];
        Limits {
            q_min: all(-1.0),
            q_max: all(1.0),
            dq: all(2.0),
            ddq: all(5.0),
            jerk: all(50.0),
            tau: all(10.0),
            dtau: all(100.0),
        }
    }

    fn sine(amplitude: f64) -> Fourier {
        let mut fourier = Fourier::still(2.0, vec![0.0], 1).unwrap();
        fourier.a[(0, 0)] = amplitude;
        fourier
    }

    #[test]
    fn peaks_are_those_of_the_sine() {
        let (chain, limits) = (pendulum(), limits());
        let margins = Margins::default();
        let bounds = Bounds { chain: &chain, limits: &limits, workspace: None, margins };
        let tau = |q: &JointVec, _: &JointVec, ddq: &JointVec| {
            let mut tau = [0.0; MAX_JOINTS];
            tau[0] = 2.0 * ddq[0] + 3.0 * q[0].sin();
            tau
        };
        let check = verify(&bounds, &sine(0.5), Some(&tau));
        let w = std::f64::consts::PI;
        let value = |quantity| check.peaks.iter().find(|p| p.quantity == quantity).unwrap().value;
        assert!((value(Quantity::PositionMax) - 0.5).abs() < 1e-9);
        assert!((value(Quantity::PositionMin) + 0.5).abs() < 1e-9);
        assert!((value(Quantity::Velocity) - 0.5 * w).abs() < 1e-9);
        assert!((value(Quantity::Acceleration) - 0.5 * w * w).abs() < 1e-9);
        assert!((value(Quantity::Jerk) - 0.5 * w * w * w).abs() < 1e-9);
        // At the turning point: 2 * 0.5 w^2 - 3 sin 0.5.
        assert!((value(Quantity::Torque) - (w * w - 3.0 * 0.5_f64.sin())).abs() < 1e-6);
        assert!((value(Quantity::TorqueRate) - (0.5 * w * (2.0 * w * w - 3.0))).abs() < 1e-3);
        assert_eq!(check.violations().map(|p| p.quantity).collect::<Vec<_>>(), [Quantity::Acceleration]);
    }

    #[test]
    fn a_broken_limit_names_joint_time_value_and_limit() {
        let (chain, limits) = (pendulum(), limits());
        let bounds = Bounds { chain: &chain, limits: &limits, workspace: None, margins: Margins::default() };
        let check = verify(&bounds, &sine(0.98), None);
        let text = check.violations().next().unwrap().to_string();
        assert_eq!(text, "joint 1 position -0.9800 rad at 1.500 s, expected at least -0.9500 rad");
    }

    #[test]
    fn the_end_effector_stays_in_the_box_and_out_of_the_sphere() {
        let (chain, limits) = (pendulum(), limits());
        let space =
            |y: f64, radius: f64| Workspace { box_min: [-1.0, -y, -1.0], box_max: [1.0, y, 1.0], base_radius: radius };
        let broken = |workspace: Workspace| {
            let bounds =
                Bounds { chain: &chain, limits: &limits, workspace: Some(&workspace), margins: Margins::default() };
            verify(&bounds, &sine(0.3), None).violations().map(|p| p.quantity).collect::<Vec<_>>()
        };
        assert_eq!(broken(space(0.2, 0.3)), []);
        assert_eq!(broken(space(0.15, 0.3)), [Quantity::BoxMin(1), Quantity::BoxMax(1)]);
        assert_eq!(broken(space(0.2, 0.49)), [Quantity::BaseSphere]);
    }

    #[test]
    fn a_motion_that_is_not_a_number_is_not_feasible() {
        let (chain, limits) = (pendulum(), limits());
        let bounds = Bounds { chain: &chain, limits: &limits, workspace: None, margins: Margins::default() };
        let mut motion = sine(0.1);
        motion.a[(0, 0)] = f64::NAN;
        assert!(!verify(&bounds, &motion, None).is_feasible());
    }
}
