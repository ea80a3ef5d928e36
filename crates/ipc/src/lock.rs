//! One daemon per robot, held by an advisory file lock that the kernel drops with the process, however it ends.
//!
//! The lock belongs to the open file: a process that passes its open file to a child passes the lock, without a gap.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use super::robot::RobotId;
use super::runtime_dir::{self, RuntimeDirError};

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
    Place(#[from] RuntimeDirError),
    /// The lock file could not be used.
    #[error("lock file {}: {source}", path.display())]
    Io {
        /// The lock file.
        path: PathBuf,
        /// What the operating system says.
        source: io::Error,
    },
}

/// What the lock file says, always in the same number of bytes for one process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    /// The process that serves the robot.
    pub process: u32,
    /// Stops that this process has taken.
    pub stops: u64,
    /// `CLOCK_MONOTONIC` when the last of them was taken, 0 before the first \[ns\].
    pub stop_ns: u64,
}

impl Entry {
    fn text(&self) -> String {
        format!("process {}\nstops {:020}\nstop-ns {:020}\n", self.process, self.stops, self.stop_ns)
    }

    fn parse(text: &str) -> Option<Entry> {
        let number = |key: &str| text.lines().find_map(|line| line.strip_prefix(key)?.trim().parse().ok());
        let process = u32::try_from(number("process ")?).ok()?;
        Some(Entry { process, stops: number("stops ").unwrap_or(0), stop_ns: number("stop-ns ").unwrap_or(0) })
    }

    /// What the file at `path` says; `None` where it does not exist or names no process.
    pub(super) fn read(path: &Path) -> Option<Entry> {
        Entry::parse(&fs::read_to_string(path).ok()?)
    }
}

/// The right to serve a robot, until it is dropped.
///
/// The file stays when the lock goes: removing it would let two daemons lock two files of the same name.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    file: File,
}

impl Lock {
    /// Takes the lock of `robot` in the user's own folder, [`runtime_dir::directory`].
    pub fn take(robot: &RobotId) -> Result<Lock, LockError> {
        Lock::take_in(&runtime_dir::directory()?, robot)
    }

    /// Takes the lock of `robot` in `directory`, which is made if it is missing.
    pub fn take_in(directory: &Path, robot: &RobotId) -> Result<Lock, LockError> {
        let path = path_in(directory, robot);
        let failed = |source: io::Error| LockError::Io { path: path.clone(), source };
        fs::create_dir_all(directory).map_err(failed)?;
        let mut open = OpenOptions::new();
        open.read(true).write(true).create(true).truncate(false).mode(0o600).custom_flags(libc::O_NOFOLLOW);
        let file = open.open(&path).map_err(failed)?;
        Lock::hold(path, file, robot)
    }

    /// Takes over the lock of `robot` from the process that started this one and passed its open file on ([`Lock::pass_on`]). Both hold the lock; it is
    /// free when both have ended.
    ///
    /// # Errors
    /// [`LockError::Held`] where this process does not hold the lock: it was not passed on, or another file has taken the place of the one that was.
    pub fn adopt(robot: &RobotId) -> Result<Lock, LockError> {
        Lock::adopt_in(&runtime_dir::directory()?, robot)
    }

    fn adopt_in(directory: &Path, robot: &RobotId) -> Result<Lock, LockError> {
        let path = path_in(directory, robot);
        let failed = |source: io::Error| LockError::Io { path: path.clone(), source };
        let file =
            OpenOptions::new().read(true).write(true).custom_flags(libc::O_NOFOLLOW).open(&path).map_err(failed)?;
        if !is_held_by(&file.metadata().map_err(failed)?, std::process::id()).map_err(failed)? {
            return Err(held(&path, robot));
        }
        Lock::enter(path.clone(), file).map_err(failed)
    }

