//! The sender's end of a stop.

use std::io;
use std::os::unix::net::UnixDatagram;
use std::path::Path;
use std::time::{Duration, Instant};

use super::holder::Holder;
use super::{ORDER, socket_beside};
use crate::RobotId;
use crate::lock::{self, Entry};
use crate::runtime_dir::{self, RuntimeDirError};

/// How long the daemon has for a stop that came by its socket before the signal follows.
const BY_SOCKET: Duration = Duration::from_millis(300);
/// How long it has for the signal.
const BY_SIGNAL: Duration = Duration::from_millis(1500);
/// Pause between two looks at the count of stops.
const LOOK: Duration = Duration::from_micros(200);

/// How a stop reached the daemon.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StopPath {
    /// By the daemon's socket.
    Socket,
    /// By SIGUSR2.
    Signal {
        /// Why not by the socket.
        because: String,
    },
}

/// A stop that the daemon has taken: where a loop ran, it has been told to brake.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StopReceipt {
    /// The daemon's process.
    pub process: u32,
    /// How the stop reached it.
    pub way: StopPath,
    /// `CLOCK_MONOTONIC` when the daemon took it \[ns\].
    pub at_ns: u64,
}

/// Why nobody is known to have taken the stop.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StopError {
    /// There is no folder to trust.
    #[error(transparent)]
    Place(#[from] RuntimeDirError),
    /// No daemon serves this robot.
    #[error("no daemon serves robot `{robot}` ({reason})")]
    NoDaemon {
        /// The robot asked for.
        robot: String,
        /// What was found instead.
        reason: String,
    },
    /// The daemon did not take the stop.
    #[error(
        "NOT STOPPED: the daemon of robot `{robot}` (process {process}) took the stop neither by its socket ({by_socket}) nor by a signal \
         ({by_signal}); use the robot's own stop"
    )]
    NotTaken {
        /// The robot.
        robot: String,
        /// The process that the lock file names.
        process: u32,
        /// What became of the first attempt.
        by_socket: String,
        /// What became of the second.
        by_signal: String,
    },
}

/// Stops the arm of `robot`: by the daemon's socket, else by a signal to the process that holds the robot's lock.
///
/// Shared memory is not touched.
///
/// # Errors
/// [`StopError`]: unless this returns `Ok`, nobody is known to have taken the stop.
pub fn stop(robot: &RobotId) -> Result<StopReceipt, StopError> {
    stop_in(&runtime_dir::directory()?, robot)
}

pub(super) fn stop_in(directory: &Path, robot: &RobotId) -> Result<StopReceipt, StopError> {
    let lock = lock::path_in(directory, robot);
    let none = |reason: String| StopError::NoDaemon { robot: robot.to_string(), reason };
    let before = Entry::read(&lock).ok_or_else(|| none(format!("no process is named in {}", lock.display())))?;
    let by_socket = match send(&socket_beside(&lock)) {
        Ok(()) => match counted(&lock, before, BY_SOCKET) {
            Some(entry) => {
                return Ok(StopReceipt { process: entry.process, way: StopPath::Socket, at_ns: entry.stop_ns });
            }
            None => format!("no answer within {} ms", BY_SOCKET.as_millis()),
        },
        Err(error) => error.to_string(),
    };
    let process = before.process;
    let by_signal = match Holder::verified(&lock, process).and_then(|holder| holder.signal()) {
        Ok(()) => match counted(&lock, before, BY_SIGNAL) {
            Some(entry) => {
                let way = StopPath::Signal { because: by_socket };
                return Ok(StopReceipt { process, way, at_ns: entry.stop_ns });
            }
            None => format!("no answer within {} ms", BY_SIGNAL.as_millis()),
        },
        Err(refusal) if refusal.serves_none => return Err(none(refusal.reason)),
        Err(refusal) => refusal.reason,
    };
    Err(StopError::NotTaken { robot: robot.to_string(), process, by_socket, by_signal })
}

fn send(socket: &Path) -> io::Result<()> {
    let own = UnixDatagram::unbound()?;
    own.connect(socket)?;
    own.set_nonblocking(true)?;
    match own.send(ORDER) {
        // The socket is full of stops that wait: one of them does.
        Err(error) if error.kind() == io::ErrorKind::WouldBlock => Ok(()),
        sent => sent.map(|_bytes| ()),
    }
}

/// What the lock file says as soon as it counts a stop more than `before`, within `patience`.
fn counted(lock: &Path, before: Entry, patience: Duration) -> Option<Entry> {
    let start = Instant::now();
    loop {
        match Entry::read(lock) {
            Some(now) if now.process == before.process && now.stops != before.stops => return Some(now),
            _ if start.elapsed() >= patience => return None,
            _ => std::thread::sleep(LOOK),
        }
    }
}
