//! The bytes of the Franka Control Interface, protocol versions 5, 9 and 10: pure functions between packets and values.
//!
//! Nothing here does input or output, allocates, or panics; every decoder checks lengths, enumerations and flags, and answers
//! bad bytes with a [`WireError`], which is `Copy` and may leave the real-time loop. All messages go both ways, because an arm's
//! client and an emulator of the arm use the same code. Everything on the wire is little-endian and packed; matrices are
//! column-major.
//!
//! Over TCP (port [`COMMAND_PORT`]) the client sends a [`Request`], the arm answers with a [`Response`]; both begin with a
//! [`Header`]. Over UDP the arm sends a [`RobotState`] each millisecond and takes one [`RobotCommand`] in answer. What lies where
//! in these two is a table per version, in [`layout`].
//!
//! Source: the headers of libfranka-common (github.com/frankarobotics/libfranka-common and github.com/frankaemika/libfranka-common,
//! Apache-2.0), commits e6aa0fc (version 5), cd38d0e (9) and d96c221 (10), and libfranka 0.9.2, 0.17.0 and 0.21.2.

// The walls of the real-time loop (clippy.toml), and one against whatever could panic on bytes from outside.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(clippy::indexing_slicing, clippy::unwrap_used, clippy::expect_used, clippy::panic, clippy::unreachable)]

mod bits;
mod codes;
mod cursor;
mod error;
mod header;
mod kind;
pub mod layout;
mod packet;
mod payload;
mod protocol;
mod request;
mod response;
mod robot_command;
mod state;
mod status;

pub use bits::{ERROR_BITS, ErrorBit, Errors};
pub use codes::{Architecture, ControllerMode, MotionGeneratorMode, MoveController, MoveGenerator, RobotMode, System};
pub use error::WireError;
pub use header::{HEADER_BYTES, Header, MAX_MESSAGE};
pub use kind::CommandKind;
pub use payload::{CollisionBehavior, Connect, Deviation, Filters, GuidingMode, LibraryTarget, Load, Move};
pub use protocol::{Protocol, images_of};
pub use request::{MAX_REQUEST, Request};
pub use response::{CartesianLimit, Connected, MAX_FIXED_RESPONSE, Response};
pub use robot_command::{MAX_COMMAND, RobotCommand};
pub use state::{MAX_STATE, RobotState};
pub use status::{
    ConnectStatus, LoadModelStatus, MoveStatus, RecoveryStatus, RobotModelStatus, SetterStatus, StopStatus,
};

/// TCP port of the arm's control interface, the same in every version.
pub const COMMAND_PORT: u16 = 1337;
