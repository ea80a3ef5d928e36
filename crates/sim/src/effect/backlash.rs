//! Backlash: a transmission with play is on one flank or the other, by the sign of its torque. The encoder is on the motor's side:
//!
//!   q_measured = q + gap / 2 tanh(tau / load)
//!
//! with `tau` the torque through the transmission. `load` is the torque at which the play is 76 % used up: teeth, oil and bearings deform
//! before a flank carries load. That is the curve of torsion against torque from which makers of gears read the lost motion. The crossing
//! takes at least one integration step.

use super::twist::{Deflection, Twist};
use super::*;

/// Acts between motor and link.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Width of the play \[rad\].
    pub gap: f64,
    /// Torque that closes it \[Nm\].
    #[serde(default = "half")]
    pub load: f64,
}

struct Gap {
    half: f64,
    load: f64,
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("gap", self.gap, 0.0, 0.1)?;
        place.range("load", self.load, 0.01, 100.0)
    }

    fn build(&self, truth: &Truth, _from: f64) -> Box<dyn Effect> {
        Box::new(Twist::new(self.joint - 1, truth, Gap { half: self.gap / 2.0, load: self.load }))
    }
}

impl Deflection for Gap {
    fn under(&self, tau: f64) -> (f64, f64) {
        let flank = (tau / self.load).tanh();
        (self.half * flank, self.half / self.load * (1.0 - flank * flank))
    }
}
