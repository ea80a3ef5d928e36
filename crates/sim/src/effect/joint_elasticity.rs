//! Joint elasticity: a gear, a torque sensor and their shafts twist under load, and the encoder sits on the motor's side.
//!
//!   q_measured = q + tau / stiffness
//!
//! with `tau` the torque through the transmission, which the torque sensor measures. Quasi-static: the motor's inertia, and with it the resonance,
//! is left out; the twist follows with a lag of one integration step. Source: Spong, Modeling and control of elastic joint robots,
//! 1987; Albu-Schaeffer, Ott and Hirzinger, A unified passivity-based control framework, IJRR 2007.

use super::twist::{Deflection, Twist};
use super::*;

/// Acts between motor and link.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Stiffness of the transmission \[Nm/rad\].
    pub stiffness: f64,
}

struct Linear {
    compliance: f64,
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("stiffness", self.stiffness, 100.0, 1e8)
    }

    fn build(&self, truth: &Truth, _from: f64) -> Box<dyn Effect> {
        Box::new(Twist::new(self.joint - 1, truth, Linear { compliance: 1.0 / self.stiffness }))
    }
}

impl Deflection for Linear {
    fn under(&self, tau: f64) -> (f64, f64) {
        (self.compliance * tau, self.compliance)
    }
}
