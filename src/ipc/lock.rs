//! One daemon per robot, held by an advisory file lock that the kernel drops with the process, however it ends.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, Read, Seek, Write};
use std::os::unix::fs::OpenOptionsExt;
use std::path::{Path, PathBuf};

use super::place::{self, PlaceError};
use super::robot::RobotId;

/// Why the lock could not be had.
#[derive(Debug, thiserror::Error)]
pub enum LockError {
    /// Another daemon serves this robot.
    #[error("another daemon ({holder}) serves robot `{robot}` (lock {})", path.display())]
    Held {
        /// The robot.
        robot: String,
        /// Process of the other daemon, as it wrote it.
        holder: String,
        /// The lock file.
        path: PathBuf,
    },
    /// There is no folder to trust.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// The lock file could not be used.
    #[error("lock file {}: {source}", path.display())]
    Io {
        /// The lock file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
}

/// The right to serve a robot, until it is dropped.
///
/// The file stays when the lock goes: removing it would let two daemons lock two files of the same name.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    _file: File,
}

impl Lock {
    /// Takes the lock of `robot` in the user's own folder, [`place::directory`].
    pub fn take(robot: &RobotId) -> Result<Lock, LockError> {
        Lock::take_in(&place::directory()?, robot)
    }

    /// Takes the lock of `robot` in `directory`, which is made if it is missing.
    pub fn take_in(directory: &Path, robot: &RobotId) -> Result<Lock, LockError> {
        let path = directory.join(format!("{robot}.lock"));
        let failed = |source: io::Error| LockError::Io { path: path.clone(), source };
        fs::create_dir_all(directory).map_err(failed)?;
        let mut open = OpenOptions::new();
        open.read(true).write(true).create(true).truncate(false).mode(0o600).custom_flags(libc::O_NOFOLLOW);
        let mut file = open.open(&path).map_err(failed)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                let mut holder = String::new();
                let known = file.read_to_string(&mut holder).is_ok() && !holder.trim().is_empty();
                let holder = if known { holder.trim().to_string() } else { "process unknown".to_string() };
                return Err(LockError::Held { robot: robot.to_string(), holder, path });
            }
            Err(TryLockError::Error(source)) => return Err(failed(source)),
        }
        // Who holds it, for whoever comes second. The lock itself does not depend on this text.
        file.set_len(0).map_err(failed)?;
        file.rewind().map_err(failed)?;
        writeln!(file, "process {}", std::process::id()).map_err(failed)?;
        file.flush().map_err(failed)?;
        Ok(Lock { path, _file: file })
    }

    /// The lock file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_second_daemon_is_told_who_the_first_is() {
        let directory = tempfile::tempdir().unwrap();
        let robot = RobotId::parse("test", "robot", "panda").unwrap();
        let other = RobotId::parse("test", "robot", "ur10").unwrap();

        let lock = Lock::take_in(directory.path(), &robot).unwrap();
        let error = Lock::take_in(directory.path(), &robot).unwrap_err();
        assert!(matches!(error, LockError::Held { .. }));
        assert!(error.to_string().contains(&format!("process {}", std::process::id())), "{error}");
        Lock::take_in(directory.path(), &other).unwrap();

        assert!(lock.path().is_file());
        drop(lock);
        Lock::take_in(directory.path(), &robot).unwrap();
    }

    #[test]
    fn a_directory_that_can_not_be_made_is_named() {
        let directory = tempfile::tempdir().unwrap();
        let blocked = directory.path().join("file");
        fs::write(&blocked, "").unwrap();
        let robot = RobotId::parse("test", "robot", "panda").unwrap();
        let error = Lock::take_in(&blocked, &robot).unwrap_err();
        assert!(error.to_string().contains("panda.lock"), "{error}");
    }
}
