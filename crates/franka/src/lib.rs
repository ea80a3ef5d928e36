//! Franka arms (Panda, FER, FR3) over the Franka Control Interface, the 1 kHz network interface of libfranka.
//!
//! [`connect()`] opens a session and does everything that may block or allocate; [`FrankaArm`] is the arm in the loop. A motion begins with
//! the first read of an arm that is to be driven, on the loop's own thread, and ends with [`plumbline_core::Backend::stop`].
//!
//! | file | what |
//! |---|---|
//! | [`wire`] | the protocol as bytes |
//! | `settings`, `limits` | what a session is opened with; what the arm holds commands against |
//! | `session`, `tcp`, `hints`, `error` | connecting, and what to do when that fails |
//! | `gravity` | the gravity that the arm compensates, and the direction that its sensors show |
//! | `cycle/arm`, `cycle/transport`, `cycle/udp`, `cycle/motion` | the arm in the loop: the state machine of a session; its connections; the commands of a motion |
//! | `cycle/reference`, `cycle/limiter`, `cycle/torque` | what the arm goes by, in double precision; commands inside its limits; the impedance law |
//! | `connector` | the arm as a backend of the daemon |
//! | `telemetry`, `explain` | counters that any thread may read; explanations of faults |
//!
//! What goes for every motion:
//!
//! - The first command is the arm's own `q_d`, to the bit. From there on the arm's point is known from the commands sent, because states
//!   of version 10 come in single precision, whose differences are no jerks.
//! - An arm that misses a command extrapolates at constant acceleration. The state shows how far; the next command continues
//!   from there and comes back to the motion smoothly, inside [`Settings::limits_share`] of the limits.
//! - Errors are read from `reflex_reason` of the first state that shows the end of the motion, and the arm's final answer is always
//!   read, within a time limit.
//! - Nothing recovers by itself: [`recover`] is for the operator; a rule that the operator has set uses [`recover_communication`], which
//!   does not recover from a collision or a limit.
//!
//! ```no_run
//! use plumbline_core::Backend;
//! use plumbline_franka::{Purpose, RobotKind, Settings, connect};
//!
//! // Reads states; the arm's own controller holds it.
//! let settings = Settings { purpose: Purpose::Monitor, ..Settings::new("172.16.0.2".parse()?, RobotKind::Fr3) };
//! let (mut arm, _connection) = connect(&settings)?;
//! println!("{:?}", arm.read()?.q);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod codes;
mod connect;
mod connector;
mod cycle;
mod error;
mod explain;
mod gravity;
mod hints;
mod limits;
mod session;
mod settings;
mod tcp;
mod telemetry;
pub mod wire;

pub use codes::*;
pub use connect::{Connection, Info, connect, read_limits, recover, recover_communication};
pub use connector::FrankaConnector;
pub use cycle::FrankaArm;
pub use error::{ConnectError, next_step};
pub use explain::explain;
pub use gravity::{Gravity, Source};
pub use limits::{RobotLimits, UrdfError, fr3 as fr3_limits, from_urdf as limits_from_urdf};
pub use settings::{
    BadSetting, Collision, Controller, Interface, Load, Purpose, RobotKind, Settings, SocketOptions, TorqueControl,
};
pub use telemetry::{Rate, Stall, Statistics, Telemetry};
