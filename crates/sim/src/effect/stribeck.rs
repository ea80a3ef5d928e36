//! Stribeck friction: at low speed the lubricant carries less and the surfaces touch.
//!
//!   tau_f = fc s(dq) + excess exp(-(dq / velocity)^2) s(dq),   s(dq) = tanh(100 dq),
//!
//! where `excess = fs - fc` is static over Coulomb friction and every joint has the first term. With a `velocity` as low as the width of
//! `s` (0.01 rad/s) the bump does not reach its full height.
//! Source: Armstrong-Helouvry, Dupont and Canudas de Wit, A survey of models, analysis tools and compensation methods for the control
//! of machines with friction, Automatica 1994; Bittencourt and Gunnarsson, Static friction in a robot joint, 2012.

use super::*;

/// Adds to the joint's friction.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Static friction above Coulomb friction \[Nm\].
    pub excess: f64,
    /// Stribeck velocity \[rad/s\].
    pub velocity: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("excess", self.excess, 0.0, 100.0)?;
        place.range("velocity", self.velocity, 1e-3, 10.0)
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.joint - 1;
        tau[j] -= self.excess * (-(at.dq[j] / self.velocity).powi(2)).exp() * sign(at.dq[j]);
    }
}
