//! Load-dependent friction: friction of gears and bearings in proportion to their load.
//!
//!   tau_f = (coulomb s(dq) + viscous dq) |tau_l|,   s(dq) = tanh(100 dq),
//!
//! where `tau_l` is the torque of the links, undeclared payloads, tilt and contact included: the actuators' torque less this friction and the
//! effects listed before. The equation is solved for it: `tau_l = tau / (1 + c sgn(tau))` with
//! `c = coulomb s(dq) + viscous dq`.
//! Source: Hamon, Gautier and Garrec, Dynamic identification of robots with a dry friction model depending on load and velocity,
//! IROS 2010; Bittencourt and Gunnarsson, Static friction in a robot joint, 2012.

use super::*;

/// Adds to the joint's friction.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Friction per load that does not depend on speed.
    #[serde(default)]
    pub coulomb: f64,
    /// Friction per load that grows with speed \[s/rad\].
    #[serde(default)]
    pub viscous: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("coulomb", self.coulomb, 0.0, 0.3)?;
        place.range("viscous", self.viscous, 0.0, 0.1)
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.joint - 1;
        // Limited to 90 %, where a gear locks.
        let share = (self.coulomb * sign(at.dq[j]) + self.viscous * at.dq[j]).clamp(-0.9, 0.9);
        tau[j] /= 1.0 + share * tau[j].signum();
    }
}
