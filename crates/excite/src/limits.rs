//! Limits of a planned motion and the headroom to each of them.

use super::fourier::Fourier;
use plumbline_core::{JointVec, Limits, MAX_JOINTS, SpeedEnvelope, Workspace};
use plumbline_model::{Chain, FIRST_BOXED, Shape, nearest};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Sampling rate at which a motion is verified \[Hz\].
pub const VERIFY_RATE_HZ: f64 = 1000.0;

/// Margins of a planned motion to its limits, for tracking errors and noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Margins {
    /// Distance to both ends of a joint's range \[rad\].
    pub position: f64,
    /// Ratio of the velocity limit that may be used.
    pub velocity: f64,
    /// Ratio of the acceleration limit that may be used.
    pub acceleration: f64,
    /// Ratio of the jerk limit that may be used.
    pub jerk: f64,
    /// Ratio of the torque limit that may be used.
    pub torque: f64,
    /// Ratio of the torque rate limit that may be used.
    pub torque_rate: f64,
    /// Distance to the box and to the sphere around the base \[m\].
    pub workspace: f64,
    /// Distance between links that are not adjacent \[m\].
    pub clearance: f64,
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
            clearance: 0.01,
        }
    }
}

impl Margins {
    /// No margins: every limit may be used fully.
    pub fn none() -> Margins {
        Margins {
            position: 0.0,
            velocity: 1.0,
            acceleration: 1.0,
            jerk: 1.0,
            torque: 1.0,
            torque_rate: 1.0,
            workspace: 0.0,
            clearance: 0.0,
        }
    }
}

/// Limits of a motion of one arm.
#[derive(Clone, Copy, Debug)]
pub struct Bounds<'a> {
    /// The arm.
    pub chain: &'a Chain,
    /// Limits of its joints.
    pub limits: &'a Limits,
    /// Workspace of its end effector (paper eq. 14); `None` for no constraint.
    pub workspace: Option<&'a Workspace>,
    /// Bodies of the links for clearances; `None` for no constraint.
    pub shape: Option<&'a Shape>,
    /// Whether the bodies from link [`FIRST_BOXED`] on must stay in the end effector's box too. The paper constrains the end effector
    /// alone (eq. 14).
    pub links_in_box: bool,
    /// Position-dependent speed limits in addition to those of `limits`.
    pub envelope: Option<&'a SpeedEnvelope>,
    /// Margins to the limits.
    pub margins: Margins,
}

impl<'a> Bounds<'a> {
    /// Joint limits of an arm, without workspace, bodies and speed envelope.
    pub fn new(chain: &'a Chain, limits: &'a Limits, margins: Margins) -> Bounds<'a> {
        Bounds { chain, limits, workspace: None, shape: None, links_in_box: false, envelope: None, margins }
    }

    /// Maximum speeds of joint `j` (from 0) at position `q` in the negative and positive direction, both positive, less their margin
    /// \[rad/s\].
    pub fn speeds(&self, j: usize, q: f64) -> [f64; 2] {
        let most = self.limits.dq[j];
        let at = |room: f64| self.envelope.map_or(most, |envelope| envelope.at(j, room, most).0);
        [at(q - self.limits.q_min[j]), at(self.limits.q_max[j] - q)].map(|speed| speed * self.margins.velocity)
    }
}

/// Torque that a nominal model needs at a position, velocity and acceleration \[Nm\].
pub type NominalTorque<'a> = &'a dyn Fn(&JointVec, &JointVec, &JointVec) -> JointVec;

/// Limited quantity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Quantity {
    /// Lower end of a joint's range \[rad\].
    PositionMin,
    /// Upper end of a joint's range \[rad\].
    PositionMax,
    /// Lowest position at which a stop from here comes to rest \[rad\].
    StopMin,
    /// Highest position at which a stop from here comes to rest \[rad\].
    StopMax,
    /// Speed \[rad/s\].
    Velocity,
    /// Peak speed of a stop that starts here, by its initial acceleration \[rad/s\].
    VelocityAhead,
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
    /// Lower side of the box along x, y or z, for the surface of a link \[m\].
    LinkBoxMin(usize),
    /// Upper side of the box along x, y or z, for the surface of a link \[m\].
    LinkBoxMax(usize),
    /// Distance between the surfaces of two links, counted from 1, the base being 0 \[m\].
    Clearance(usize, usize),
}

