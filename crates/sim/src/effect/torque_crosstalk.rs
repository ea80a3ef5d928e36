//! Torque cross-talk: one joint's sensor measures a part of another joint's torque.
//!
//!   tau_measured_j = tau_j + share tau_other
//!
//! Source: Taghirad and Belanger, Torque ripple and misalignment torque compensation for the built-in torque sensor of harmonic drive
//! systems, 1998.

use super::*;

/// Acts on the reading, after the effects listed before it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint of the sensor, counted from 1.
    pub joint: usize,
    /// Joint of the torque, counted from 1.
    pub other: usize,
    /// Ratio of that torque.
    pub share: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.other("other", self.other, self.joint)?;
        place.range("share", self.share, -1.0, 1.0)
    }
}

impl Effect for Config {
    fn sense(&mut self, _at: &At, reading: &mut Reading) {
        reading.tau[self.joint - 1] += self.share * reading.tau[self.other - 1];
    }
}
