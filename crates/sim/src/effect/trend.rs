//! Courses of drifts of friction and sensor zeros.

use super::Place;
use plumbline_core::BadInput;
use serde::Deserialize;

/// The course of a change over time since its beginning.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Trend {
    /// `1 - exp(-t / time)`: the arm warms up and stays warm.
    #[default]
    Exponential,
    /// `t / time`, without an end.
    Linear,
}

impl Trend {
    /// Ratio of the change after `t` \[s\]; `time` \[s\] is the time constant, or the duration of the linear change.
    pub(super) fn at(self, t: f64, time: f64) -> f64 {
        let t = t.max(0.0);
        match self {
            Trend::Exponential => -(-t / time).exp_m1(),
            Trend::Linear => t / time,
        }
    }
}

/// Checks the time constant of a drift.
pub(super) fn check_time(place: &Place, time: f64) -> Result<(), BadInput> {
    place.range("time", time, 0.1, 1e6)
}
