//! Exclusive lock per robot: an advisory file lock that the kernel releases when the process ends.
//!
//! The lock belongs to the open file: a child that inherits the open file inherits the lock without a gap.

use std::fs::{self, File, OpenOptions, TryLockError};
use std::io;
use std::os::fd::OwnedFd;
use std::os::unix::fs::{FileExt, MetadataExt, OpenOptionsExt};
use std::path::{Path, PathBuf};

use super::robot::RobotId;
use super::runtime_dir::{self, RuntimeDirError};

/// Why the lock could not be taken.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum LockError {
    #[error("another daemon ({holder}) serves robot `{robot}` (lock {})", path.display())]
    Held { robot: String, holder: String, path: PathBuf },
    #[error(transparent)]
    Place(#[from] RuntimeDirError),
    #[error("lock file {}: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
}

/// Content of the lock file; its length is constant for one process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Entry {
    /// The process that serves the robot.
    pub process: u32,
    /// Stops that this process has executed.
    pub stops: u64,
    /// Time of the last executed stop, `CLOCK_MONOTONIC`, 0 before the first \[ns\].
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

    /// Reads the file at `path`; `None` where it does not exist or names no process.
    pub(super) fn read(path: &Path) -> Option<Entry> {
        Entry::parse(&fs::read_to_string(path).ok()?)
    }
}

/// Exclusive lock of one robot, released when dropped.
///
/// The file is not removed with the lock: otherwise two daemons could lock two files of the same name.
#[derive(Debug)]
pub struct Lock {
    path: PathBuf,
    file: File,
}

impl Lock {
    /// Takes the lock of `robot` in the user's runtime directory, [`runtime_dir::directory`].
    pub fn take(robot: &RobotId) -> Result<Lock, LockError> {
        Lock::take_in(&runtime_dir::directory()?, robot)
    }

    /// Takes the lock of `robot` in `directory`, which is created if it is missing.
    pub fn take_in(directory: &Path, robot: &RobotId) -> Result<Lock, LockError> {
        let path = path_in(directory, robot);
        let failed = |source: io::Error| LockError::Io { path: path.clone(), source };
        fs::create_dir_all(directory).map_err(failed)?;
        let mut open = OpenOptions::new();
        open.read(true).write(true).create(true).truncate(false).mode(0o600).custom_flags(libc::O_NOFOLLOW);
        let file = open.open(&path).map_err(failed)?;
        Lock::hold(path, file, robot)
    }

    /// Adopts the lock of `robot` that the parent process passed on ([`Lock::pass_on`]). Both hold the lock; it is
    /// released when both have ended.
    ///
    /// # Errors
    /// [`LockError::Held`] where this process does not hold the lock: the lock was not passed on, or its file was replaced.
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
        Lock::write_entry(path.clone(), file).map_err(failed)
    }

    fn hold(path: PathBuf, file: File, robot: &RobotId) -> Result<Lock, LockError> {
        let failed = |source: io::Error| LockError::Io { path: path.clone(), source };
        match file.try_lock() {
            Ok(()) => Lock::write_entry(path.clone(), file).map_err(failed),
            Err(TryLockError::WouldBlock) => Err(held(&path, robot)),
            Err(TryLockError::Error(source)) => Err(failed(source)),
        }
    }

    /// Writes the serving process into the file, for a second daemon and for `plumbline command stop`. The lock does not depend on this text.
    fn write_entry(path: PathBuf, file: File) -> io::Result<Lock> {
        let entry = Entry { process: std::process::id(), stops: 0, stop_ns: 0 };
        file.set_len(0)?;
        file.write_all_at(entry.text().as_bytes(), 0)?;
        Ok(Lock { path, file })
    }

    /// The lock file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Makes the lock inheritable by child processes that are started while the result exists; they call [`Lock::adopt`].
    ///
    /// # Errors
    /// No file descriptor is left.
    pub fn pass_on(&self) -> io::Result<OwnedFd> {
        // A duplicate shares the open file and is not closed on exec.
        Ok(rustix::io::dup(&self.file)?)
    }

    /// Counter of executed stops in this file. Counting overwrites in place and needs no disk space.
    pub(super) fn counter(&self) -> io::Result<StopCounter> {
        let entry = Entry { process: std::process::id(), stops: 0, stop_ns: 0 };
        Ok(StopCounter { file: self.file.try_clone()?, entry })
    }
}

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

/// Whether `process` holds the lock on `lock`, by the kernel's list of its open files.
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

#[derive(Debug)]
pub(super) struct StopCounter {
    file: File,
    entry: Entry,
}

impl StopCounter {
    pub(super) fn count(&mut self, now_ns: u64) -> io::Result<()> {
        self.entry.stops += 1;
        self.entry.stop_ns = now_ns;
        self.file.write_all_at(self.entry.text().as_bytes(), 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_testkit::memory::wait_for;

    #[test]
    fn the_error_of_a_second_daemon_names_the_first() {
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
        // Not at once: a process that another test is starting has a copy of every descriptor from its fork to its exec.
        wait_for("the release of the lock", || Lock::take_in(directory.path(), &robot).is_ok());
    }

    #[test]
    fn an_inherited_lock_outlives_the_process_that_took_it() {
        let directory = tempfile::tempdir().unwrap();
        let robot = RobotId::parse("test", "robot", "panda").unwrap();
        let first = Lock::take_in(directory.path(), &robot).unwrap();
        let metadata = fs::metadata(first.path()).unwrap();
        let passed_on = first.pass_on().unwrap();
        let mut child = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        drop(passed_on);
        let mut later = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        assert!(is_held_by(&metadata, child.id()).unwrap() && is_held_by(&metadata, std::process::id()).unwrap());
        assert!(
            !is_held_by(&metadata, later.id()).unwrap(),
            "only children started while it is passed on inherit the lock"
        );
        drop(first);
        assert!(matches!(Lock::take_in(directory.path(), &robot), Err(LockError::Held { .. })));
        // A process that does not hold the lock can't adopt it.
        assert!(!is_held_by(&metadata, std::process::id()).unwrap());
        assert!(matches!(Lock::adopt_in(directory.path(), &robot), Err(LockError::Held { .. })));
        for process in [&mut child, &mut later] {
            process.kill().unwrap();
            process.wait().unwrap();
        }
        let mut again = None;
        wait_for("the release of the lock", || {
            again = Lock::take_in(directory.path(), &robot).ok();
            again.is_some()
        });
        let again = again.unwrap();
        Lock::adopt_in(directory.path(), &robot).unwrap();
        // Nor where its file was replaced.
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
        assert_eq!(fs::metadata(lock.path()).unwrap().len(), size, "counting does not grow the file");
        assert_eq!(Entry::parse("process 12\n"), Some(Entry { process: 12, stops: 0, stop_ns: 0 }));
        assert_eq!(Entry::parse("process -1\n"), None);
    }

    #[test]
    fn the_error_names_a_directory_that_can_not_be_created() {
        let directory = tempfile::tempdir().unwrap();
        let blocked = directory.path().join("file");
        fs::write(&blocked, "").unwrap();
        let robot = RobotId::parse("test", "robot", "panda").unwrap();
        let error = Lock::take_in(&blocked, &robot).unwrap_err();
        assert!(error.to_string().contains("panda.lock"), "{error}");
    }
}
