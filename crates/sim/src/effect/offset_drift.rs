//! Offset drift: the zero of a torque sensor drifts as it warms up.
//!
//!   tau_measured = tau + drift g(t),   g(t) = 1 - exp(-(t - from) / time), or (t - from) / time.
//!
//! Source: the thermal zero shift that every data sheet of a strain-gauge sensor states.

use super::trend::check_time;
use super::*;

/// Acts on the reading, not on the arm.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// Offset in the end, or after `time` of a linear drift \[Nm\].
    pub drift: f64,
    /// Time constant, or the time in which a linear drift does it \[s\].
    pub time: f64,
    /// Course.
    #[serde(default)]
    pub trend: Trend,
}

struct OffsetDrift {
    config: Config,
    from: f64,
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("drift", self.drift, -1e3, 1e3)?;
        check_time(place, self.time)
    }

    fn build(&self, _truth: &Truth, from: f64) -> Box<dyn Effect> {
        Box::new(OffsetDrift { config: *self, from })
    }
}

impl Effect for OffsetDrift {
    fn repeats(&self, _period: f64) -> bool {
        false
    }

    fn sense(&mut self, at: &At, reading: &mut Reading) {
        let course = self.config.trend.at(at.t - self.from, self.config.time);
        reading.tau[self.config.joint - 1] += self.config.drift * course;
    }
}
