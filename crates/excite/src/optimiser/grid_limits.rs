//! Limits on the search grid: the limits less margins, tightened by violations found between the samples of the grid.

use super::super::limits::{Bounds, Check, Peak, Quantity};
use plumbline_core::{JointVec, MAX_JOINTS};

/// Limits on the grid.
#[derive(Clone, Debug)]
pub struct GridLimits {
    /// Lowest positions \[rad\].
    pub q_min: JointVec,
    /// Highest positions \[rad\].
    pub q_max: JointVec,
    /// Ratio of the speed limits that may be used.
    pub speed: JointVec,
    /// Highest accelerations \[rad/s2\].
    pub ddq: JointVec,
    /// Highest jerks \[rad/s3\].
    pub jerk: JointVec,
    /// Highest torques \[Nm\].
    pub tau: JointVec,
    /// Highest torque rates \[Nm/s\].
    pub dtau: JointVec,
    /// Box of the end effector \[m\].
    pub end: [[f64; 3]; 2],
    /// Box of every link's surface \[m\].
    pub links: [[f64; 3]; 2],
    /// Minimum distance of the end effector from the base \[m\].
    pub radius: f64,
    /// Minimum distance between two links \[m\].
    pub clearance: f64,
}

/// Tightening of a violated limit as a ratio of the excess.
const OVERSHOOT_RATIO: f64 = 1.5;
const MIN_TIGHTENING_RATIO: f64 = 5e-4;

impl GridLimits {
    /// The limits of `bounds` less their margins.
    pub fn of(bounds: &Bounds) -> GridLimits {
        let (limits, margins) = (bounds.limits, &bounds.margins);
        let scaled = |values: &JointVec, share: f64| values.map(|value| value * share);
        let space = |side: fn(&plumbline_core::Workspace) -> [f64; 3], shift: f64| {
            bounds.workspace.map_or([shift * 1e9; 3], |w| side(w).map(|x| x - shift * margins.workspace))
        };
        let sides = [space(|w| w.box_min, -1.0), space(|w| w.box_max, 1.0)];
        GridLimits {
            q_min: limits.q_min.map(|q| q + margins.position),
            q_max: limits.q_max.map(|q| q - margins.position),
            speed: [margins.velocity; MAX_JOINTS],
            ddq: scaled(&limits.ddq, margins.acceleration),
            jerk: scaled(&limits.jerk, margins.jerk),
            tau: scaled(&limits.tau, margins.torque),
            dtau: scaled(&limits.dtau, margins.torque_rate),
            end: sides,
            links: sides,
            radius: bounds.workspace.map_or(0.0, |w| w.base_radius + margins.workspace),
            clearance: margins.clearance,
        }
    }

    /// Tightens the limits that a motion violates.
    pub fn tighten(&mut self, check: &Check) {
        for peak in check.violations() {
            self.tighten_one(peak);
        }
    }

    fn tighten_one(&mut self, peak: &Peak) {
        let excess = -peak.headroom();
        let by = if excess.is_finite() {
            OVERSHOOT_RATIO * excess + MIN_TIGHTENING_RATIO * peak.limit.abs().min(1.0)
        } else {
            return;
        };
        let share =
            1.0 - (OVERSHOOT_RATIO * excess / peak.limit.abs().max(1e-9) + MIN_TIGHTENING_RATIO).clamp(0.0, 0.3);
        let j = peak.joint.map_or(0, |joint| joint - 1);
        match peak.quantity {
            Quantity::PositionMin | Quantity::StopMin => self.q_min[j] += by,
            Quantity::PositionMax | Quantity::StopMax => self.q_max[j] -= by,
            Quantity::Velocity | Quantity::VelocityAhead => self.speed[j] *= share,
            Quantity::Acceleration => self.ddq[j] *= share,
            Quantity::Jerk => self.jerk[j] *= share,
            Quantity::Torque => self.tau[j] *= share,
            Quantity::TorqueRate => {
                // Coulomb friction reverses within a few ms, between grid samples: its torque rate is proportional to the acceleration.
                self.dtau[j] *= share;
                self.ddq[j] *= share;
            }
            Quantity::BoxMin(axis) => self.end[0][axis] += by,
            Quantity::BoxMax(axis) => self.end[1][axis] -= by,
            Quantity::BaseSphere => self.radius += by,
            Quantity::LinkBoxMin(axis) => self.links[0][axis] += by,
            Quantity::LinkBoxMax(axis) => self.links[1][axis] -= by,
            Quantity::Clearance(..) => self.clearance += by,
        }
    }
}
