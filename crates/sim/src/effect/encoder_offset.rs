//! Encoder offset: a wrong zero of a joint.
//!
//!   q_measured = q + offset
//!
//! The arm's controller uses the same reading, so the arm's true position differs from the reading. Source: Hollerbach, Khalil and Gautier, Model
//! identification, Springer Handbook of Robotics, 2016 (joint offsets).

use super::*;

/// Acts on the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Offset \[rad\].
    pub offset: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("offset", self.offset, -1.0, 1.0)
    }
}

impl Effect for Config {
    fn encoder(&self, _at: &At, _x: &[f64], _dx: &mut [f64], q: &mut JointVec, _dq: &mut JointVec) {
        q[self.joint - 1] += self.offset;
    }
}
