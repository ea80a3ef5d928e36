//! Floor 1: the arm's dynamics as pure functions. No I/O, no clock, no configuration.

#![forbid(unsafe_code)]
// The real-time wall (clippy.toml): what the loop calls neither allocates by these means, locks, logs, reads files nor panics.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

pub mod base;
pub mod chain;
pub mod conditioning;
pub mod expression;
pub mod fast;
pub mod gravity;
pub mod inertia;
pub mod regressor;
pub mod rnea;
pub mod robot;
pub mod served;
pub mod shape;
pub mod structure;
pub mod term;
pub mod torque;
