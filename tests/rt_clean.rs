//! The loop's thread is clean: over whole runs on every arm it allocates nothing, and makes no system call but those of its clock and its arm.
//!
//! System calls are counted by the kernel itself: on its first read the loop's thread puts itself under a seccomp filter that kills
//! the whole program at any other call, so each such run is a program of its own (this test, started again). Under the feature `rtsan`
//! the same runs are watched by LLVM's RealtimeSanitizer (`hil/rtsan/run.sh`).

mod backend_support;
mod clean;
mod common;
#[path = "../hil/fci-emulator/emulator/mod.rs"]
mod emulator;

use clean::{ARMS, Seal, run};
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, ExitStatus};

#[global_allocator]
static WATCH: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

/// Which run a program of its own makes.
const RUN: &str = "PLUMBLINE_TEST_SEALED_RUN";
const SIGSYS: i32 = 31;

#[test]
fn whole_runs_on_every_arm_allocate_nothing() {
    for arm in ARMS {
        let outcome = run(arm, Seal::Open);
        assert_eq!(outcome.allocations, Some(0), "{arm}: {outcome:?}");
        assert!(outcome.summary.accounted(), "{arm}: {outcome:?}");
    }
}

/// Starts this test again as a program that makes one run.
fn alone(arm: &str, seal: &str) -> (ExitStatus, String) {
    let mut program = Command::new(std::env::current_exe().unwrap());
    program.args(["--exact", "a_sealed_run", "--nocapture", "--test-threads=1"]).env(RUN, format!("{arm}+{seal}"));
    let done = program.output().unwrap();
    (done.status, String::from_utf8_lossy(&done.stdout).into_owned() + &String::from_utf8_lossy(&done.stderr))
}

/// One run under the filter, where the environment names one; by itself it has nothing to do.
#[test]
fn a_sealed_run() {
    let Ok(what) = std::env::var(RUN) else { return };
    let (arm, seal) = what.split_once('+').expect("an arm and a seal");
    let seal = Seal::parse(seal);
    let arm = ARMS.into_iter().find(|known| *known == arm).expect("a known arm");
    run(arm, seal);
}

#[test]
fn whole_runs_on_every_arm_make_no_stray_system_call() {
    for arm in ARMS {
        let (status, said) = alone(arm, "calls");
        assert!(status.success(), "{arm}: {status}\n{said}");
        assert!(said.contains("sealed run complete"), "{arm}: {said}");
    }
}

#[test]
fn the_filter_would_notice() {
    // One call of getpid, a growing heap, a line of output, a woken helper: each of them in one cycle of the middle of a run.
    for stray in ["getpid", "mmap", "print", "wake"] {
        let (status, said) = alone(ARMS[0], &format!("stray-{stray}"));
        assert_eq!(status.signal(), Some(SIGSYS), "{stray}: {status}\n{said}");
    }
}

/// Under RTSan every run above is watched by it; here it must object. Without it, the same runs pass: they are what the filter is for.
#[test]
fn rtsan_would_notice() {
    for stray in ["mmap", "print"] {
        let (status, said) = alone(ARMS[0], &format!("loose-{stray}"));
        let objected = said.contains("RealtimeSanitizer") && !status.success();
        assert_eq!(objected, cfg!(feature = "rtsan"), "{stray}: {status}\n{said}");
        assert!(objected || status.success(), "{stray}: {status}\n{said}");
    }
}
