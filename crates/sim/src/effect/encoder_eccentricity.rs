//! Encoder eccentricity: the disc of an encoder sits beside its axis, or a gear in front of it has a transmission error.
//!
//!   q_measured = q + amplitude sin(order q + phase),   dq_measured = dq (1 + amplitude order cos(order q + phase))
//!
//! The arm's controller uses the same reading. The equation is the geometry of a circle that is read from beside its centre: with the disc `e`
//! off the axis and the mark at radius `r`, the error is `e / r sin(q + phase)` for small `e / r`.

use super::*;

/// Acts on the encoder.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Amplitude of the error \[rad\].
    pub amplitude: f64,
    /// Phase at position zero \[rad\].
    #[serde(default)]
    pub phase: f64,
    /// Waves in a turn: 1 of an eccentric disc.
    #[serde(default = "one")]
    pub order: f64,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("order", self.order, 0.1, 1000.0)?;
        // An encoder that runs backwards is broken, not eccentric.
        let most = 0.2 / self.order;
        place.range("amplitude", self.amplitude, -most, most)?;
        place.range("phase", self.phase, -100.0, 100.0)
    }
}

impl Effect for Config {
    fn encoder(&self, at: &At, _x: &[f64], _dx: &mut [f64], q: &mut JointVec, dq: &mut JointVec) {
        let (j, order) = (self.joint - 1, self.order);
        let (sin, cos) = (order * at.q[j] + self.phase).sin_cos();
        q[j] += self.amplitude * sin;
        dq[j] += self.amplitude * order * cos * at.dq[j];
    }
}
