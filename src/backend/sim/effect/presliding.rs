//! Presliding: after a reversal the contact bends like a bristle before it slides, so friction follows the displacement, not the velocity.
//!
//! LuGre (Canudas de Wit, Olsson, Astrom, Lischinsky 1995) in the joint's own Coulomb level:
//!
//!   dz/dt = dq - |dq| z / s(dq),  s(dq) = delta g(dq) / fc,  tau_f = (fc / delta) z + damping dz/dt,
//!   g(dq) = fc (1 + (breakaway - 1) exp(-(dq / stribeck-velocity)^2)).
//!
//! With `breakaway = 1` and no damping it is Dahl's law, `d tau_f / dq = (fc / delta) (1 - sgn(dq) tau_f / fc)`. The bristle `z` is a
//! state of the arm and is integrated with it.

use super::{At, Effect, check_joint, check_range};
use crate::backend::sim::truth::Truth;
use crate::input::BadInput;
use crate::joint::JointVec;
use serde::Deserialize;

/// Takes the place of a joint's `fc tanh(100 dq)`, with the same `fc`; its viscous friction stays.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Displacement at which a new bristle would carry `fc` \[rad\].
    pub delta: f64,
    /// Damping of the bristles \[Nms/rad\].
    #[serde(default)]
    pub damping: f64,
    /// Friction at the first slip over Coulomb friction, at least 1.
    #[serde(default = "one")]
    pub breakaway: f64,
    /// Velocity over which the breakaway excess fades \[rad/s\].
    #[serde(default = "tenth")]
    pub stribeck_velocity: f64,
}

pub(super) struct Presliding {
    config: Config,
    joint: usize,
    stiffness: f64,
}

impl Config {
    pub(super) fn check(&self, file: &str, place: &str, truth: &Truth) -> Result<(), BadInput> {
        check_joint(file, place, self.joint, truth)?;
        // Below a tenth of a milliradian the bristle is too fast for the arm's integration steps.
        check_range(file, place, "delta", self.delta, 1e-4, 1.0)?;
        check_range(file, place, "damping", self.damping, 0.0, 100.0)?;
        check_range(file, place, "breakaway", self.breakaway, 1.0, 10.0)?;
        check_range(file, place, "stribeck-velocity", self.stribeck_velocity, 1e-3, 10.0)
    }

    pub(super) fn build(&self, truth: &Truth) -> Presliding {
        let joint = self.joint - 1;
        Presliding { config: *self, joint, stiffness: truth.joints[joint].fc / self.delta }
    }
}

impl Effect for Presliding {
    fn states(&self) -> usize {
        1
    }

    fn replaces_coulomb(&self, joint: usize) -> bool {
        joint == self.joint
    }

    fn torque(&self, at: &At, x: &[f64], dx: &mut [f64], tau: &mut JointVec) {
        let dq = at.dq[self.joint];
        let excess = (self.config.breakaway - 1.0) * (-(dq / self.config.stribeck_velocity).powi(2)).exp();
        dx[0] = dq - dq.abs() * x[0] / (self.config.delta * (1.0 + excess));
        tau[self.joint] -= self.stiffness * x[0] + self.config.damping * dx[0];
    }
}

fn one() -> f64 {
    1.0
}

fn tenth() -> f64 {
    0.1
}