impl Quantity {
    fn describe(self) -> (String, &'static str) {
        let axis = |i: usize| ["x", "y", "z"].get(i).copied().unwrap_or("?");
        match self {
            Quantity::PositionMin => ("position".into(), "rad"),
            Quantity::PositionMax => ("position".into(), "rad"),
            Quantity::StopMin | Quantity::StopMax => ("position after a stop".into(), "rad"),
            Quantity::Velocity => ("velocity".into(), "rad/s"),
            Quantity::VelocityAhead => ("velocity in a stop".into(), "rad/s"),
            Quantity::Acceleration => ("acceleration".into(), "rad/s2"),
            Quantity::Jerk => ("jerk".into(), "rad/s3"),
            Quantity::Torque => ("torque".into(), "Nm"),
            Quantity::TorqueRate => ("torque rate".into(), "Nm/s"),
            Quantity::BoxMin(i) | Quantity::BoxMax(i) => (format!("end effector {}", axis(i)), "m"),
            Quantity::BaseSphere => ("end effector distance from the base".into(), "m"),
            Quantity::LinkBoxMin(i) | Quantity::LinkBoxMax(i) => (format!("surface {}", axis(i)), "m"),
            Quantity::Clearance(0, b) => (format!("distance of link {b} from the base"), "m"),
            Quantity::Clearance(a, b) => (format!("distance of link {b} from link {a}"), "m"),
        }
    }

    fn is_lower(self) -> bool {
        use Quantity::{BaseSphere, BoxMin, Clearance, LinkBoxMin, PositionMin, StopMin};
        matches!(self, PositionMin | StopMin | BoxMin(_) | BaseSphere | LinkBoxMin(_) | Clearance(..))
    }

    /// Whether the limit depends on one joint only: scaling down that joint's motion satisfies it.
    pub(super) fn is_of_one_joint(self) -> bool {
        use Quantity::{Acceleration, Jerk, PositionMax, PositionMin, StopMax, StopMin, Velocity, VelocityAhead};
        matches!(self, PositionMin | PositionMax | StopMin | StopMax | Velocity | VelocityAhead | Acceleration | Jerk)
    }
}

/// Point of a motion with the least headroom to one limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Peak {
    /// Limited quantity.
    pub quantity: Quantity,
    /// Joint or link, counted from 1; `None` for the end effector and for clearances.
    pub joint: Option<usize>,
    /// Time \[s\].
    pub time: f64,
    /// Value there; the absolute value for symmetric limits.
    pub value: f64,
    /// The limit less its margin.
    pub limit: f64,
}

impl Peak {
    /// Headroom to the limit less its margin, in the unit of the quantity; negative when it is violated.
    pub fn headroom(&self) -> f64 {
        if self.quantity.is_lower() { self.value - self.limit } else { self.limit - self.value }
    }

    /// Whether the limit is violated. NaN violates every limit.
    pub fn is_violation(&self) -> bool {
        let headroom = self.headroom();
        headroom.is_nan() || headroom < -1e-9 * self.limit.abs().max(1.0)
    }
}

impl fmt::Display for Peak {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (what, unit) = self.quantity.describe();
        match (self.joint, self.quantity) {
            (Some(link), Quantity::LinkBoxMin(_) | Quantity::LinkBoxMax(_)) => write!(f, "link {link} ")?,
            (Some(joint), _) => write!(f, "joint {joint} ")?,
            (None, _) => {}
        }
        let side = if self.quantity.is_lower() { "at least" } else { "at most" };
        write!(f, "{what} {:.4} {unit} at {:.3} s, expected {side} {:.4} {unit}", self.value, self.time, self.limit)
    }
}

/// Headroom of a motion to every limit.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Check {
    /// One peak per limit and joint.
    pub peaks: Vec<Peak>,
}

impl Check {
    /// The violated limits.
    pub fn violations(&self) -> impl Iterator<Item = &Peak> {
        self.peaks.iter().filter(|peak| peak.is_violation())
    }

    /// Whether every limit is satisfied.
    pub fn is_feasible(&self) -> bool {
        self.violations().next().is_none()
    }

    fn record(
        &mut self,
        slot: &mut usize,
        quantity: Quantity,
        joint: Option<usize>,
        time: f64,
        value: f64,
        limit: f64,
    ) {
        let peak = Peak { quantity, joint, time, value, limit };
        match self.peaks.get_mut(*slot) {
            None => self.peaks.push(peak),
            Some(known) if peak.headroom().is_nan() || peak.headroom() < known.headroom() => *known = peak,
            Some(_) => {}
        }
        *slot += 1;
    }

