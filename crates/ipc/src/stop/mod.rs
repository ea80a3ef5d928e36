//! Stop requests to the daemon: a local datagram socket beside the lock file, and a signal as fallback.
//!
//! No shared memory, client slot, new file descriptor in the daemon, or bridge thread is needed. Every non-empty datagram is a stop, whatever
//! its content: an unneeded stop is safe. The daemon counts executed stops in the lock file. A sender reads that count as its acknowledgement,
//! for socket and signal alike.

mod holder;
mod send;

pub use send::{StopError, StopPath, StopReceipt, stop};

use std::fmt;
use std::io::{self, IoSliceMut};
use std::mem::MaybeUninit;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::net::UnixDatagram;
use std::path::{Path, PathBuf};
use std::time::Duration;

use rustix::net::{RecvAncillaryBuffer, RecvAncillaryMessage, RecvFlags};
use signal_hook::SigId;
use signal_hook::consts::SIGUSR2;

use super::lock::{Lock, StopCounter};
use super::now_ns;

/// Timeout of one [`StopListener::listen`].
pub const LISTEN_TIMEOUT: Duration = Duration::from_millis(50);
const STOP_DATAGRAM: &[u8; 16] = b"plumbline stop 1";

/// Sender of a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StopOrder {
    /// Sending process by the kernel's credentials; 0 for a signal, whose sender is unknown.
    pub process: u32,
    /// User of that process.
    pub user: u32,
}

impl fmt::Display for StopOrder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.process {
            0 => f.write_str("signal SIGUSR2"),
            process => write!(f, "process {process} of user {}", self.user),
        }
    }
}

/// Receiver of stops in the daemon.
#[derive(Debug)]
pub struct StopListener {
    path: PathBuf,
    socket: UnixDatagram,
    counter: StopCounter,
    signal: SigId,
}

impl StopListener {
    /// Opens the socket beside `lock` and registers a handler of SIGUSR2.
    ///
    /// # Errors
    /// The socket can't be created: path too long, directory not writable, no file descriptor left.
    pub fn open(lock: &Lock) -> io::Result<StopListener> {
        let path = socket_beside(lock.path());
        // The lock is held, so an existing socket belongs to an earlier daemon.
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let socket = UnixDatagram::bind(&path)?;
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600))?;
        rustix::net::sockopt::set_socket_passcred(&socket, true)?;
        socket.set_read_timeout(Some(LISTEN_TIMEOUT))?;
        // The signal handler writes a datagram to the same socket.
        let own = UnixDatagram::unbound()?;
        own.connect(&path)?;
        let signal = signal_hook::low_level::pipe::register(SIGUSR2, own)?;
        Ok(StopListener { path, socket, counter: lock.counter()?, signal })
    }

    /// Waits up to [`LISTEN_TIMEOUT`] for one stop, executes it, then counts it as the acknowledgement to its sender.
    ///
    /// # Errors
    /// The socket or the lock file failed; a received stop was executed.
    pub fn listen(&mut self, carry_out: impl FnOnce(StopOrder)) -> io::Result<()> {
        let Some(order) = self.receive()? else { return Ok(()) };
        carry_out(order);
        self.counter.count(now_ns())
    }

    fn receive(&self) -> io::Result<Option<StopOrder>> {
        let mut bytes = [0; STOP_DATAGRAM.len()];
        let mut space = [MaybeUninit::uninit(); rustix::cmsg_space!(ScmCredentials(1))];
        let mut control = RecvAncillaryBuffer::new(&mut space);
        let mut buffers = [IoSliceMut::new(&mut bytes)];
        let received = match rustix::net::recvmsg(&self.socket, &mut buffers, &mut control, RecvFlags::empty()) {
            Ok(received) => received.bytes,
            Err(rustix::io::Errno::AGAIN | rustix::io::Errno::INTR) => return Ok(None),
            Err(error) => return Err(error.into()),
        };
        if received == 0 {
            return Ok(None);
        }
        let sender = control.drain().find_map(|message| match message {
            RecvAncillaryMessage::ScmCredentials(sender) => Some(sender),
            _ => None,
        });
        let (process, user) = sender.map_or((0, 0), |sender| (sender.pid.as_raw_pid(), sender.uid.as_raw()));
        // Datagrams of this process come from its signal handler.
        let process = u32::try_from(process).ok().filter(|&process| process != std::process::id()).unwrap_or(0);
        Ok(Some(StopOrder { process, user }))
    }
}

impl Drop for StopListener {
    fn drop(&mut self) {
        signal_hook::low_level::unregister(self.signal);
        let _ = std::fs::remove_file(&self.path);
    }
}

fn socket_beside(lock: &Path) -> PathBuf {
    lock.with_extension("stop")
}

#[cfg(test)]
mod tests;
