//! Interprocess communication: samples, feed-forward torques and requests over iceoryx2 shared memory, stops over a socket.
//!
//! | service of robot R | pattern | what |
//! |---|---|---|
//! | `plumbline/R/samples` | publish-subscribe | every [`Record`](plumbline_core::Record) as [`SampleMessage`], numbered without gaps |
//! | `plumbline/R/replay` | request-response | a follower acknowledges records and requests missed ones |
//! | `plumbline/R/feed-forward` | publish-subscribe, latest value | [`FeedForwardMessage`] for any number of clients |
//! | `plumbline/R/model` | publish-subscribe, latest value | text of the served model with a [`ModelHeader`] |
//! | `plumbline/R/guest` | publish-subscribe | [`GuestMessage`]: states of an arm that another program controls |
//! | `plumbline/R/command` | request-response, JSON | [`Request`] and [`Response`] |
//!
//! A stop is sent over a separate socket, without shared memory: [`stop`](stop()).
//!
//! The daemon's bridge thread owns one [`Server`]; the real-time thread calls nothing of this crate. No client can block the server:
//! samples that do not fit into a client's buffer are discarded, and a follower fetches them later from the daemon's [`RetainedLog`]. The
//! stream is therefore complete.
//!
//! The trust boundary is the operating system's user: shared memory and the runtime directory ([`runtime_dir`]) are accessible to the daemon's
//! user only. Messages of that user are still validated; no value of a message can make the daemon panic.
//!
//! ```no_run
//! use plumbline_ipc::{FeedForwardClient, FeedForwardSettings, RobotId};
//! use std::time::Duration;
//!
//! let robot = RobotId::parse("example", "robot", "panda")?;
//! let mut client = FeedForwardClient::connect(&robot, FeedForwardSettings::default(), Duration::from_secs(1))?;
//! let latest = client.latest()?;
//! # let _ = latest;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod arm_lock;
mod client;
mod clock;
mod command;
mod error;
mod error_counts;
mod feed_forward;
mod followers;
mod guest;
mod incomplete_segments;
mod lock;
mod messages;
mod model;
mod requests;
mod retain;
mod robot;
pub mod runtime_dir;
mod sender;
mod server;
mod services;
mod stop;
mod stream;
mod watcher;

pub use arm_lock::{ArmLock, ArmLockError};
pub use client::Client;
pub use command::{
    Follower, Gravity, GuestStatus, HeldModel, MAX_REQUEST_BYTES, MotionGravity, Mounting, Progress, Proposal, Request,
    Response, Served, Session, Status,
};
pub use error::IpcError;
pub use feed_forward::{FeedForwardClient, FeedForwardSettings, Latest, Presence};
pub use followers::FollowerEvent;
pub use guest::{GuestCounts, GuestDelivery, GuestPublisher, GuestReceiver};
pub use lock::{Lock, LockError};
pub use messages::{
    FeedForwardMessage, FollowRequest, GuestMessage, LAYOUT, MessageError, ModelHeader, ReplayHeader, SampleMessage,
};
pub use model::{ModelClient, ModelMessage};
pub use plumbline_core::Link;
pub use requests::{IncomingRequest, Ticket, read};
pub use retain::RetainedLog;
pub use robot::RobotId;
pub use server::{Server, ServerSettings};
pub use services::{boot_ns, now_ns};
pub use stop::{StopError, StopListener, StopOrder, StopPath, StopReceipt, stop};
pub use stream::{Delivery, SampleStream, StreamCounters, StreamSettings};
pub use watcher::SampleWatcher;