    /// Records workspace, link boxes and clearances at a pose.
    fn record_space(&mut self, slot: &mut usize, bounds: &Bounds, q: &[f64], time: f64) {
        let margins = &bounds.margins;
        if let Some(workspace) = bounds.workspace {
            let at = bounds.chain.end_effector(q);
            for axis in 0..3 {
                let (low, high) =
                    (workspace.box_min[axis] + margins.workspace, workspace.box_max[axis] - margins.workspace);
                self.record(slot, Quantity::BoxMin(axis), None, time, at[axis], low);
                self.record(slot, Quantity::BoxMax(axis), None, time, at[axis], high);
            }
            self.record(slot, Quantity::BaseSphere, None, time, at.norm(), workspace.base_radius + margins.workspace);
        }
        let Some(shape) = bounds.shape else { return };
        let segments = shape.placed(bounds.chain, q);
        if let Some(workspace) = bounds.workspace.filter(|_| bounds.links_in_box) {
            for (capsule, ends) in shape.capsules().iter().zip(&segments).filter(|(c, _)| c.link >= FIRST_BOXED) {
                let (low, high) = (ends[0].inf(&ends[1]), ends[0].sup(&ends[1]));
                let link = Some(capsule.link);
                for (axis, (low, high)) in low.iter().zip(&high).enumerate() {
                    let least = workspace.box_min[axis] + margins.workspace;
                    let most = workspace.box_max[axis] - margins.workspace;
                    self.record(slot, Quantity::LinkBoxMin(axis), link, time, low - capsule.radius, least);
                    self.record(slot, Quantity::LinkBoxMax(axis), link, time, high + capsule.radius, most);
                }
            }
        }
        for &(a, b) in shape.pairs() {
            let (one, other) = (&shape.capsules()[a], &shape.capsules()[b]);
            let distance = nearest(&segments[a], &segments[b]).between.norm() - one.radius - other.radius;
            let (low, high) = (one.link.min(other.link), one.link.max(other.link));
            self.record(slot, Quantity::Clearance(low, high), None, time, distance, margins.clearance);
        }
    }
}

/// Check of box, sphere and clearances at a pose.
pub fn check_pose(bounds: &Bounds, q: &[f64]) -> Check {
    let mut check = Check::default();
    check.record_space(&mut 0, bounds, q, 0.0);
    check
}

/// Peaks of every limited quantity over one period of a motion (`samples` even steps).
///
/// `torque` adds the torque and torque-rate limits. A plan is verified at 1 kHz ([`verify`]); a coarse grid is for searching.
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
            let mut record = |quantity, value, limit| check.record(&mut slot, quantity, joint, time, value, limit);
            record(Quantity::PositionMin, point.q, limits.q_min[j] + margins.position);
            record(Quantity::PositionMax, point.q, limits.q_max[j] - margins.position);
            let [down, up] = bounds.speeds(j, point.q);
            record(Quantity::Velocity, point.dq.abs(), if point.dq < 0.0 { down } else { up });
            record(Quantity::Acceleration, point.ddq.abs(), limits.ddq[j] * margins.acceleration);
            record(Quantity::Jerk, point.jerk.abs(), limits.jerk[j] * margins.jerk);
        }
        check.record_space(&mut slot, bounds, &q[..n], time);
        if let Some(torque) = torque {
            let tau = torque(&q, &dq, &ddq);
            let before = last_tau.unwrap_or(tau);
            for j in 0..n {
                let joint = Some(j + 1);
                let rate = (tau[j] - before[j]).abs() / dt;
                check.record(&mut slot, Quantity::Torque, joint, time, tau[j].abs(), limits.tau[j] * margins.torque);
                check.record(&mut slot, Quantity::TorqueRate, joint, time, rate, limits.dtau[j] * margins.torque_rate);
            }
            last_tau = Some(tau);
        }
    }
    check
}

/// [`check`] at 1 kHz.
pub fn verify(bounds: &Bounds, fourier: &Fourier, torque: Option<NominalTorque>) -> Check {
    check(bounds, fourier, (fourier.period * VERIFY_RATE_HZ).round().max(1.0) as usize, torque)
}

#[cfg(test)]
mod tests;
