//! Made up, for one test: a torque that no arm has, `tau_f = size q dq`. Only the feature `made-up-effect` has it.

use super::{At, Effect, Place, Spec};
use crate::truth::Truth;
use plumbline_core::{BadInput, JointVec};
use serde::Deserialize;

/// Takes a torque of the joint.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Torque per position and velocity \[Nms/rad2\].
    pub size: f64,
}

struct MadeUp(Config);

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("size", self.size, -1.0, 1.0)
    }

    fn build(&self, _truth: &Truth, _from: f64) -> Box<dyn Effect> {
        Box::new(MadeUp(*self))
    }
}

impl Effect for MadeUp {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.0.joint - 1;
        tau[j] -= self.0.size * at.q[j] * at.dq[j];
    }
}
