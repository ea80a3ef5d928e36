//! Floor 1: the real-time loop and the small traits it owns. [`cycle`] is where to begin reading.
//!
//! Nothing that runs inside a cycle allocates, locks, logs, panics, or makes a system call beyond its clock and its backend.

// The wall around the loop: clippy.toml lists what must not be called here.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

mod checkpoint;
mod controls;
pub mod cycle;
mod durations;
mod guard;
mod motion;
mod moves;
mod order;
pub mod os;
pub mod recorder;
mod rights;
mod settings;
mod stats;
mod sync;
mod torque;

pub use checkpoint::{Checkpoint, Doing};
pub use controls::Controls;
pub use guard::{Guard, GuardSettings, Limit, Violation};
pub use motion::braked_from;
pub use moves::{MoveFactors, Planner};
pub use order::{Event, Handles, Order, OrderKind, StopReason, Told};
pub use rights::{Grant, Granted, Rights, become_realtime};
pub use settings::{CycleSettings, SetupError};
pub use stats::Distribution;
pub use torque::{Asked, Succession, Torques};
