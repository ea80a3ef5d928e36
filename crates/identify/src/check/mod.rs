//! Checks of recorded runs before anything is fitted to them: units, signs, columns, times, mounting, robot.
//!
//! [`samples()`] compares each channel with the robot's limits and with the other channels. [`dynamics`] fits the equations of motion, which are
//! linear in the parameters, once as declared and once for each mistake that is common (another mounting, two columns swapped, a sign, a
//! delay), and compares what the fits leave over. No prior of the arm's masses is used.

mod equations;
mod hypotheses;
mod period;
mod physics;
mod samples;

pub use hypotheses::dynamics;
pub use samples::samples;

use plumbline_model::Robot;
use serde::{Deserialize, Serialize};

/// Outcome of a check.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum State {
    /// Nothing is wrong.
    #[default]
    Pass,
    /// Unusual; a model can be identified, and may be wrong.
    Warn,
    /// Cannot be what the dataset declares; nothing is identified from it.
    Fail,
}

/// Result of one check of one run.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Name of the check, as `docs/reference/dataset.md` lists it.
    pub check: String,
    /// Outcome.
    pub state: State,
    /// File of the run.
    pub run: String,
    /// Joint, from 1; absent where the check is of the whole arm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint: Option<usize>,
    /// Column of the file, or key of `dataset.toml`.
    pub place: String,
    /// Evidence, in `unit`; of a check that passed, the largest.
    pub value: f64,
    /// Value at which the check does not pass, in `unit`.
    pub limit: f64,
    /// Unit of both; empty for a ratio.
    pub unit: String,
    /// What was found, in words.
    pub found: String,
    /// What was expected, and the probable mistake.
    pub expected: String,
}

impl Finding {
    fn new(check: &str, run: &str, place: impl Into<String>) -> Finding {
        Finding { check: check.into(), run: run.into(), place: place.into(), ..Finding::default() }
    }

    fn of_joint(self, j: usize) -> Finding {
        Finding { joint: Some(j + 1), ..self }
    }

    fn measured(self, value: f64, limit: f64, unit: &str) -> Finding {
        Finding { value, limit, unit: unit.into(), ..self }
    }

    fn state(self, state: State) -> Finding {
        Finding { state, ..self }
    }

    fn says(self, found: impl Into<String>, expected: impl Into<String>) -> Finding {
        Finding { found: found.into(), expected: expected.into(), ..self }
    }
}

/// Of the findings of one check of one run: those that do not pass, else the one nearest to its limit.
fn worst(findings: Vec<Finding>) -> Vec<Finding> {
    if findings.iter().any(|finding| finding.state > State::Pass) {
        return findings.into_iter().filter(|finding| finding.state > State::Pass).collect();
    }
    let near = |finding: &Finding| if finding.limit == 0.0 { 0.0 } else { finding.value / finding.limit };
    findings.into_iter().max_by(|a, b| near(a).total_cmp(&near(b))).into_iter().collect()
}

/// Unit of a joint's position.
fn unit(robot: &Robot, j: usize) -> &'static str {
    match robot.chain.joints()[j].kind {
        plumbline_model::JointKind::Revolute => "rad",
        plumbline_model::JointKind::Prismatic => "m",
    }
}

/// Unit of a joint's torque.
fn torque_unit(robot: &Robot, j: usize) -> &'static str {
    if unit(robot, j) == "m" { "N" } else { "Nm" }
}

fn root_mean_square(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value * value, count + 1));
    (sum / count.max(1) as f64).sqrt()
}

/// Standard deviation of values.
fn deviation(values: &[f64]) -> f64 {
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    root_mean_square(values.iter().map(|value| value - mean))
}

/// Value that a share of the values does not exceed.
fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    if values.is_empty() {
        return 0.0;
    }
    let at = ((values.len() - 1) as f64 * share).round() as usize;
    *values.select_nth_unstable_by(at, f64::total_cmp).1
}
