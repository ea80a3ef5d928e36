//! `plumbline run` drives the arm of the daemon that it has started, and no other.

use plumbline_ipc::{Progress, runtime_dir};
use plumbline_testkit::job::*;
use std::path::PathBuf;
use std::process::Command;

fn lock(of: &Place) -> PathBuf {
    runtime_dir::directory().unwrap().join(format!("{}.lock", of.id))
}

fn holder(of: &Place) -> Option<String> {
    Some(std::fs::read_to_string(lock(of)).ok()?.lines().next()?.to_string())
}

/// A run that plans, and has the robot's lock.
fn planning(place: &Place, search: &[&str]) -> Running {
    let run = Running::start(place.job("run", &short(search)));
    wait_for("the lock", || (holder(place)? == format!("process {}", run.pid())).then_some(()));
    run
}

fn other_daemon(place: &Place) -> Command {
    let mut command = plumbline();
    command.arg("daemon").arg(WALL).arg("--out").arg(place.path().join("other"));
    command.arg("--set").arg(format!("serve.id={}", place.id));
    PLAIN.iter().chain(&SHORT).for_each(|set| {
        command.arg("--set").arg(set);
    });
    command
}

#[test]
fn no_daemon_starts_during_the_planning_of_a_run() {
    let place = Place::new("run-lock");
    let run = planning(&place, &["excitation.starts=16", "excitation.rounds=400"]);
    let refused = Done::of(other_daemon(&place));
    assert_ne!(refused.code, Some(0), "{}", refused.output());
    assert!(refused.err.contains(&format!("another daemon (process {})", run.pid())), "{}", refused.output());
    // There is nothing to stop yet, and the run is not hurt by an attempt.
    let stop = place.command("stop").expect_code(1);
    assert!(stop.err.contains("serves no robot yet"), "{}", stop.output());
    signal(run.pid(), "KILL");
    run.end();
    // The lock goes with its process.
    let daemon = Running::start(other_daemon(&place));
    wait_for("the daemon", || place.status());
    place.quit(daemon);
}

#[test]
fn a_run_s_daemon_has_the_run_s_lock() {
    let place = Place::new("run-heir");
    let run = Running::start(place.job("run", &short(&["excitation.periods=500"])));
    let daemon = wait_for("the daemon", || children(run.pid(), "daemon").first().copied());
    wait_for("its lock", || (holder(&place)? == format!("process {daemon}")).then_some(()));
    wait_for("the loop", || place.status().filter(|now| now.cycles > 0));
    let refused = Done::of(other_daemon(&place));
    assert!(refused.err.contains(&format!("another daemon (process {daemon})")), "{}", refused.output());
    // The run has taken the lock, and its daemon holds it: the daemon is the one that a signal goes to.
    std::fs::remove_file(lock(&place).with_extension("stop")).unwrap();
    let stopped = place.command("stop").expect_code(0);
    assert!(
        stopped.out.contains(&format!("(process {daemon}) has received the stop by signal SIGUSR2")),
        "{stopped:?}"
    );
    let done = run.end().expect_code(1);
    assert!(done.err.contains("the arm was stopped"), "{}", done.output());
    wait_for("the end of every process", || anyone_with(&place.id).is_empty().then_some(()));
}

#[test]
fn a_run_sends_no_request_to_another_daemon() {
    let place = Place::new("run-other");
    let run = planning(&place, &["excitation.starts=4", "excitation.rounds=2"]);
    signal(run.pid(), "STOP");
    // As a cleaner of temporary files would: the next daemon makes and locks another file of that name.
    std::fs::remove_file(lock(&place)).unwrap();
    let other = Running::start(other_daemon(&place));
    let before = wait_for("the other daemon", || place.status());
    assert_eq!(before.process, other.pid());
    signal(run.pid(), "CONT");
    let done = run.end().expect_code(1);
    assert!(done.err.contains("the daemon did not start") || done.err.contains("another daemon"), "{}", done.output());
    let after = wait_for("the other daemon", || place.status());
    assert_eq!((after.process, after.progress, after.cycles, after.motion), (other.pid(), Progress::Idle, 0, 0));
    place.command("quit").expect_code(0);
    let done = other.end().expect_code(0);
    assert!(!done.err.contains("is mounted"), "{}", done.output());
}
