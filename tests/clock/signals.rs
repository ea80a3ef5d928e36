//! Signals that end a process by default, and the death of `plumbline run`, during a motion: the arm is braked first, and a recording and a line of
//! the log name the signal.

use plumbline::recording::Recording;
use plumbline_core::{Phase, Record};
use plumbline_ipc::Progress;
use plumbline_testkit::job::*;
use std::path::PathBuf;
use std::process::Command;
use std::time::Duration;

/// SIGHUP, SIGINT, SIGQUIT, SIGUSR1, SIGALRM, SIGTERM, SIGSTKFLT, SIGTSTP, SIGXCPU, SIGXFSZ, SIGVTALRM, SIGPROF, SIGIO, SIGPWR, and the first and the
/// last real-time signal, with the names that the log has for them.
fn ending() -> Vec<(i32, String)> {
    let named = [
        (libc::SIGHUP, "SIGHUP"),
        (libc::SIGINT, "SIGINT"),
        (libc::SIGQUIT, "SIGQUIT"),
        (libc::SIGUSR1, "SIGUSR1"),
        (libc::SIGALRM, "SIGALRM"),
        (libc::SIGTERM, "SIGTERM"),
        (libc::SIGSTKFLT, "SIGSTKFLT"),
        (libc::SIGTSTP, "SIGTSTP"),
        (libc::SIGXCPU, "SIGXCPU"),
        (libc::SIGXFSZ, "SIGXFSZ"),
        (libc::SIGVTALRM, "SIGVTALRM"),
        (libc::SIGPROF, "SIGPROF"),
        (libc::SIGIO, "SIGIO"),
        (libc::SIGPWR, "SIGPWR"),
        (libc::SIGRTMIN(), "SIGRTMIN+0"),
        (libc::SIGRTMAX(), "SIGRTMIN+30"),
    ];
    named.into_iter().map(|(number, name)| (number, name.to_string())).collect()
}

fn recordings(place: &Place) -> Vec<PathBuf> {
    let files = std::fs::read_dir(place.out().join("flight")).map(|entries| entries.map(|entry| entry.unwrap().path()));
    let mut found: Vec<PathBuf> = files.map(Iterator::collect).unwrap_or_default();
    found.retain(|path| path.extension().is_some_and(|extension| extension == "mcap"));
    found
}

fn fastest(record: &Record) -> f64 {
    record.command.desired.dq.iter().fold(0.0, |fastest: f64, dq| fastest.max(dq.abs()))
}

/// The arm is well under way, at some speed.
fn in_motion(place: &Place) {
    place.await_motion();
    std::thread::sleep(Duration::from_millis(600));
}

/// The one recording: it was in motion, then a controlled stop, then rest; and its reason.
#[track_caller]
fn controlled_stop(place: &Place, what: &str) -> (String, String) {
    let found = recordings(place);
    assert_eq!(found.len(), 1, "{what}: {found:?}");
    let recording = Recording::read(&found[0]).unwrap();
    std::fs::remove_file(&found[0]).unwrap();
    let phases: Vec<Phase> = recording.records.iter().map(|record| record.phase).collect();
    let stop = phases.iter().position(|&phase| phase == Phase::Stop).unwrap_or_else(|| panic!("{what}: no stop"));
    let rest = phases.iter().position(|&phase| phase == Phase::Stopped).unwrap_or_else(|| panic!("{what}: no rest"));
    assert!(stop < rest && phases[stop..rest].iter().all(|&phase| phase == Phase::Stop), "{what}");
    assert!(fastest(&recording.records[stop - 1]) > 0.01, "{what}: the arm did not move");
    assert!(recording.records[rest..].iter().all(|record| fastest(record) == 0.0), "{what}");
    (recording.about.reason.kind.to_string(), recording.about.reason.text)
}

fn daemon(place: &Place) -> Running {
    let daemon = place.daemon(&short(&LONG_ON_CLOCK));
    place.command("start").expect_code(0);
    in_motion(place);
    daemon
}

#[test]
fn every_ending_signal_brakes_first() {
    let place = Place::new("signals");
    for (number, name) in ending() {
        let daemon = daemon(&place);
        signal(daemon.pid(), &number.to_string());
        let done = daemon.end();
        assert_eq!(done.code, Some(0), "{name}: {}", done.output());
        let line = format!("signal {name} arrived");
        for words in [format!("{line}: the daemon brakes"), format!("the arm is being stopped: {line}")] {
            assert!(done.err.contains(&words), "no `{words}`: {}", done.output());
        }
        assert_eq!(controlled_stop(&place, &name), ("signal".into(), line));
    }
}

