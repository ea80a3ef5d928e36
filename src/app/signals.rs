//! Signals that end a process, and the death of a parent process: an arm that moves is braked first.
//!
//! A handler only stores which signal arrived; the thread that talks to the loop reads it. A second signal stores its number and nothing else, so
//! it can't cut a controlled stop short.

use super::Failure;
use rustix::process::{Pid, getppid};
use signal_hook::low_level::signal_name;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Every signal that ends a process by default, except the real-time ones, which [`caught`] adds, and these:
///
/// - SIGUSR2 has a meaning of its own.
/// - SIGPIPE is ignored, as in every Rust program: a log or a client that is gone is no reason to stop.
/// - SIGABRT, SIGBUS, SIGFPE, SIGILL, SIGSEGV, SIGSYS and SIGTRAP say that the program itself is broken. systemd's watchdog sends SIGABRT.
/// - SIGKILL and SIGSTOP can't be caught.
///
/// SIGTSTP (Ctrl-Z) stops a process by default, and a stopped process can't control an arm.
const ENDING: [i32; 14] = [
    libc::SIGHUP,
    libc::SIGINT,
    libc::SIGQUIT,
    libc::SIGUSR1,
    libc::SIGALRM,
    libc::SIGTERM,
    libc::SIGSTKFLT,
    libc::SIGTSTP,
    libc::SIGXCPU,
    libc::SIGXFSZ,
    libc::SIGVTALRM,
    libc::SIGPROF,
    libc::SIGIO,
    libc::SIGPWR,
];
/// Why a process is to end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// A signal arrived, by its number.
    Signal(i32),
    /// The process that started this one has ended.
    ParentEnded,
}

impl Cause {
    /// One word for the name of a recording.
    pub fn kind(self) -> &'static str {
        match self {
            Cause::Signal(_) => "signal",
            Cause::ParentEnded => "parent-ended",
        }
    }
}

impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Cause::ParentEnded => f.write_str("the process that started this daemon has ended"),
            Cause::Signal(signal) => match signal_name(signal) {
                Some(name) => write!(f, "signal {name} arrived"),
                None if signal == libc::SIGSTKFLT => f.write_str("signal SIGSTKFLT arrived"),
                None if signal == libc::SIGPWR => f.write_str("signal SIGPWR arrived"),
                None => write!(f, "signal SIGRTMIN+{} arrived", signal - libc::SIGRTMIN()),
            },
        }
    }
}

/// The latest reason to end.
#[derive(Clone, Debug, Default)]
pub struct Ending {
    /// Number of the signal that arrived last, 0 before the first.
    signal: Arc<AtomicUsize>,
    parent: Option<i32>,
}

impl Ending {
    /// Catches every ending signal from now on.
    pub fn watch() -> Result<Ending, Failure> {
        let ending = Ending::default();
        for signal in caught(ignores_hangup()) {
            let stored = Arc::clone(&ending.signal);
            signal_hook::flag::register_usize(signal, stored, signal as usize).map_err(Failure::job)?;
        }
        Ok(ending)
    }

    /// The process `parent` has started this one: its end is a reason to end.
    ///
    /// The kernel gives an orphan another parent, so a look at the parent's number is enough. Unlike PR_SET_PDEATHSIG it does not depend on the thread
    /// that started this process, nor on whether that has ended before this call; unlike a pipe it needs no open file in both processes.
    pub fn with_parent(self, parent: Option<i32>) -> Ending {
        Ending { parent, ..self }
    }

    /// Why the process is to end, if it is.
    pub fn cause(&self) -> Option<Cause> {
        match self.signal.load(Ordering::SeqCst) {
            0 if self.parent.is_some_and(|parent| Pid::as_raw(getppid()) != parent) => Some(Cause::ParentEnded),
            0 => None,
            signal => Some(Cause::Signal(signal as i32)),
        }
    }

    /// Whether the process is to end.
    pub fn arrived(&self) -> bool {
        self.cause().is_some()
    }
}

/// The signals to catch. A hangup that is ignored from the start stays ignored: that is what `nohup` asks for.
fn caught(hangup_ignored: bool) -> impl Iterator<Item = i32> {
    let named = ENDING.into_iter().filter(move |&signal| !(hangup_ignored && signal == libc::SIGHUP));
    named.chain(libc::SIGRTMIN()..=libc::SIGRTMAX())
}

fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 != 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_signal_that_ends_a_process_is_caught_or_excepted_by_name() {
        // The signals whose default is to stop a process, to go on, or to do nothing: signal(7).
        let harmless = [libc::SIGCHLD, libc::SIGCONT, libc::SIGTTIN, libc::SIGTTOU, libc::SIGURG, libc::SIGWINCH];
        let broken =
            [libc::SIGABRT, libc::SIGBUS, libc::SIGFPE, libc::SIGILL, libc::SIGSEGV, libc::SIGSYS, libc::SIGTRAP];
        let others = [libc::SIGKILL, libc::SIGSTOP, libc::SIGPIPE, libc::SIGUSR2];
        let caught: Vec<i32> = caught(false).collect();
        for signal in 1..=31 {
            let excepted = harmless.iter().chain(&broken).chain(&others).any(|&other| other == signal);
            assert_ne!(caught.contains(&signal), excepted, "{}", Cause::Signal(signal));
        }
        assert!((libc::SIGRTMIN()..=libc::SIGRTMAX()).all(|signal| caught.contains(&signal)));
        assert!(!super::caught(true).any(|signal| signal == libc::SIGHUP));
    }

    #[test]
    fn a_parent_that_is_not_the_parent_any_more_has_ended() {
        let parent = Pid::as_raw(getppid());
        assert_eq!(Ending::default().with_parent(Some(parent)).cause(), None);
        assert_eq!(Ending::default().with_parent(Some(parent + 1)).cause(), Some(Cause::ParentEnded));
        let signalled = Ending::default().with_parent(Some(parent + 1));
        signalled.signal.store(libc::SIGHUP as usize, Ordering::SeqCst);
        assert_eq!(signalled.cause(), Some(Cause::Signal(libc::SIGHUP)));
    }

    #[test]
    fn a_cause_names_the_signal() {
        let words = |signal| Cause::Signal(signal).to_string();
        assert_eq!(words(libc::SIGHUP), "signal SIGHUP arrived");
        assert_eq!(words(libc::SIGPWR), "signal SIGPWR arrived");
        assert_eq!(words(libc::SIGRTMIN() + 3), "signal SIGRTMIN+3 arrived");
        assert!(caught(false).all(|signal| words(signal).contains("SIG")));
    }
}
