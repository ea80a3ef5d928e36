//! `[backend.guest]`: an arm that another program controls and publishes the states of.

use crate::config::units;
use plumbline_core::BadInput;
use schemars::JsonSchema;
use serde::Deserialize;

/// How long is listened to an arm that another program controls.
#[derive(Clone, Debug, PartialEq, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Guest {
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
        Guest { identify: 120.0, validate: 40.0, run: 20.0 }
    }
}

impl Guest {
    pub(super) fn check(&self, file: &str) -> Result<(), BadInput> {
        let within = |key: &str, value: f64, [least, most]: [f64; 2]| match (least..=most).contains(&value) {
            true => Ok(()),
            false => {
                let expected = format!("{least} s to {most} s");
                Err(BadInput::new(file, format!("key `backend.guest.{key}`"), format!("{value} s"), expected))
            }
        };
        within("identify", self.identify, [5.0, 86_400.0])?;
        within("validate", self.validate, [0.0, 86_400.0])?;
        within("run", self.run, [5.0, 3600.0])
    }

    /// Number of runs that `duration` is divided into, and the samples of each, at 1 kHz.
    pub fn runs(&self, duration: f64) -> (usize, usize) {
        let count = (duration / self.run - 1e-9).ceil().max(0.0) as usize;
        (count, (1000.0 * duration / count.max(1) as f64).round() as usize)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_duration_is_divided_into_equal_runs() {
        let guest = Guest { run: 20.0, ..Guest::default() };
        assert_eq!([120.0, 50.0, 8.0, 0.0].map(|s| guest.runs(s)), [(6, 20_000), (3, 16_667), (1, 8000), (0, 0)]);
    }
}
