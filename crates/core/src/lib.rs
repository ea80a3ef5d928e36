//! Types shared by the crates of plumbline: per-joint values with units, the traits around the real-time loop, and the error type of invalid
//! input.
//!
//! | what | items |
//! |---|---|
//! | values of one cycle: fixed size, `Copy`, `repr(C)` | [`State`], [`Setpoint`], [`Command`], [`Record`], [`JointVec`] |
//! | limits of an arm | [`Limits`], [`SpeedEnvelope`], [`Workspace`] |
//! | interfaces of the loop | [`Backend`], [`Reference`], [`FeedForward`], [`Kinematics`], [`Sink`], [`Clock`], [`Fault`] |
//! | what a backend crate provides beside the loop | [`ArmConnector`], [`Connected`], [`ArmMonitor`], [`ArmLimits`], [`Explanation`], [`Link`] |
//! | invalid input: file, position, value, expectation | [`BadInput`], [`from_toml`] |
//! | histogram of durations and its percentiles, counts of the loop | [`Histogram`], [`Distribution`], [`LoopStatistics`] |
//! | decompositions with a bound on their iterations | [`svd`], [`singular_values`], [`symmetric_eigen`] |
//! | parallel map over all processors | [`parallel()`], [`threads`] |
//!
//! ```
//! use plumbline_core::from_toml;
//!
//! #[derive(Debug, serde::Deserialize)]
//! struct Joint {
//!     #[allow(dead_code)]
//!     limit: f64,
//! }
//!
//! let error = from_toml::<Joint>("arm.toml", "limit = \"fast\"").unwrap_err();
//! assert_eq!((error.file.as_str(), error.place.as_str()), ("arm.toml", "line 1, key `limit`"));
//! ```

#![forbid(unsafe_code)]

mod arm;
mod decomposition;
mod histogram;
mod input;
mod joint;
mod parallel;
mod statistics;
mod traits;

pub use arm::{
    ArmConnector, ArmError, ArmLimits, ArmMonitor, CommandMode, ConnectOptions, Connected, Explanation, Hardware, Link,
    MeasuredGravity, ModeChange, Purpose, TimeGate,
};
pub use decomposition::{singular_values, svd, symmetric_eigen, transposed_product};
pub use histogram::{Distribution, Histogram};
pub use input::{BadInput, expectation, from_toml};
pub use joint::{
    Command, JointVec, Limits, MAX_JOINTS, Phase, Record, Setpoint, SpeedEnvelope, State, Torque, Validity, Workspace,
};
pub use parallel::{parallel, threads};
pub use statistics::LoopStatistics;
pub use traits::{
    Backend, Clock, Fault, FeedForward, Kinematics, MAX_MISSED_COMMANDS, PERIOD_NS, PERIOD_S, Reference, Sink,
};
