//! Asymmetric viscous friction: larger in one direction than in the other.
//!
//!   tau_f = (fv + asymmetry) dq for dq > 0, (fv - asymmetry) dq for dq < 0,
//!
//! that is `asymmetry |dq|` besides `fv dq`.
//! Source: Bona and Indri, Friction compensation in robotics: an overview, CDC 2005.

use super::*;

/// Adds to the joint's friction.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Half the difference between the coefficients of the two directions \[Nms/rad\].
    pub asymmetry: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        // More than `fv` would drive where Coulomb friction does not hold it, so that much needs Coulomb friction up to 2 rad/s.
        let joint = &place.truth.joints[self.joint - 1];
        let most = joint.fv + joint.fc / 2.0;
        place.range("asymmetry", self.asymmetry, -most, most)
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.joint - 1;
        tau[j] -= self.asymmetry * at.dq[j].abs();
    }
}
