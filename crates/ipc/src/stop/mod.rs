//! The stop's own way to the daemon: a local datagram socket beside the lock file, and a signal as the last resort.
//!
//! Nothing here needs shared memory, a place among the clients, a new file descriptor in the daemon, or the bridge thread. Every datagram
//! that is not empty is a stop, whatever it holds: a stop too many is safe. The daemon counts the stops that it has taken in the lock file, which
//! is how a sender learns that its own was taken, on either way.

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

/// The longest that one [`StopListener::listen`] waits.
pub const LISTEN: Duration = Duration::from_millis(50);
/// What a sender writes.
const ORDER: &[u8; 16] = b"plumbline stop 1";

/// Who asked for a stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StopOrder {
    /// The process that sent it, as the kernel says; 0 for a signal, whose sender is not passed on.
    pub process: u32,
    /// That process's user.
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

/// The daemon's end.
#[derive(Debug)]
pub struct StopListener {
    path: PathBuf,
    socket: UnixDatagram,
    counter: StopCounter,
    signal: SigId,
}

impl StopListener {
    /// Opens the socket beside `lock` and takes SIGUSR2.
    ///
    /// # Errors
    /// The socket can't be made: the path is too long for one, the folder can't be written, no file descriptor is left.
    pub fn open(lock: &Lock) -> io::Result<StopListener> {
        let path = socket_beside(lock.path());
        // The lock is held: what lies here was left by a daemon that is gone.
        match std::fs::remove_file(&path) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        let socket = UnixDatagram::bind(&path)?;
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o600))?;
        rustix::net::sockopt::set_socket_passcred(&socket, true)?;
        socket.set_read_timeout(Some(LISTEN))?;
        // The handler's write is a datagram like any other.
        let own = UnixDatagram::unbound()?;
        own.connect(&path)?;
        let signal = signal_hook::low_level::pipe::register(SIGUSR2, own)?;
        Ok(StopListener { path, socket, counter: lock.counter()?, signal })
    }

    /// Waits up to `LISTEN` for one stop, carries it out, then counts it, so that its sender learns of it.
    ///
    /// # Errors
    /// The socket or the lock file failed; the stop itself was carried out.
    pub fn listen(&mut self, carry_out: impl FnOnce(StopOrder)) -> io::Result<()> {
        let Some(order) = self.receive()? else { return Ok(()) };
        carry_out(order);
        self.counter.count(now_ns())
    }

    fn receive(&self) -> io::Result<Option<StopOrder>> {
        let mut bytes = [0; ORDER.len()];
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
        // What the handler of this very process has sent.
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

/// The socket that belongs to a lock file.
fn socket_beside(lock: &Path) -> PathBuf {
    lock.with_extension("stop")
}

#[cfg(test)]
mod tests;
