//! Torque cross-talk: the bridge of one joint's sensor feels what another joint carries.
//!
//!   tau_measured_j = tau_j + share tau_other
//!
//! Source: Taghirad and Belanger, Torque ripple and misalignment torque compensation for the built-in torque sensor of harmonic drive
//! systems, 1998.

use super::*;

/// Acts on what is reported, as the effects listed before it left it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint whose sensor feels it, counted from 1.
    pub joint: usize,
    /// Joint whose torque it feels, counted from 1.
    pub other: usize,
    /// How much of it.
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
