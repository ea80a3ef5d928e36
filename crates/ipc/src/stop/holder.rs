//! Process that holds a lock file, verified through the kernel before it is signalled.

use std::fs;
use std::os::fd::OwnedFd;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};

use crate::lock::is_held_by;
use rustix::process::{Pid, PidfdFlags, Signal, pidfd_open, pidfd_send_signal};

/// Verified process that holds the lock and handles SIGUSR2.
#[derive(Debug)]
pub(super) struct Holder {
    process: OwnedFd,
}

/// Why a process is not signalled.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Refusal {
    /// The process serves no robot, although the lock file names it.
    pub serves_none: bool,
    /// Description for the error message.
    pub reason: String,
}

impl Holder {
    /// Verifies that process `pid` holds the lock on `path`, belongs to the owner of that file, and handles SIGUSR2.
    ///
    /// # Errors
    /// The reason why it must not be signalled.
    pub(super) fn verified(path: &Path, pid: u32) -> Result<Holder, Refusal> {
        let unknown = |reason: &dyn std::fmt::Display| Refusal {
            serves_none: false,
            reason: format!("process {pid} can't be inspected: {reason}"),
        };
        let serves_none = |reason: String| Refusal { serves_none: true, reason };
        let number = i32::try_from(pid).ok().and_then(Pid::from_raw);
        let number = number.ok_or_else(|| serves_none(format!("{pid} is not a process number")))?;
        // Opened first: the descriptor stays bound to this process even when its number is reused.
        let process = pidfd_open(number, PidfdFlags::empty()).map_err(|error| match error {
            rustix::io::Errno::SRCH => serves_none(format!("process {pid} has ended")),
            error => unknown(&error),
        })?;
        let lock = fs::metadata(path).map_err(|error| unknown(&format!("{}: {error}", path.display())))?;
        let folder = PathBuf::from("/proc").join(pid.to_string());
        let owner = fs::metadata(&folder).map_err(|error| unknown(&error))?.uid();
        if owner != lock.uid() {
            let reason = format!("process {pid} belongs to user {owner}, the lock file to user {}", lock.uid());
            return Err(serves_none(reason));
        }
        if !is_held_by(&lock, pid).map_err(|error| unknown(&error))? {
            return Err(serves_none(format!("process {pid} does not hold the lock")));
        }
        let status = fs::read_to_string(folder.join("status")).map_err(|error| unknown(&error))?;
        if !handles(&status, Signal::USR2) {
            return Err(serves_none(format!("process {pid} holds the lock and serves no robot yet")));
        }
        Ok(Holder { process })
    }

    /// Requests a stop by SIGUSR2.
    pub(super) fn signal(&self) -> Result<(), Refusal> {
        pidfd_send_signal(&self.process, Signal::USR2)
            .map_err(|error| Refusal { serves_none: false, reason: format!("SIGUSR2: {error}") })
    }
}

/// Whether a process has a handler for `signal`, by the text of `/proc/PID/status`.
fn handles(status: &str, signal: Signal) -> bool {
    let mask = status.lines().find_map(|line| line.strip_prefix("SigCgt:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal.as_raw() - 1) & 1 == 1
}
