//! Made up, for one test: a torque that no arm has, `tau_f = size q dq`. Only the feature `made-up-effect` has it.

use super::*;

/// Takes a torque of the joint.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Torque per position and velocity \[Nms/rad2\].
    pub size: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("size", self.size, -1.0, 1.0)
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.joint - 1;
        tau[j] -= self.size * at.q[j] * at.dq[j];
    }
}
