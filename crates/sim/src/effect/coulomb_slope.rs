//! Coulomb friction whose sign is less steep than that of every joint.
//!
//!   tau_f = fc s(dq) + size (g(dq / velocity) - s(dq)),   s(dq) = tanh(100 dq),
//!
//! with `g = tanh`, or `g = 2/pi atan`, which approaches 1 slowly.
//! Source: Makkar, Dixon, Sawyer and Hu, A new continuously differentiable friction model for control systems design, IEEE/ASME AIM 2005.

use super::*;
use std::f64::consts::FRAC_2_PI;

/// Adds to the joint's friction.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Part of the Coulomb friction with this slope \[Nm\].
    pub size: f64,
    /// Speed over which it rises \[rad/s\].
    pub velocity: f64,
    /// How it rises.
    #[serde(default)]
    pub form: Form,
}

/// How friction rises with speed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Form {
    /// `tanh(x)`.
    #[default]
    Tanh,
    /// `2/pi atan(x)`.
    Arctan,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("size", self.size, 0.0, 100.0)?;
        place.range("velocity", self.velocity, 1e-3, 10.0)
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.joint - 1;
        let x = at.dq[j] / self.velocity;
        let rise = match self.form {
            Form::Tanh => x.tanh(),
            Form::Arctan => FRAC_2_PI * x.atan(),
        };
        tau[j] -= self.size * (rise - sign(at.dq[j]));
    }
}
