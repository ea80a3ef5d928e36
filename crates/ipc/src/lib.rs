//! Samples, torques, requests and stops between processes: shared memory of iceoryx2, and a socket for stops.
//!
//! | service of robot R | pattern | what |
//! |---|---|---|
//! | `plumbline/R/samples` | publish-subscribe | every [`Record`](plumbline_core::Record) as [`SampleMessage`], numbered without gaps |
//! | `plumbline/R/replay` | request-response | a follower says how far it is and asks for what it missed |
//! | `plumbline/R/feed-forward` | publish-subscribe, latest value | [`FeedForwardMessage`] for any number of clients |
//! | `plumbline/R/command` | request-response, JSON | [`Request`] and [`Response`] |
//!
//! A stop has a way of its own beside them, without shared memory: [`stop`](stop()).
//!
//! The daemon's bridge thread owns one [`Server`]; the real-time thread never comes here. Nothing that a client does, or
//! does not do, blocks the server: what does not fit into a client's buffer is discarded, and a follower of the samples
//! fetches it from the daemon's [`RetainedLog`] afterwards. So the stream is complete without waiting for anyone.
//!
//! The trust boundary is the operating system's user: shared memory and the folder of names ([`runtime_dir`]) are open to the daemon's own
//! user only. What
//! arrives from that user is still checked; no value of a message can make the daemon panic.
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
mod command;
mod error;
mod error_counts;
mod feed_forward;
mod followers;
mod incomplete_segments;
mod lock;
mod messages;
mod requests;
mod retain;
mod robot;
pub mod runtime_dir;
mod sender;
mod server;
mod services;
mod stop;
mod stream;

pub use arm_lock::{ArmLock, ArmLockError};
pub use client::Client;
pub use command::{
    Follower, Gravity, HeldModel, MAX_REQUEST_BYTES, MotionGravity, Mounting, Progress, Proposal, Request, Response,
    Served, Session, Status,
};
pub use error::IpcError;
pub use feed_forward::{FeedForwardClient, FeedForwardSettings, Latest, Presence};
pub use followers::FollowerEvent;
pub use lock::{Lock, LockError};
pub use messages::{FeedForwardMessage, FollowRequest, MessageError, ReplayHeader, SampleMessage};
pub use plumbline_core::Link;
pub use requests::{IncomingRequest, Ticket, read};
pub use retain::RetainedLog;
pub use robot::RobotId;
pub use server::{Server, ServerSettings};
pub use services::{boot_ns, now_ns};
pub use stop::{StopError, StopListener, StopOrder, StopPath, StopReceipt, stop};
pub use stream::{Delivery, SampleStream, StreamCounters, StreamSettings};
