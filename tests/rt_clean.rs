//! The loop's thread is clean: over whole runs on every arm it allocates nothing, and makes no system call but those of its clock and its arm.
//!
//! System calls are counted by the kernel itself: on its first read the loop's thread puts itself under a seccomp filter that kills
//! the whole program at any other call, so each such run is a program of its own (this test, started again). Under the feature `rtsan`
//! the same runs are watched by LLVM's RealtimeSanitizer (`hil/rtsan/run.sh`).

mod clean;

use clean::{ARMS, Seal, run};
use plumbline_testkit::turns::Turns;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, ExitStatus};

#[global_allocator]
static WATCH: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

const RUN: &str = "PLUMBLINE_TEST_SEALED_RUN";
const SIGSYS: i32 = 31;
/// An emulated robot may stop by itself where this machine stalls; one run of so many must come through.
const TRIES: usize = 6;

/// These runs keep the clock's time: no more at a time than a small machine has processors.
static RUNS: Turns = Turns::new(2);

#[test]
fn whole_runs_on_every_arm_allocate_nothing() {
    let _turn = RUNS.take();
    for arm in ARMS {
        let mut runs = (0..TRIES).map(|_| run(arm, Seal::Open));
        let outcome = runs.find_map(|run| run.inspect_err(|why| println!("{arm}: {why:?}")).ok());
        let outcome = outcome.unwrap_or_else(|| panic!("{arm}: no whole run in {TRIES}"));
        let summary = outcome.summary;
        assert_eq!(outcome.allocations, Some(0), "{arm}: {:?} {summary:?}", outcome.end);
        assert!(summary.accounted(), "{arm}: {:?} {summary:?}", outcome.end);
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
    let _ = run(arm, seal);
}

#[test]
#[cfg_attr(feature = "rtsan", ignore = "RTSan ends the program before the filter does")]
fn whole_runs_on_every_arm_make_no_stray_system_call() {
    let _turn = RUNS.take();
    for arm in ARMS {
        // However it ends, no run may be killed by the filter; and one of them is a whole one.
        let whole = (0..TRIES).any(|_| {
            let (status, message) = alone(arm, "calls");
            assert!(status.success() && message.contains("sealed run"), "{arm}: {status}\n{message}");
            message.contains("sealed run complete")
        });
        assert!(whole, "{arm}: no whole run in {TRIES}");
    }
}

#[test]
#[cfg_attr(feature = "rtsan", ignore = "RTSan ends the program before the filter does")]
fn the_filter_would_notice() {
    let _turn = RUNS.take();
    // One call of getpid, a growing heap, a line of output, a file: each of them in one cycle of the middle of a run.
    for stray in ["getpid", "mmap", "print", "file"] {
        let (status, message) = alone(ARMS[0], &format!("stray-{stray}"));
        assert_eq!(status.signal(), Some(SIGSYS), "{stray}: {status}\n{message}");
    }
}

/// Under RTSan every run above is watched by it; here it must object. Without it, the same runs pass: they are what the filter is for.
#[test]
fn rtsan_would_notice() {
    let _turn = RUNS.take();
    for stray in ["mmap", "print"] {
        let (status, message) = alone(ARMS[0], &format!("loose-{stray}"));
        let objected = message.contains("RealtimeSanitizer") && !status.success();
        assert_eq!(objected, cfg!(feature = "rtsan"), "{stray}: {status}\n{message}");
        assert!(objected || status.success(), "{stray}: {status}\n{message}");
    }
}
