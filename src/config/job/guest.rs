//! `[backend.guest]`: an arm that another program controls and publishes the states of.

use crate::config::units;
use plumbline_core::{BadInput, PERIOD_S};
use schemars::JsonSchema;
use serde::Deserialize;

/// How long is listened to an arm that another program controls.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Guest {
    /// States that the controller publishes per second \[Hz\].
    #[serde(with = "units::Frequency")]
    pub rate: f64,
    /// Recorded motion to identify from \[s\].
    #[serde(with = "units::Duration")]
    pub identify: f64,
    /// Recorded motion after that, kept aside to validate with; 0 s for none \[s\].
    #[serde(with = "units::Duration")]
    pub validate: f64,
    /// Longest run: both are divided into runs of equal length \[s\].
    #[serde(with = "units::Duration")]
    pub run: f64,
}

impl Default for Guest {
    fn default() -> Guest {
        Guest { rate: 1.0 / PERIOD_S, identify: 120.0, validate: 40.0, run: 20.0 }
    }
}

impl Guest {
    pub(super) fn check(&self, file: &str) -> Result<(), BadInput> {
        let within = |key: &str, value: f64, unit: &str, [least, most]: [f64; 2]| match (least..=most).contains(&value)
        {
            true => Ok(()),
            false => {
                let expected = format!("{least} {unit} to {most} {unit}");
                Err(BadInput::new(file, format!("key `backend.guest.{key}`"), format!("{value} {unit}"), expected))
            }
        };
        within("rate", self.rate, "Hz", [100.0, 1.0 / PERIOD_S])?;
        within("identify", self.identify, "s", [5.0, 86_400.0])?;
        within("validate", self.validate, "s", [0.0, 86_400.0])?;
        within("run", self.run, "s", [5.0, 3600.0])
    }

    /// Time between two states \[s\].
    pub fn period(&self) -> f64 {
        1.0 / self.rate
    }

    /// Number of runs that `duration` is divided into, and the samples of each.
    pub fn runs(&self, duration: f64) -> (usize, usize) {
        let count = (duration / self.run - 1e-9).ceil().max(0.0) as usize;
        (count, (self.rate * duration / count.max(1) as f64).round() as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_duration_is_divided_into_equal_runs() {
        let guest = Guest { run: 20.0, ..Guest::default() };
        assert_eq!([120.0, 50.0, 8.0, 0.0].map(|s| guest.runs(s)), [(6, 20_000), (3, 16_667), (1, 8000), (0, 0)]);
        let slow = Guest { rate: 250.0, ..guest };
        assert_eq!([120.0, 8.0].map(|s| slow.runs(s)), [(6, 5000), (1, 2000)]);
    }
}
