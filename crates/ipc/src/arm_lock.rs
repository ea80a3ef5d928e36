//! One daemon per arm, whatever the robot is called, whichever folder its names lie in and whoever runs it.
//!
//! [`Lock`](super::Lock) lies in the folder of one user, and there may be several: `PLUMBLINE_RUNTIME_DIR`, `XDG_RUNTIME_DIR`, other users. This lock
//! is a Unix socket with a name in the kernel's abstract namespace: it needs no file and no right to write, and goes with its process. The
//! namespace belongs to the network namespace, as the way to the arm does: processes that share the one share the other. Two network namespaces
//! that are both routed to one arm are not covered, nor are programs of others; a control unit that takes one client at a time refuses those itself.

use rustix::net::{
    AddressFamily, SocketAddrUnix, SocketFlags, SocketType, bind, connect, listen, socket_with, sockopt,
};
use std::io;
use std::os::fd::OwnedFd;

/// Why the arm could not be had.
#[derive(Debug, thiserror::Error)]
pub enum ArmLockError {
    /// A daemon drives it already.
    #[error("another daemon ({holder}) drives the arm `{arm}`")]
    Held {
        /// The arm.
        arm: String,
        /// Process and user of the other daemon, where the kernel tells.
        holder: String,
    },
    /// No socket could be had.
    #[error("the lock of arm `{arm}`: {source}")]
    Io {
        /// The arm.
        arm: String,
        /// What the operating system says.
        source: io::Error,
    },
}

/// The right to drive an arm, until it is dropped.
#[derive(Debug)]
pub struct ArmLock {
    _socket: OwnedFd,
}

impl ArmLock {
    /// Takes `arm`, a name that says which one on this network: `franka/172.16.0.2`.
    ///
    /// # Errors
    /// [`ArmLockError::Held`], [`ArmLockError::Io`].
    pub fn take(arm: &str) -> Result<ArmLock, ArmLockError> {
        let failed = |errno: rustix::io::Errno| ArmLockError::Io { arm: arm.to_string(), source: errno.into() };
        let address = SocketAddrUnix::new_abstract_name(format!("plumbline/arm/{arm}").as_bytes()).map_err(failed)?;
        let own = socket().map_err(failed)?;
        match bind(&own, &address) {
            Ok(()) => {}
            Err(rustix::io::Errno::ADDRINUSE) => {
                return Err(ArmLockError::Held { arm: arm.to_string(), holder: holder(&address) });
            }
            Err(errno) => return Err(failed(errno)),
        }
        // For whoever comes second: a connection tells it the process and the user that listen.
        listen(&own, 1).map_err(failed)?;
        Ok(ArmLock { _socket: own })
    }
}

/// Never waits: a queue of connections that is full is an error.
fn socket() -> rustix::io::Result<OwnedFd> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)
}

/// The process that listens at `address`, by the kernel.
fn holder(address: &SocketAddrUnix) -> String {
    let peer = || {
        let own = socket()?;
        connect(&own, address)?;
        sockopt::socket_peercred(&own)
    };
    match peer() {
        Ok(peer) => format!("process {} of user {}", peer.pid.as_raw_nonzero(), peer.uid.as_raw()),
        Err(_) => "process unknown".to_string(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arm_has_one_daemon_and_the_second_is_told_who_it_is() {
        let name = format!("test/{}", std::process::id());
        let lock = ArmLock::take(&name).unwrap();
        // Again and again: nothing that asks uses the lock up.
        for _ in 0..5 {
            let error = ArmLock::take(&name).unwrap_err();
            assert!(matches!(error, ArmLockError::Held { .. }), "{error}");
            assert!(error.to_string().contains(&name), "{error}");
        }
        ArmLock::take(&format!("{name}/other")).unwrap();
        drop(lock);
        ArmLock::take(&name).unwrap();
    }

    #[test]
    fn the_holder_is_named_by_process_and_user() {
        let name = format!("test-holder/{}", std::process::id());
        let _lock = ArmLock::take(&name).unwrap();
        let own = format!("process {} of user {}", std::process::id(), rustix::process::geteuid().as_raw());
        assert!(ArmLock::take(&name).unwrap_err().to_string().contains(&own));
    }
}
