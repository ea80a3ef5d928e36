//! Asymmetric Coulomb friction: larger in one direction than in the other.
//!
//!   tau_f = (fc + asymmetry) s(dq) for dq > 0, (fc - asymmetry) s(dq) for dq < 0,   s(dq) = tanh(100 dq),
//!
//! that is `asymmetry |s(dq)|` besides `fc s(dq)`. It vanishes at rest, unlike a torque offset.
//! Source: Bona and Indri, Friction compensation in robotics: an overview, CDC 2005.

use super::*;

/// Adds to the joint's friction.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Half the difference between the friction of the two directions, at most the joint's `fc` \[Nm\].
    pub asymmetry: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        // Friction must not drive the joint.
        let fc = place.truth.joints[self.joint - 1].fc;
        place.range("asymmetry", self.asymmetry, -fc, fc)
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.joint - 1;
        tau[j] -= self.asymmetry * sign(at.dq[j]).abs();
    }
}