#[test]
fn a_second_signal_does_not_skip_the_stop() {
    let place = Place::new("signals-twice");
    let daemon = daemon(&place);
    let pid = daemon.pid();
    for name in ["HUP", "HUP", "TERM", "INT", "QUIT", "USR1", "TERM"] {
        // The last ones may find the process gone.
        let _ = Command::new("kill").arg(format!("-{name}")).arg(pid.to_string()).output();
    }
    let done = daemon.end();
    assert_eq!(done.code, Some(0), "{}", done.output());
    assert_eq!(controlled_stop(&place, "many signals").0, "signal");
}

#[test]
fn at_rest_a_signal_ends_the_daemon_without_a_recording() {
    let place = Place::new("signals-rest");
    let daemon = Running::start(place.job("daemon", &short(&LONG_ON_CLOCK)));
    wait_for("the daemon", || place.status().filter(|now| now.cycles > 100));
    signal(daemon.pid(), "HUP");
    let done = daemon.end().expect_code(0);
    assert!(done.err.contains("signal SIGHUP arrived"), "{}", done.output());
    assert!(recordings(&place).is_empty(), "{:?}", recordings(&place));
}

#[test]
fn what_does_not_ask_for_the_end_leaves_the_arm_moving() {
    let place = Place::new("signals-ignored");
    // `nohup` has a hangup ignored, and executes the program in its own process.
    let job = place.job("daemon", &short(&LONG_ON_CLOCK));
    let mut command = Command::new("nohup");
    command.current_dir(env!("CARGO_MANIFEST_DIR")).stdin(std::process::Stdio::null());
    // Without the `env` of other tests, which hands no ignored hangup on.
    let program = job.get_args().skip_while(|arg| arg.to_string_lossy().starts_with("--default-signal"));
    command.args(program);
    let daemon = Running::start(command);
    wait_for("the daemon", || place.status());
    place.command("start").expect_code(0);
    in_motion(&place);
    for name in ["PIPE", "HUP", "WINCH", "CHLD", "URG"] {
        signal(daemon.pid(), name);
    }
    std::thread::sleep(Duration::from_millis(300));
    let now = wait_for("the daemon", || place.status());
    assert_eq!((now.progress, now.stopped), (Progress::Driving, None));
    signal(daemon.pid(), "TERM");
    daemon.end().expect_code(0);
    controlled_stop(&place, "SIGTERM after the others");
}

#[test]
fn the_daemon_of_a_killed_run_brakes_and_ends() {
    let place = Place::new("signals-run");
    let run = Running::start(place.job("run", &short(&LONG_ON_CLOCK)));
    let daemon = wait_for("the daemon", || children(run.pid(), "daemon").first().copied());
    in_motion(&place);
    signal(run.pid(), "KILL");
    wait_for("the daemon's end", || (!std::path::Path::new(&format!("/proc/{daemon}")).exists()).then_some(()));
    let done = run.end();
    let words = "the process that started this daemon has ended";
    assert!(done.err.contains(&format!("the arm is being stopped: {words}")), "{}", done.output());
    assert_eq!(controlled_stop(&place, "killed run"), ("parent-ended".into(), words.into()));
    wait_for("the end of every process", || anyone_with(&place.id).is_empty().then_some(()));
}

#[test]
fn a_terminal_that_closes_stops_the_arm_once() {
    // A hangup goes to all three processes of a run.
    let place = Place::new("signals-terminal");
    let run = Running::start(place.job("run", &short(&LONG_ON_CLOCK)));
    let daemon = wait_for("the daemon", || children(run.pid(), "daemon").first().copied());
    let estimator = wait_for("the estimator", || children(run.pid(), "estimator").first().copied());
    in_motion(&place);
    signal_all(&[run.pid(), daemon, estimator], "HUP");
    let done = run.end().expect_code(1);
    assert!(
        done.err.contains("interrupted, signal SIGHUP arrived") || done.err.contains("ended during the job"),
        "{}",
        done.output()
    );
    assert_eq!(controlled_stop(&place, "closed terminal").0, "signal");
    assert!(done.out.is_empty() && !place.out().join("report.json").exists(), "{}", done.output());
    wait_for("the end of every process", || anyone_with(&place.id).is_empty().then_some(()));
}
