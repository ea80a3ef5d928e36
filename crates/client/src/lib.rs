//! The identified model in the controller of an arm: its torque at the controller's own state, every millisecond.
//!
//! | what | items |
//! |---|---|
//! | the model of a file, or followed from the daemon | [`Model`], [`Follower`] |
//! | external torque and contact | [`Model::external`], [`External`] |
//! | the controller's states for the daemon | [`Guest`] |
//! | torque of the daemon's own motion | [`FeedForwardClient`] |
//! | errors: of a call in the control loop, of all others | [`Fault`], [`Error`] |
//!
//! Calls in the control loop neither allocate, lock, block nor panic: every method of [`Model`] that takes a state, [`Model::status`], and
//! [`Guest::publish`]. All others are for another thread, or for the time before the loop.
//!
//! ```no_run
//! use plumbline_client::{Expected, Model};
//! use std::time::Duration;
//!
//! let mut model = Model::follow("panda", Expected::default(), Duration::from_secs(5))?;
//! let (q, dq, ddq) = ([0.1; 7], [0.0; 7], [0.0; 7]);
//! let mut tau = [0.0; 7];
//! model.torque(&q, &dq, &ddq, None, &mut tau)?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

/// The page of the guide: its blocks are compiled.
#[cfg(doctest)]
#[doc = include_str!("../../../docs/guide/controller.md")]
struct GuidePage;

mod background;
mod error;
mod evaluation;
mod follower;
mod guest;
mod model;

pub use error::{Error, Fault};
pub use follower::{Change, Expected, Follower};
pub use guest::Guest;
pub use model::{Model, Status};
pub use plumbline_identify::external::{External, Way};
pub use plumbline_ipc::{FeedForwardClient, FeedForwardSettings, IpcError, Latest, Presence, RobotId};
