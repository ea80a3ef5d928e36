//! What the loop calls every millisecond: the arm, its connections, the commands of a motion.

// The walls of the real-time loop: clippy.toml.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

mod arm;
mod limiter;
mod motion;
mod reference;
mod torque;
mod transport;
mod udp;

pub use arm::FrankaArm;
pub(crate) use transport::Transport;
pub(crate) use udp::{Received, StateLink};
