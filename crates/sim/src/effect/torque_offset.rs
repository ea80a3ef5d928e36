//! Torque-sensor offset: the zero of a strain gauge or its amplifier is off.
//!
//!   tau_measured = tau + offset
//!
//! Logs of two public Panda arms need such an offset more than any other single term (docs/results/real-arms.md).

use super::*;

/// Acts on the reading, not on the arm.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Offset \[Nm\].
    pub offset: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("offset", self.offset, -1e3, 1e3)
    }
}

impl Effect for Config {
    fn sense(&mut self, _at: &At, reading: &mut Reading) {
        reading.tau[self.joint - 1] += self.offset;
    }
}
