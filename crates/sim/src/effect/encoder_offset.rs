//! Encoder offset: a joint whose zero was set wrong.
//!
//!   q_measured = q + offset
//!
//! The arm's controller uses the same reading, so the arm's true position differs from the reading. Source: Hollerbach, Khalil and Gautier, Model
//! identification, Springer Handbook of Robotics, 2016 (joint offsets).

use super::{At, Effect, Place, Spec};
use crate::truth::Truth;
use plumbline_core::{BadInput, JointVec};
use serde::Deserialize;

/// Acts on the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Offset \[rad\].
    pub offset: f64,
}

struct EncoderOffset(Config);

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("offset", self.offset, -1.0, 1.0)
    }

    fn build(&self, _truth: &Truth, _from: f64) -> Box<dyn Effect> {
        Box::new(EncoderOffset(*self))
    }
}

impl Effect for EncoderOffset {
    fn encoder(&self, _at: &At, _x: &[f64], _dx: &mut [f64], q: &mut JointVec, _dq: &mut JointVec) {
        q[self.0.joint - 1] += self.0.offset;
    }
}
