//! What keeps a motion from being built or found.

use super::limits;

/// Why a motion can't be built or found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExciteError {
    /// The period is not a positive number.
    #[error("period {period} s: expected a positive number")]
    Period {
        /// The period \[s\].
        period: f64,
    },
    /// The amplitudes do not fit the joints, or there is no room for them.
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
        /// The number found.
        value: f64,
    },
    /// The motion has no whole number of 1 ms samples.
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
    /// The start pose holds the end effector where it must not be.
    #[error("start pose: end effector at [{:.3}, {:.3}, {:.3}] m, which leaves the workspace: {reason}", at[0], at[1], at[2])]
    StartWorkspace {
        /// Position of the end effector in the base frame \[m\].
        at: [f64; 3],
        /// The bound it breaks.
        reason: String,
    },
    /// The start pose needs more torque than a joint has.
    #[error("start pose: {violation}")]
    StartTorque {
        /// What it would take.
        violation: limits::Peak,
    },
    /// No start pose inside joint limits and workspace was found.
    #[error("no start pose inside the joint limits and the workspace in {tried} random ones; the last end effector was at [{:.3}, {:.3}, {:.3}] m", last[0], last[1], last[2])]
    NoStart {
        /// Poses tried.
        tried: usize,
        /// End effector of the last one \[m\].
        last: [f64; 3],
    },
    /// The limits leave a joint no room.
    #[error("joint {joint}: limits less their margins leave no {what}")]
    NoRoom {
        /// Joint, counted from 1.
        joint: usize,
        /// What is left over: `range`, `speed`, `acceleration`.
        what: &'static str,
    },
    /// Shrinking a motion did not bring it inside the limits.
    #[error("no motion about this start pose keeps the limits: {violation}")]
    NoMotion {
        /// The limit that the smallest motion still broke.
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
    /// No motion was found that excites every parameter.
    #[error("the motions found leave a parameter unexcited")]
    Unexcited,
    /// The search was given nothing to spend.
    #[error("{starts} starts on {samples} samples a period: expected at least 1 and 20")]
    Budget {
        /// Starts granted.
        starts: usize,
        /// Samples of the coarse grid.
        samples: usize,
    },
    /// The model has a term that the optimiser can't differentiate.
    #[error("column `{name}` of term `{term}`: the optimiser knows rigid body, friction, offset and rotor")]
    Column {
        /// The term.
        term: String,
        /// Its column.
        name: String,
    },
    /// Too few harmonics to move at all.
    #[error("{harmonics} harmonics: expected 3 to 16, so that a motion can start and end at rest")]
    Harmonics {
        /// Harmonics asked for.
        harmonics: usize,
    },
}
