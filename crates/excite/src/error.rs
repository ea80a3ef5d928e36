//! Errors of building and searching motions.

use super::criterion::MAX_CONDITION;
use super::limits;
use super::usage::{MIN_USAGE, Usage};

/// Error of building or searching a motion.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExciteError {
    /// The period is not a positive number.
    #[error("period {period} s: expected a positive number")]
    Period {
        /// The period \[s\].
        period: f64,
    },
    /// The shapes of the amplitudes do not match the joints, or exceed the maximum.
    #[error("q0 has {q0} joints, a is {a:?}, b is {b:?}: expected both n x N for 1 to 8 joints and 1 to 16 harmonics")]
    Shape {
        /// Entries of `q0`.
        q0: usize,
        /// Rows and columns of `a`.
        a: (usize, usize),
        /// Rows and columns of `b`.
        b: (usize, usize),
    },
    /// An amplitude or a position is not a finite number.
    #[error("{value} is not a finite position or amplitude")]
    NotFinite {
        /// The value found.
        value: f64,
    },
    /// The period is not a whole number of 1 ms samples.
    #[error("{periods} periods of {period} s: expected at least one period of a whole number of milliseconds")]
    Ticks {
        /// The period \[s\].
        period: f64,
        /// Number of periods.
        periods: u32,
    },
    /// The motion does not start at rest.
    #[error("the motion starts {:.3e} rad from q0 at {:.3e} rad/s and {:.3e} rad/s2: expected rest at q0", error[0], error[1], error[2])]
    Boundary {
        /// Offset \[rad\], speed \[rad/s\], acceleration \[rad/s2\] at t = 0.
        error: [f64; 3],
    },
    /// The start pose lies outside a joint's range.
    #[error("start pose: joint {joint} at {q} rad, expected {min:.4} to {max:.4} rad (limits less their margin)")]
    StartJoint {
        /// Joint, counted from 1.
        joint: usize,
        /// Its position \[rad\].
        q: f64,
        /// Lowest position allowed \[rad\].
        min: f64,
        /// Highest position allowed \[rad\].
        max: f64,
    },
    /// The end effector is outside the workspace at the start pose.
    #[error("start pose: end effector at [{:.3}, {:.3}, {:.3}] m, which leaves the workspace: {reason}", at[0], at[1], at[2])]
    StartWorkspace {
        /// Position of the end effector in the base frame \[m\].
        at: [f64; 3],
        /// The violated bound.
        reason: String,
    },
    /// The start pose violates a torque limit, a link's box or a clearance.
    #[error("start pose: {violation}")]
    StartPose {
        /// The violated limit.
        violation: limits::Peak,
    },
    /// No feasible start pose was found.
    #[error("no feasible start pose among {tried} random ones{}", last.as_ref().map_or(String::new(), |last| format!("; the last: {last}")))]
    NoStart {
        /// Poses tried.
        tried: usize,
        /// Why the last one was rejected.
        last: Option<Box<ExciteError>>,
    },
    /// Limits less margins leave no room for a joint.
    #[error("joint {joint}: limits less their margins leave no {what}")]
    NoRoom {
        /// Joint, counted from 1.
        joint: usize,
        /// The quantity: `range`, `speed`, `acceleration` or `jerk`.
        what: &'static str,
    },
    /// Scaling a motion down did not make it feasible.
    #[error("no motion about this start pose satisfies the limits: {violation}")]
    NoMotion {
        /// The limit that the smallest motion violated.
        violation: limits::Peak,
    },
    /// The arm of the structure and the arm of the limits differ.
    #[error("a start pose of {found} joints for an arm of {expected}")]
    Joints {
        /// Joints given.
        found: usize,
        /// Joints of the arm.
        expected: usize,
    },
    /// A joint's motion is too small ([`MIN_USAGE`]).
    #[error("{}", frozen(*joint, usage, limited_by, *draws))]
    Frozen {
        /// Joint that moves least, counted from 1.
        joint: usize,
        /// Shares of its limits that the motion uses.
        usage: Usage,
        /// The limit that bounded the motion, where known.
        limited_by: Option<limits::Peak>,
        /// Random motions that were tried.
        draws: usize,
    },
    /// The motion does not determine every parameter.
    #[error("{}", unexcited(*condition, parameters))]
    Unexcited {
        /// Condition number of the column-equilibrated regressor; infinite where a parameter is not excited at all.
        condition: f64,
        /// Names of the parameters that are confounded or not excited.
        parameters: Vec<String>,
    },
    /// The search has no starts or too few samples.
    #[error("{starts} starts on {samples} samples a period: expected at least 1 and 20")]
    Budget {
        /// Number of starts.
        starts: usize,
        /// Samples of the coarse grid.
        samples: usize,
    },
    /// The model has a term without a gradient in the optimiser.
    #[error("column `{name}` of term `{term}`: the optimiser has gradients of rigid body, friction, offset and rotor")]
    Column {
        /// The term.
        term: String,
        /// Its column.
        name: String,
    },
    /// Too few or too many harmonics.
    #[error("{harmonics} harmonics: expected 3 to 16, so that a motion can start and end at rest")]
    Harmonics {
        /// Number of harmonics.
        harmonics: usize,
    },
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