    fn hold(path: PathBuf, file: File, robot: &RobotId) -> Result<Lock, LockError> {
        let failed = |source: io::Error| LockError::Io { path: path.clone(), source };
        match file.try_lock() {
            Ok(()) => Lock::enter(path.clone(), file).map_err(failed),
            Err(TryLockError::WouldBlock) => Err(held(&path, robot)),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Writes who serves the robot: for a second daemon, and for `plumbline command stop`. The lock itself does not depend on this text.
    fn enter(path: PathBuf, file: File) -> io::Result<Lock> {
        let entry = Entry { process: std::process::id(), stops: 0, stop_ns: 0 };
        file.set_len(0)?;
        file.write_all_at(entry.text().as_bytes(), 0)?;
        Ok(Lock { path, file })
    }

    /// The lock file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens the lock to child processes that are started while the result lives: [`Lock::adopt`] there.
    ///
    /// # Errors
    /// No file descriptor is left.
    pub fn pass_on(&self) -> io::Result<OwnedFd> {
        // A duplicate is the same open file, and is not closed when a child runs another program.
        Ok(rustix::io::dup(&self.file)?)
    }

    /// Where stops are counted. Its memory is there already: counting needs no room on any disk.
    pub(super) fn counter(&self) -> io::Result<StopCounter> {
        let entry = Entry { process: std::process::id(), stops: 0, stop_ns: 0 };
        Ok(StopCounter { file: self.file.try_clone()?, entry })
    }
}

/// The lock file of `robot` in `directory`.
pub(super) fn path_in(directory: &Path, robot: &RobotId) -> PathBuf {
    directory.join(format!("{robot}.lock"))
}

fn held(path: &Path, robot: &RobotId) -> LockError {
    let holder = match Entry::read(path) {
        Some(entry) => format!("process {}", entry.process),
        None => "process unknown".to_string(),
    };
    LockError::Held { robot: robot.to_string(), holder, path: path.to_path_buf() }
}

/// Whether `process` has a file open that holds the lock on `lock`, as the kernel says.
pub(super) fn is_held_by(lock: &fs::Metadata, process: u32) -> io::Result<bool> {
    let folder = PathBuf::from("/proc").join(process.to_string());
    for number in fs::read_dir(folder.join("fd"))?.filter_map(|entry| Some(entry.ok()?.file_name())) {
        let is_lock = fs::metadata(folder.join("fd").join(&number))
            .is_ok_and(|file| (file.dev(), file.ino()) == (lock.dev(), lock.ino()));
        let info = || fs::read_to_string(folder.join("fdinfo").join(&number)).unwrap_or_default();
        if is_lock && info().lines().any(|line| line.starts_with("lock:") && line.contains("FLOCK")) {
            return Ok(true);
        }
    }
    Ok(false)
}

/// Counts the stops that were taken, in the lock file.
#[derive(Debug)]
pub(super) struct StopCounter {
    file: File,
    entry: Entry,
}

impl StopCounter {
    /// One more, taken at `now_ns`.
    pub(super) fn count(&mut self, now_ns: u64) -> io::Result<()> {
        self.entry.stops += 1;
        self.entry.stop_ns = now_ns;
        self.file.write_all_at(self.entry.text().as_bytes(), 0)
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
    fn a_lock_that_was_passed_on_outlives_the_process_that_took_it() {
        let directory = tempfile::tempdir().unwrap();
        let robot = RobotId::parse("test", "robot", "panda").unwrap();
        let first = Lock::take_in(directory.path(), &robot).unwrap();
        let metadata = fs::metadata(first.path()).unwrap();
        let passed_on = first.pass_on().unwrap();
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        drop(passed_on);
        let mut later = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        assert!(is_held_by(&metadata, child.id()).unwrap() && is_held_by(&metadata, std::process::id()).unwrap());
        assert!(!is_held_by(&metadata, later.id()).unwrap(), "passed on to those that are started meanwhile alone");
        drop(first);
        assert!(matches!(Lock::take_in(directory.path(), &robot), Err(LockError::Held { .. })));
        // Who does not hold it can't adopt it.
        assert!(!is_held_by(&metadata, std::process::id()).unwrap());
        assert!(matches!(Lock::adopt_in(directory.path(), &robot), Err(LockError::Held { .. })));
        for process in [&mut child, &mut later] {
            process.kill().unwrap();
            process.wait().unwrap();
        }
        let again = Lock::take_in(directory.path(), &robot).unwrap();
        Lock::adopt_in(directory.path(), &robot).unwrap();
        // Not where another file has taken its place.
        fs::remove_file(again.path()).unwrap();
        fs::write(again.path(), "process 1\n").unwrap();
        let error = Lock::adopt_in(directory.path(), &robot).unwrap_err();
        assert!(error.to_string().contains("another daemon (process 1)"), "{error}");
    }

    #[test]
    fn the_lock_file_counts_the_stops_of_its_process() {
        let directory = tempfile::tempdir().unwrap();
        let robot = RobotId::parse("test", "robot", "panda").unwrap();
        let lock = Lock::take_in(directory.path(), &robot).unwrap();
        let process = std::process::id();
        assert_eq!(Entry::read(lock.path()), Some(Entry { process, stops: 0, stop_ns: 0 }));
        let size = fs::metadata(lock.path()).unwrap().len();
        let mut counter = lock.counter().unwrap();
        counter.count(17).unwrap();
        counter.count(u64::MAX).unwrap();
        assert_eq!(Entry::read(lock.path()), Some(Entry { process, stops: 2, stop_ns: u64::MAX }));
        assert_eq!(fs::metadata(lock.path()).unwrap().len(), size, "counting needs no more room");
        assert_eq!(Entry::parse("process 12\n"), Some(Entry { process: 12, stops: 0, stop_ns: 0 }));
        assert_eq!(Entry::parse("process -1\n"), None);
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
