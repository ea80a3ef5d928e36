//! What every other crate of plumbline exchanges: per-joint values with their units, the small traits between the loop and what
//! surrounds it, and how bad input is reported.
//!
//! | what | items |
//! |---|---|
//! | values of one cycle, fixed size, `Copy` | [`State`], [`Setpoint`], [`Command`], [`Record`], [`JointVec`] |
//! | limits of an arm | [`Limits`], [`SpeedEnvelope`], [`Workspace`] |
//! | the loop's seams | [`Backend`], [`Reference`], [`FeedForward`], [`Kinematics`], [`Sink`], [`Clock`], [`Fault`] |
//! | bad input | [`BadInput`], [`from_toml`] |
//! | numbers | [`svd`], [`singular_values`], [`symmetric_eigen`] with a bound on iterations; [`parallel()`] on all processors |

#![forbid(unsafe_code)]

mod decomposition;
mod input;
mod joint;
mod parallel;
mod traits;

pub use decomposition::{singular_values, svd, symmetric_eigen};
pub use input::{BadInput, expectation, from_toml};
pub use joint::{
    Command, JointVec, Limits, MAX_JOINTS, Phase, Record, Setpoint, SpeedEnvelope, State, Torque, Validity, Workspace,
};
pub use parallel::{parallel, threads};
pub use traits::{Backend, Clock, Fault, FeedForward, Kinematics, LONGEST_ALONE, PERIOD, PERIOD_NS, Reference, Sink};
