//! Rotor inertia at the joint's side of the gear, for torques that are measured on the motor's side.
//!
//!   tau_j = ... + inertia ddq_j,   inertia = N^2 J of a rotor of J kg m2 behind a gear of ratio N.
//!
//! Gyroscopic effects of the rotor are neglected. Source: Khalil and Dombre, Modeling, identification and control of
//! robots, 2002.

use super::*;

/// Adds to the inertia of one joint.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Inertia on the joint's side of the gear \[kg m2\].
    pub inertia: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("inertia", self.inertia, 0.0, 100.0)
    }
}

impl Effect for Config {
    fn armature(&self, _t: f64, joint: usize) -> f64 {
        if joint + 1 == self.joint { self.inertia } else { 0.0 }
    }
}
