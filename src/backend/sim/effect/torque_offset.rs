//! Torque-sensor offset: the zero of a strain gauge or its amplifier is off.

use super::{At, Effect, Reading, check_joint, check_range};
use crate::backend::sim::truth::Truth;
use crate::input::BadInput;
use serde::Deserialize;

/// `tau_measured = tau + offset`.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Offset \[Nm\].
    pub offset: f64,
}

pub(super) struct TorqueOffset(Config);

impl Config {
    pub(super) fn check(&self, file: &str, place: &str, truth: &Truth) -> Result<(), BadInput> {
        check_joint(file, place, self.joint, truth)?;
        check_range(file, place, "offset", self.offset, -1e3, 1e3)
    }

    pub(super) fn build(&self) -> TorqueOffset {
        TorqueOffset(*self)
    }
}

impl Effect for TorqueOffset {
    fn sense(&mut self, _at: &At, _x: &[f64], reading: &mut Reading) {
        reading.tau[self.0.joint - 1] += self.0.offset;
    }
}
