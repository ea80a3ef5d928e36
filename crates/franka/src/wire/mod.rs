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

mod bytes;
mod codes;
mod errors;
pub mod layout;
mod protocol;
mod request;
mod response;
mod state;

pub use codes::{
    Architecture, ConnectStatus, ControllerMode, LoadModelStatus, MotionGeneratorMode, MoveController, MoveGenerator,
    MoveStatus, RecoveryStatus, RobotMode, RobotModelStatus, SetterStatus, StopStatus, System,
};
pub use errors::{ERROR_BITS, ErrorBit, Errors};
pub use protocol::{CommandKind, HEADER_BYTES, Header, MAX_MESSAGE, Protocol, WireError, images_of};
pub use request::{
    CollisionBehavior, Connect, Deviation, Filters, GuidingMode, LibraryTarget, Load, MAX_REQUEST, Move, Request,
};
pub use response::{CartesianLimit, Connected, MAX_FIXED_RESPONSE, Response};
pub use state::{MAX_COMMAND, MAX_STATE, RobotCommand, RobotState};

/// TCP port of the arm's control interface, the same in every version.
pub const COMMAND_PORT: u16 = 1337;
