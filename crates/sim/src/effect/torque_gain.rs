//! Torque-sensor gain: the sensitivity of a bridge, or a motor's torque constant, differs from the arm's calibration.
//!
//!   tau_measured = gain tau
//!
//! Source: Ma and Hollerbach, Identifying mass parameters for gravity compensation and automatic torque sensor calibration, ICRA 1996.

use super::*;

/// Acts on the reading, after the effects listed before it.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Reported torque over true torque; 1.03 reports 3 % too much.
    pub gain: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("gain", self.gain, 0.1, 10.0)
    }
}

impl Effect for Config {
    fn sense(&mut self, _at: &At, reading: &mut Reading) {
        reading.tau[self.joint - 1] *= self.gain;
    }
}
