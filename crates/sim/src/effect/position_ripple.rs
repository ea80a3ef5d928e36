//! Position ripple: a torque wave over the joint's position, `order` waves per turn.
//!
//!   tau_measured = tau + sine sin(order q) + cosine cos(order q)
//!
//! `on = "sensor"` ripples the sensor alone, as a flexspline that passes under strain gauges does; `on = "joint"` is a real torque against the
//! motion, as cogging is, which also shakes the arm. Both measure the same along the same motion. A harmonic drive of ratio N has the
//! orders 2N, 4N, N, 2 and 1.
//! Source: Taghirad and Belanger, Torque ripple and misalignment torque compensation for the built-in torque sensor of harmonic drive
//! systems, 1998.

use super::*;

/// Place of the ripple.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum On {
    /// The measured torque.
    #[default]
    Sensor,
    /// The torque of the links.
    Joint,
}

/// A wave of any order.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Waves per turn.
    pub order: f64,
    /// Amplitude of the sine \[Nm\].
    #[serde(default)]
    pub sine: f64,
    /// Amplitude of the cosine \[Nm\].
    #[serde(default)]
    pub cosine: f64,
    /// Place of the ripple; default the sensor.
    #[serde(default)]
    pub on: On,
}

impl Stateless for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("order", self.order, 0.1, 2000.0)?;
        place.range("sine", self.sine, -100.0, 100.0)?;
        place.range("cosine", self.cosine, -100.0, 100.0)
    }
}

impl Config {
    fn at(&self, q: f64) -> f64 {
        let (sin, cos) = (self.order * q).sin_cos();
        self.sine * sin + self.cosine * cos
    }
}

impl Effect for Config {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        if self.on == On::Joint {
            let j = self.joint - 1;
            tau[j] -= self.at(at.q[j]);
        }
    }

    fn sense(&mut self, at: &At, reading: &mut Reading) {
        if self.on == On::Sensor {
            let j = self.joint - 1;
            reading.tau[j] += self.at(at.q[j]);
        }
    }
}
