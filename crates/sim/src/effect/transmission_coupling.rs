//! Transmission coupling: friction that depends on two joints, as in the wrists of many arms.
//!
//! With a `ratio`, a shaft or seal turns with `u = dq_j + ratio dq_other`, and its friction takes torque of both joints by the principle of
//! virtual work:
//!
//!   f = fv u + fc s(u),   tau_j = ... + f,   tau_other = ... + ratio f,   s(u) = tanh(100 u).
//!
//! Without one, the friction of the other joint's drive is borne by this joint's transmission: `f` of `u = dq_other`, on joint j alone.
//! Source: the coupled wrist of the Staubli TX40 in Gautier, Janot and Vandanjon, A new closed-loop output error method for parameter
//! identification of robot dynamics, 2013.

use super::*;

/// Friction between two joints.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// The other joint, counted from 1.
    pub other: usize,
    /// Turns of the other joint per turn of this one in the part's motion; absent: friction of the other joint's drive, on this joint.
    pub ratio: Option<f64>,
    /// Coulomb friction \[Nm\].
    #[serde(default)]
    pub fc: f64,
    /// Viscous friction \[Nms/rad\].
    #[serde(default)]
    pub fv: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.other("other", self.other, self.joint)?;
        place.range("ratio", self.ratio.unwrap_or(0.0), -10.0, 10.0)?;
        place.range("fc", self.fc, 0.0, 100.0)?;
        place.range("fv", self.fv, 0.0, 100.0)
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let (j, k) = (self.joint - 1, self.other - 1);
        let friction = |u: f64| self.fv * u + self.fc * sign(u);
        match self.ratio {
            Some(ratio) => {
                let f = friction(at.dq[j] + ratio * at.dq[k]);
                tau[j] -= f;
                tau[k] -= ratio * f;
            }
            None => tau[j] -= friction(at.dq[k]),
        }
    }
}
