//! Exclusive lock per arm, independent of robot name, runtime directory and user.
//!
//! [`Lock`](super::Lock) is in the runtime directory of one user, and there may be several. This lock is a Unix socket with a name in the
//! kernel's abstract namespace: it needs no file and no write permission, and is released with its process. The abstract namespace belongs to the
//! network namespace, as the route to the arm does. Not covered: two network namespaces with routes to one arm, and programs other than
//! plumbline; a control unit that accepts one client refuses those itself.

use rustix::net::{
    AddressFamily, SocketAddrUnix, SocketFlags, SocketType, bind, connect, listen, socket_with, sockopt,
};
use std::io;
use std::os::fd::OwnedFd;

/// Why the arm could not be locked.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum ArmLockError {
    #[error("another daemon ({holder}) drives the arm `{arm}`")]
    Held { arm: String, holder: String },
    /// The socket could not be created.
    #[error("the lock of arm `{arm}`: {source}")]
    Io { arm: String, source: io::Error },
}

/// Exclusive lock of one arm, released when dropped.
#[derive(Debug)]
pub struct ArmLock {
    _socket: OwnedFd,
}

impl ArmLock {
    /// Locks `arm`, a name that is unique on this network: `franka/172.16.0.2`.
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
        // A second daemon connects to learn process and user of the first.
        listen(&own, 1).map_err(failed)?;
        Ok(ArmLock { _socket: own })
    }
}

/// Non-blocking Unix stream socket: a full connection queue is an error.
fn socket() -> rustix::io::Result<OwnedFd> {
    let flags = SocketFlags::CLOEXEC | SocketFlags::NONBLOCK;
    socket_with(AddressFamily::UNIX, SocketType::STREAM, flags, None)
}

/// Process and user that listen at `address`, by the kernel's credentials.
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
    use plumbline_testkit::memory::wait_for;

    #[test]
    fn a_second_lock_of_an_arm_fails_with_the_arm_s_name() {
        let name = format!("test/{}", std::process::id());
        let lock = ArmLock::take(&name).unwrap();
        // Repeatedly: failed attempts do not release or exhaust the lock.
        for _ in 0..5 {
            let error = ArmLock::take(&name).unwrap_err();
            assert!(matches!(error, ArmLockError::Held { .. }), "{error}");
            assert!(error.to_string().contains(&name), "{error}");
        }
        ArmLock::take(&format!("{name}/other")).unwrap();
        drop(lock);
        // Not at once: a process that another test is starting has a copy of every descriptor from its fork to its exec.
        wait_for("the release of the lock", || ArmLock::take(&name).is_ok());
    }

    #[test]
    fn the_holder_is_named_by_process_and_user() {
        let name = format!("test-holder/{}", std::process::id());
        let _lock = ArmLock::take(&name).unwrap();
        let own = format!("process {} of user {}", std::process::id(), rustix::process::geteuid().as_raw());
        assert!(ArmLock::take(&name).unwrap_err().to_string().contains(&own));
    }
}
