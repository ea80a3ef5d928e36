//! Spring: a dress pack that twists, a balancer, a stop of rubber.
//!
//!   tau = stiffness x + cubic x^3,   x = q - rest, or only its positive part (`side = "above"`), or only its negative part ("below").
//!
//! Source: FloBaRoID (Bethge, Malzahn, Tsagarakis and Caldwell, 2017) simulates cables so; the cubic part stands for a spring that stiffens.

use super::{At, Effect, Place, Spec};
use crate::truth::Truth;
use plumbline_core::{BadInput, JointVec};
use serde::Deserialize;

/// Where the spring pulls.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Side {
    /// Everywhere.
    #[default]
    Both,
    /// Above the rest position alone.
    Above,
    /// Below the rest position alone.
    Below,
}

/// A spring between a link and the one before.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Stiffness \[Nm/rad\].
    #[serde(default)]
    pub stiffness: f64,
    /// Coefficient of the third power \[Nm/rad3\].
    #[serde(default)]
    pub cubic: f64,
    /// Position at which it does not pull \[rad\].
    #[serde(default)]
    pub rest: f64,
    /// Where it pulls.
    #[serde(default)]
    pub side: Side,
}

struct Spring(Config);

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("stiffness", self.stiffness, -100.0, 1e4)?;
        place.range("cubic", self.cubic, -100.0, 1e4)?;
        place.range("rest", self.rest, -100.0, 100.0)
    }

    fn build(&self, _truth: &Truth, _from: f64) -> Box<dyn Effect> {
        Box::new(Spring(*self))
    }
}

impl Effect for Spring {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.0.joint - 1;
        let x = at.q[j] - self.0.rest;
        let x = match self.0.side {
            Side::Both => x,
            Side::Above => x.max(0.0),
            Side::Below => x.min(0.0),
        };
        tau[j] -= self.0.stiffness * x + self.0.cubic * x * x * x;
    }
}
