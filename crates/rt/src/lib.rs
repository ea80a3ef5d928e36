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

pub mod checkpoint;
pub mod controls;
pub mod cycle;
mod durations;
pub mod guard;
pub mod motion;
pub mod moves;
pub mod order;
pub mod os;
pub mod recorder;
pub mod rights;
pub mod settings;
pub mod stats;
mod sync;
pub mod torque;
