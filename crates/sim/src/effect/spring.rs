//! Spring: a dress pack, a balancer, a rubber stop.
//!
//!   tau = stiffness x + cubic x^3,   x = q - rest, or only its positive part (`side = "above"`), or only its negative part ("below").
//!
//! Source: FloBaRoID (Bethge, Malzahn, Tsagarakis and Caldwell, 2017) simulates cables in this way; the cubic part is a stiffening spring.

use super::*;

/// Side on which the spring acts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
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
    /// Position of zero force \[rad\].
    #[serde(default)]
    pub rest: f64,
    /// Side on which it acts.
    #[serde(default)]
    pub side: Side,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("stiffness", self.stiffness, -100.0, 1e4)?;
        place.range("cubic", self.cubic, -100.0, 1e4)?;
        place.range("rest", self.rest, -100.0, 100.0)
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let j = self.joint - 1;
        let x = at.q[j] - self.rest;
        let x = match self.side {
            Side::Both => x,
            Side::Above => x.max(0.0),
            Side::Below => x.min(0.0),
        };
        tau[j] -= self.stiffness * x + self.cubic * x * x * x;
    }
}
