//! Sender of a stop.

use std::io;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::time::{Duration, Instant};

use super::holder::Holder;
use super::{STOP_DATAGRAM, socket_beside};
use crate::RobotId;
use crate::lock::{self, Entry};
use crate::runtime_dir::{self, RuntimeDirError};

/// Acknowledgement timeout of a stop over the socket; the signal follows.
const SOCKET_TIMEOUT: Duration = Duration::from_millis(300);
const SIGNAL_TIMEOUT: Duration = Duration::from_millis(1500);
const POLL_INTERVAL: Duration = Duration::from_micros(200);

/// Path on which a stop reached the daemon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StopPath {
    /// The daemon's socket.
    Socket,
    /// SIGUSR2.
    Signal {
        /// Why the socket failed.
        because: String,
    },
}

/// Acknowledgement of a stop: a running loop has started its controlled stop.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StopReceipt {
    /// The daemon's process.
    pub process: u32,
    /// Path of the stop.
    pub way: StopPath,
    /// Time at which the daemon executed it, `CLOCK_MONOTONIC` \[ns\].
    pub at_ns: u64,
}

/// Why a stop was not acknowledged.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum StopError {
    #[error(transparent)]
    Place(#[from] RuntimeDirError),
    #[error("no daemon serves robot `{robot}` ({reason})")]
    NoDaemon { robot: String, reason: String },
    #[error(
        "NOT STOPPED: the daemon of robot `{robot}` (process {process}) acknowledged the stop neither over its socket ({by_socket}) nor by a signal \
         ({by_signal}); use the robot's own stop"
    )]
    NotAcknowledged { robot: String, process: u32, by_socket: String, by_signal: String },
}

/// Stops the arm of `robot` over the daemon's socket, else by a signal to the process that holds the robot's lock.
///
/// Does not use shared memory.
///
/// # Errors
/// [`StopError`] when the stop was not acknowledged.
pub fn stop(robot: &RobotId) -> Result<StopReceipt, StopError> {
    stop_in(&runtime_dir::directory()?, robot)
}

pub(super) fn stop_in(directory: &Path, robot: &RobotId) -> Result<StopReceipt, StopError> {
    let lock = lock::path_in(directory, robot);
    let no_daemon = |reason: String| StopError::NoDaemon { robot: robot.to_string(), reason };
    let before = Entry::read(&lock).ok_or_else(|| no_daemon(format!("no process is named in {}", lock.display())))?;
    let by_socket = match send(&socket_beside(&lock)) {
        Ok(()) => match wait_for_acknowledgement(&lock, before, SOCKET_TIMEOUT) {
            Some(entry) => {
                return Ok(StopReceipt { process: entry.process, way: StopPath::Socket, at_ns: entry.stop_ns });
            }
            None => format!("no acknowledgement within {} ms", SOCKET_TIMEOUT.as_millis()),
        },
        Err(error) => error.to_string(),
    };
    let process = before.process;
    let by_signal = match Holder::verified(&lock, process).and_then(|holder| holder.signal()) {
        Ok(()) => match wait_for_acknowledgement(&lock, before, SIGNAL_TIMEOUT) {
            Some(entry) => {
                let way = StopPath::Signal { because: by_socket };
                return Ok(StopReceipt { process, way, at_ns: entry.stop_ns });
            }
            None => format!("no acknowledgement within {} ms", SIGNAL_TIMEOUT.as_millis()),
        },
        Err(refusal) if refusal.serves_none => return Err(no_daemon(refusal.reason)),
        Err(refusal) => refusal.reason,
    };
    Err(StopError::NotAcknowledged { robot: robot.to_string(), process, by_socket, by_signal })
}

fn send(socket: &Path) -> io::Result<()> {
    let own = UnixDatagram::unbound()?;
    own.connect(socket)?;
    own.set_nonblocking(true)?;
    match own.send(STOP_DATAGRAM) {
        // The socket's queue is full of stops: one of them suffices.
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
        sent => sent.map(|_bytes| ()),
    }
}

/// Waits up to `timeout` until the lock file counts another stop than `before`, and returns its content.
fn wait_for_acknowledgement(lock: &Path, before: Entry, timeout: Duration) -> Option<Entry> {
    let start = Instant::now();
    loop {
        match Entry::read(lock) {
            Some(now) if now.process == before.process && now.stops != before.stops => return Some(now),
            _ if start.elapsed() >= timeout => return None,
            _ => std::thread::sleep(POLL_INTERVAL),
        }
    }
}
