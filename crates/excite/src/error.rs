//! Errors of building and searching motions.

use super::criterion::MAX_CONDITION;
use super::limits;
use super::usage::{MIN_USAGE, Usage};

/// Error of building or searching a motion.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum ExciteError {
    #[error("period {period} s: expected a positive number")]
    Period { period: f64 },
    /// The shapes of the amplitudes do not match the joints, or exceed the maximum.
    #[error("q0 has {q0} joints, a is {a:?}, b is {b:?}: expected both n x N for 1 to 8 joints and 1 to 16 harmonics")]
    Shape { q0: usize, a: (usize, usize), b: (usize, usize) },
    #[error("{value} is not a finite position or amplitude")]
    NotFinite { value: f64 },
    #[error("{periods} periods of {period} s: expected at least one period of a whole number of milliseconds")]
    Ticks { period: f64, periods: u32 },
    #[error("the motion starts {:.3e} rad from q0 at {:.3e} rad/s and {:.3e} rad/s2: expected rest at q0", error[0], error[1], error[2])]
    Boundary { error: [f64; 3] },
    /// The start pose lies outside a joint's range.
    #[error("start pose: joint {joint} at {q} rad, expected {min:.4} to {max:.4} rad (limits less their margin)")]
    StartJoint { joint: usize, q: f64, min: f64, max: f64 },
    #[error("start pose: end effector at [{:.3}, {:.3}, {:.3}] m, which leaves the workspace: {reason}", at[0], at[1], at[2])]
    StartWorkspace { at: [f64; 3], reason: String },
    /// The start pose violates a torque limit, a link's box or a clearance.
    #[error("start pose: {violation}")]
    StartPose { violation: limits::Peak },
    #[error("no feasible start pose among {tried} random ones{}", last.as_ref().map_or(String::new(), |last| format!("; the last: {last}")))]
    NoStart { tried: usize, last: Option<Box<ExciteError>> },
    #[error("joint {joint}: limits less their margins leave no {what}")]
    NoRoom { joint: usize, what: &'static str },
    /// Scaling a motion down did not make it feasible.
    #[error("no motion about this start pose satisfies the limits: {violation}")]
    NoMotion { violation: limits::Peak },
    /// The arm of the structure and the arm of the limits differ.
    #[error("a start pose of {found} joints for an arm of {expected}")]
    Joints { found: usize, expected: usize },
    /// A joint's motion is too small ([`MIN_USAGE`]).
    #[error("{}", frozen(*joint, usage, limited_by, *draws))]
    Frozen { joint: usize, usage: Usage, limited_by: Option<limits::Peak>, draws: usize },
    /// The motion does not determine every parameter.
    #[error("{}", unexcited(*condition, parameters))]
    Unexcited { condition: f64, parameters: Vec<String> },
    /// The search has no starts or too few samples.
    #[error("{starts} starts on {samples} samples a period: expected at least 1 and 20")]
    Budget { starts: usize, samples: usize },
    #[error("column `{name}` of term `{term}`: the optimiser has gradients of rigid body, friction, offset and rotor")]
    Column { term: String, name: String },
    /// Too few or too many harmonics.
    #[error("{harmonics} harmonics: expected 3 to 16, so that a motion can start and end at rest")]
    Harmonics { harmonics: usize },
}

fn frozen(joint: usize, usage: &Usage, limited_by: &Option<limits::Peak>, draws: usize) -> String {
    let held = limited_by.as_ref().map_or(String::new(), |peak| format!("; a larger motion violates: {peak}"));
    let tried = if draws > 1 { format!(" in the best of {draws} random motions") } else { String::new() };
    let (range, speed) = (100.0 * usage.range, 100.0 * usage.speed);
    let least = 100.0 * MIN_USAGE;
    format!(
        "joint {joint} is frozen: it uses {range:.1} % of its range and {speed:.1} % of its speed{tried}, expected at least \
         {least:.0} % of its range, speed, acceleration or jerk{held}"
    )
}

fn unexcited(condition: f64, parameters: &[String]) -> String {
    let names = parameters.join(", ");
    format!(
        "the motion does not determine {names}: condition number {condition:.3e} (column-equilibrated), expected at most {MAX_CONDITION}"
    )
}
