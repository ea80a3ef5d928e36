//! The job at wall-clock pace: every millisecond is accounted for, and clients follow the served torque while the arm moves.

use plumbline::config::job::Pace;
use plumbline_testkit::job::*;
use plumbline_testkit::peers;
use std::path::Path;

/// A few seconds of motion. How late a cycle may come is the machine's business, not this test's: no loss stops the arm.
const JOB: [&str; 10] = [
    "backend.pace=wall-clock",
    "excitation.period=2 s",
    "excitation.periods=3",
    "excitation.starts=1",
    "excitation.rounds=0",
    "validation.trajectories=2",
    "validation.mountings=[\"wall\"]",
    "output.dataset=false",
    "diagnosis.enabled=false",
    "safety.max-lost=1000",
];

/// Lines of `plumbline torque --follow`.
fn follow(place: &Place, count: usize) -> Vec<String> {
    let lines: Vec<String> = Done::of(plumbline().args([
        "torque",
        "--follow",
        "--rate",
        "50",
        "--robot",
        &place.id,
        "--count",
        &count.to_string(),
    ]))
    .expect_code(0)
    .out
    .lines()
    .map(str::to_string)
    .collect();
    assert_eq!(lines.len(), count);
    // The first line may come before the daemon has sent this client anything.
    let values: Vec<String> = lines.into_iter().filter(|line| line != "no value yet").collect();
    assert!(values.len() + 1 >= count, "{values:?}");
    values
}

fn sequence(line: &str) -> u64 {
    line.split_whitespace().next().and_then(|first| first.parse().ok()).unwrap_or_else(|| panic!("{line}"))
}

#[test]
fn every_millisecond_is_accounted_for_and_clients_follow() {
    let python = peers::interpreter();
    let place = Place::new("clock");
    let run = Running::start(place.job("run", &JOB));

    // Before there is a model every value says so.
    wait_for("motion", || place.status().filter(|status| status.cycles > 0 && status.motion > 0));
    let before = follow(&place, 6);
    assert!(before.iter().all(|line| line.contains("NO MODEL") || line.contains("STALE")), "{before:?}");
    assert!(before.windows(2).all(|pair| sequence(&pair[0]) < sequence(&pair[1])), "{before:?}");

    let model = wait_for("a model", || place.status().map(|status| status.model).filter(|&model| model != 0));
    let identity = format!("model {model:016x}");
    let values = wait_for("values of the model", || {
        let values = follow(&place, 5);
        values.iter().all(|line| line.contains(&identity)).then_some(values)
    });
    let fresh: Vec<&String> = values.iter().filter(|line| line.ends_with(" Nm")).collect();
    assert!(!fresh.is_empty(), "no value that may be used: {values:?}");
    for line in fresh {
        let torques: Vec<f64> = line
            .split("tau_ff")
            .nth(1)
            .unwrap()
            .trim_end_matches("Nm")
            .split_whitespace()
            .map(|v| v.parse().unwrap())
            .collect();
        assert_eq!(torques.len(), 7, "{line}");
        assert!(torques.iter().any(|tau| tau.abs() > 1.0) && torques.iter().all(|tau| tau.abs() < 87.0), "{line}");
    }
    if let Some(python) = python {
        let mut command = std::process::Command::new(python);
        command.arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("examples/clients/python/torque_follow.py"));
        command.args(["--robot", &place.id, "--wait", "20", "--count", "5"]);
        let done = Done::of(command).expect_code(0);
        assert_eq!(done.out.lines().filter(|line| line.contains("tau")).count(), 5, "{}", done.output());
    }

    let done = run.end().expect_code(0);
    let report = place.report();
    assert_eq!(report.base.count, 59);
    let cycle = report.control_loop.unwrap();
    assert_eq!(
        (cycle.pace, cycle.dropped_records, cycle.allocations()),
        (Pace::WallClock, 0, Some(0)),
        "{}",
        done.output()
    );
    let longest = &cycle.longest().unwrap().statistics;
    let wake = longest.wake_up.in_us().expect("wake-ups of the loop");
    assert!(wake[0] > 0.0 && wake.is_sorted(), "{wake:?}");
    assert!(longest.execution.p50_ns > 0);
    // Held until told to start, which may be at once, then driven for as long as the motions take; each of its milliseconds was either a cycle or is counted as lost.
    assert_eq!(cycle.sessions.len(), 2);
    let driven = &cycle.sessions[1].statistics;
    assert!(driven.elapsed > 10_000 && driven.wake_up.count > 0, "{driven:?}");
    for session in cycle.sessions.iter().map(|session| &session.statistics) {
        // By two clocks: the arm's counter and this machine's own.
        assert!(session.accounted(), "{session:?}");
        assert_eq!(session.clock, Some(session.elapsed).filter(|&elapsed| elapsed > 0), "{session:?}");
    }
    // Of the hold that follows, the report has what had passed when the daemon was asked.
    let in_sessions: u64 = cycle.sessions.iter().map(|session| session.statistics.cycles).sum();
    assert!((in_sessions..in_sessions + 2_000).contains(&cycle.cycles), "{in_sessions} {}", cycle.cycles);
    let ipc = report.ipc.unwrap();
    assert_eq!((ipc.counters.received, ipc.counters.missed), (ipc.sent, 0), "{ipc:?}");
    assert!(done.out.contains("loop (wall-clock): "), "{}", done.output());
    assert!(anyone_with(&place.id).is_empty(), "a process lingers");
}
