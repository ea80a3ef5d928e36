//! Signals that end a process, and the death of a parent process: an arm that moves is braked first.
//!
//! A handler only stores which signal arrived; the bridge thread reads it. A second signal stores its number and nothing else, so
//! it can't cut a controlled stop short.

use crate::failure::Failure;
use crate::recording::about::ReasonKind;
use signal_hook::low_level::signal_name;
use std::fmt;
use std::io::Read;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Every signal that ends a process by default, except the real-time ones, which [`caught`] adds, and these:
///
/// - SIGUSR2 has a meaning of its own.
/// - SIGPIPE is ignored, as in every Rust program: a closed log or client is no reason to stop.
/// - SIGABRT, SIGBUS, SIGFPE, SIGILL, SIGSEGV, SIGSYS and SIGTRAP are faults of the program itself. systemd's watchdog sends SIGABRT.
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
/// What ends a computation. SIGTSTP (Ctrl-Z) stops it and SIGCONT continues it, as any program.
const INTERRUPTS: [i32; 2] = [libc::SIGINT, libc::SIGTERM];
/// Stored where no signal number can be: the parent process has ended.
const PARENT_ENDED: usize = usize::MAX;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// A signal arrived, by its number.
    Signal(i32),
    ParentEnded,
}

impl Cause {
    pub fn kind(self) -> ReasonKind {
        match self {
            Cause::Signal(_) => ReasonKind::Signal,
            Cause::ParentEnded => ReasonKind::ParentEnded,
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

#[derive(Clone, Debug, Default)]
pub struct Ending(Arc<AtomicUsize>);

impl Ending {
    pub fn watch() -> Result<Ending, Failure> {
        Ending::of(caught(ignores_hangup()))
    }

    /// Catches Ctrl-C and SIGTERM alone, for a computation that leaves the best result so far; no arm depends on it.
    pub fn interrupts() -> Result<Ending, Failure> {
        Ending::of(INTERRUPTS)
    }

    fn of(signals: impl IntoIterator<Item = i32>) -> Result<Ending, Failure> {
        let ending = Ending::default();
        for signal in signals {
            signal_hook::flag::register_usize(signal, Arc::clone(&ending.0), signal as usize).map_err(Failure::job)?;
        }
        Ok(ending)
    }

    /// The end of standard input counts as the end of the parent process, which holds the other end of that pipe. The kernel closes the pipe with
    /// the process, whatever thread of it made this one, and also where it died before this call.
    pub fn watch_parent(&self) -> Result<(), Failure> {
        let stored = Arc::clone(&self.0);
        let read = move || {
            let mut bytes = [0; 64];
            while matches!(std::io::stdin().read(&mut bytes), Ok(1..)) {}
            stored.store(PARENT_ENDED, Ordering::SeqCst);
        };
        std::thread::Builder::new().name("plumbline-parent".into()).spawn(read).map_err(Failure::job)?;
        Ok(())
    }

    /// Why the process is to end, if it is.
    pub fn cause(&self) -> Option<Cause> {
        match self.0.load(Ordering::SeqCst) {
            0 => None,
            PARENT_ENDED => Some(Cause::ParentEnded),
            signal => Some(Cause::Signal(signal as i32)),
        }
    }

    #[cfg(test)]
    pub fn arrive(&self, cause: Cause) {
        let stored = match cause {
            Cause::Signal(signal) => signal as usize,
            Cause::ParentEnded => PARENT_ENDED,
        };
        self.0.store(stored, Ordering::SeqCst);
    }

    pub fn arrived(&self) -> bool {
        self.cause().is_some()
    }
}

/// The signals to catch. A hangup that is ignored from the start stays ignored: `nohup` requires that.
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
    fn a_cause_names_the_signal() {
        let words = |signal| Cause::Signal(signal).to_string();
        assert_eq!(words(libc::SIGHUP), "signal SIGHUP arrived");
        assert_eq!(words(libc::SIGPWR), "signal SIGPWR arrived");
        assert_eq!(words(libc::SIGRTMIN() + 3), "signal SIGRTMIN+3 arrived");
        assert!(caught(false).all(|signal| words(signal).contains("SIG")));
    }
}
