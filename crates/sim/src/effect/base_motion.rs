//! Base motion: vibration of the base, independent of the arm. The base frame accelerates by
//!
//!   a(t) = amplitude sin(2 pi frequency (t - from) + phase) direction,
//!
//! without turning, so gravity in the base frame is `a_g - a(t)` (Featherstone, Rigid Body Dynamics Algorithms, 2008, section 5.3). It
//! repeats with an excitation only where `frequency` is a multiple of one over the excitation's period.

use super::*;
use std::f64::consts::TAU;

/// A sinusoidal acceleration.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Frequency \[Hz\].
    pub frequency: f64,
    /// Amplitude of the acceleration \[m/s2\].
    pub amplitude: f64,
    /// Direction in the base frame, of any length.
    pub direction: [f64; 3],
    /// Phase when it begins \[rad\].
    #[serde(default)]
    pub phase: f64,
}

struct BaseMotion {
    config: Config,
    acceleration: Vector3<f64>,
    from: f64,
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.range("frequency", self.frequency, 1e-3, 100.0)?;
        place.range("amplitude", self.amplitude, 0.0, 100.0)?;
        place.range("phase", self.phase, -100.0, 100.0)?;
        place.finite("direction", &self.direction)?;
        if Vector3::from(self.direction).norm() > 1e-9 {
            return Ok(());
        }
        Err(place.wrong("direction", format!("{:?}", self.direction), "a direction, not zero"))
    }

    fn build(&self, _truth: &Truth, from: f64) -> Box<dyn Effect> {
        let acceleration = self.amplitude * Vector3::from(self.direction).normalize();
        Box::new(BaseMotion { config: *self, acceleration, from })
    }
}

impl Effect for BaseMotion {
    fn repeats(&self, period: f64) -> bool {
        let turns = self.config.frequency * period;
        (turns - turns.round()).abs() < 1e-9 * turns.max(1.0)
    }

    fn gravity(&self, t: f64, gravity: &mut Vector3<f64>) {
        *gravity -= self.acceleration * (TAU * self.config.frequency * (t - self.from) + self.config.phase).sin();
    }
}
