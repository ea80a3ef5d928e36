//! Processes that die in the middle of a job: the arm goes on or stops by rule, it is said, and nothing lingers.

use plumbline_testkit::turns::Turns;

use plumbline_core::Phase;
use plumbline_ipc::{Progress, RobotId, SampleStream, StreamSettings};
use plumbline_testkit::job::*;
use std::time::Duration;

/// Each job has three processes that compute as fast as they can, one of them waiting for another most of the time.
static JOBS: Turns = Turns::new(2);

/// Overrides that make the identification last some seconds of simulated time at the fast pace, and the planning none.
const LONG: [&str; 5] = [
    "excitation.periods=30",
    "excitation.starts=1",
    "excitation.rounds=0",
    "validation.mountings=[\"wall\"]",
    "backend.seed=3",
];

/// For jobs that are not meant to come to their end.
const ENDLESS: &str = "excitation.periods=500";

/// A run in its first motion, with the process ids of its daemon and its estimator.
fn in_mid_run(place: &Place, more: &[&str]) -> (Running, u32, u32) {
    let sets: Vec<&str> = SHORT.into_iter().chain(LONG).chain(more.iter().copied()).collect();
    let run = Running::start(place.job("run", &sets));
    let daemon = wait_for("the daemon", || children(run.pid(), "daemon").first().copied());
    let estimator = wait_for("the estimator", || children(run.pid(), "estimator").first().copied());
    wait_for("the motion", || (place.status()?.cycles > 5_000).then_some(()));
    (run, daemon, estimator)
}

/// Nothing that belongs to this test runs any more.
#[track_caller]
fn nobody_lingers(place: &Place) {
    wait_for("the end of every process", || anyone_with(&place.id).is_empty().then_some(()));
}

#[test]
fn a_killed_estimator_is_replaced_and_nothing_is_lost() {
    let _turn = JOBS.take();
    let place = Place::new("estimator");
    let (run, _, estimator) = in_mid_run(&place, &[]);
    signal(estimator, "KILL");
    let done = run.end().expect_code(0);

    let report = place.report();
    let ipc = report.ipc.unwrap();
    assert_eq!((ipc.counters.received, ipc.counters.missed), (ipc.sent, 0), "{ipc:?}");
    assert!(ipc.counters.replayed > 0, "a successor has to ask for what it never saw: {ipc:?}");
    assert_eq!((report.base.count, report.control_loop.unwrap().lost), (59, 0));
    // Both say so: the daemon with its rule, the job with what it did about it.
    assert!(done.err.contains(&format!("estimator (process {estimator}) died after")), "{}", done.output());
    assert!(done.err.contains("by safety.on-estimator-loss, the arm "), "{}", done.output());
    assert!(done.err.contains("and the samples are kept"), "{}", done.output());
    assert!(done.err.contains("the estimator was killed"), "{}", done.output());
    assert!(done.out.contains("none missing"), "{}", done.output());
    nobody_lingers(&place);
}

#[test]
fn a_killed_estimator_stops_the_arm_with_on_estimator_loss_stop() {
    let _turn = JOBS.take();
    let place = Place::new("stop-rule");
    let (run, _, estimator) = in_mid_run(&place, &["safety.on-estimator-loss=stop", ENDLESS]);
    signal(estimator, "KILL");
    let done = run.end().expect_code(1);
    assert!(done.err.contains("by safety.on-estimator-loss, the arm stops"), "{}", done.output());
    assert!(done.err.contains("the arm is being stopped"), "{}", done.output());
    let last = done.err.lines().rfind(|line| line.starts_with("plumbline: ")).unwrap();
    assert!(last.contains("the arm was stopped"), "{}", done.output());
    assert!(done.out.is_empty() && !place.out().join("report.json").exists(), "{}", done.output());
    nobody_lingers(&place);
}

#[test]
fn whoever_follows_and_takes_leave_in_mid_motion_is_lost_too() {
    let _turn = JOBS.take();
    let place = Place::new("leave");
    let sets = ["backend.pace=wall-clock", "safety.max-lost=1000", "safety.on-estimator-loss=stop"];
    let daemon = place.daemon(&short(&sets));
    let robot = RobotId::parse("test", "robot", &place.id).unwrap();
    let mut stream = SampleStream::connect(&robot, StreamSettings::default(), TIMEOUT).unwrap();
    place.command("start").expect_code(0);
    wait_for("motion", || {
        let _ = stream.next(Duration::from_millis(5)).unwrap();
        place.status().filter(|now| now.progress == Progress::Driving && now.phase == Phase::Excite)
    });
    // As an estimator whose disk is full does: it ends with an error, and says goodbye.
    drop(stream);
    wait_for("the stop", || place.status().filter(|now| now.progress == Progress::Stopped));
    let done = place.quit(daemon);
    assert!(done.err.contains("by safety.on-estimator-loss, the arm stops"), "{}", done.output());
    nobody_lingers(&place);
}

#[test]
fn an_estimator_service_waits_after_unusable_data() {
    let _turn = JOBS.take();
    let place = Place::new("unusable");
    // One second, for a filter that needs eight.
    let sets =
        ["excitation.period=1 s", "excitation.periods=1", "excitation.lead-in=0", "estimator.torque-cutoff=0.1 Hz"];
    let daemon = place.daemon(&short(&sets));
    let mut estimator = Running::start(place.job("estimator", &short(&sets)));
    place.command("start").expect_code(0);
    wait_for("the wait for a model", || place.status().filter(|now| now.progress == Progress::AwaitingModel));
    std::thread::sleep(Duration::from_secs(2));
    assert!(estimator.runs(), "{}", estimator.end().output());
    signal(estimator.pid(), "TERM");
    let done = estimator.end();
    assert!(done.err.contains("no results: ") && done.err.contains("expected at least"), "{}", done.output());
    place.quit(daemon);
    nobody_lingers(&place);
}

#[test]
fn a_killed_daemon_ends_the_run_and_the_next_one_is_clean() {
    let _turn = JOBS.take();
    let place = Place::new("daemon");
    let (run, daemon, _) = in_mid_run(&place, &[ENDLESS]);
    signal(daemon, "KILL");
    let done = run.end().expect_code(1);
    assert!(
        done.err.contains("the daemon ended during the job") && done.err.contains("signal: 9"),
        "{}",
        done.output()
    );
    assert!(done.out.is_empty() && !place.out().join("report.json").exists(), "{}", done.output());
    nobody_lingers(&place);

    place.run(&short(&[])).expect_code(0);
    let ipc = place.report().ipc.unwrap();
    assert_eq!((ipc.counters.received, ipc.counters.missed), (ipc.sent, 0), "{ipc:?}");
    nobody_lingers(&place);
}

#[test]
fn an_interrupt_ends_everything() {
    let _turn = JOBS.take();
    for name in ["INT", "TERM"] {
        let place = Place::new(&format!("sig-{}", name.to_lowercase()));
        let (run, ..) = in_mid_run(&place, &[ENDLESS]);
        signal(run.pid(), name);
        let done = run.end().expect_code(1);
        assert!(done.err.contains("interrupted"), "{}", done.output());
        assert!(done.out.is_empty() && !place.out().join("report.json").exists(), "{}", done.output());
        nobody_lingers(&place);
    }
}

#[test]
fn a_daemon_accepts_valid_requests_and_refuses_others() {
    let _turn = JOBS.take();
    let place = Place::new("orders");
    let daemon = Running::start(place.job("daemon", &short(&[])));
    let idle = wait_for("the daemon", || place.status());
    assert_eq!((idle.robot.as_str(), idle.joints, idle.cycles, idle.model), ("panda", 7, 0, 0));

    // A stop stands, also where nothing moves.
    let stopped = place.command("stop").expect_code(0);
    assert!(
        stopped.out.contains(&format!("the daemon (process {}) has received the stop", daemon.pid())),
        "{stopped:?}"
    );
    let refused = place.command("start").expect_code(1);
    assert!(refused.err.contains("plumbline command resume"), "{}", refused.output());
    place.command("resume").expect_code(0);
    let refused = place.command("resume").expect_code(1);
    assert!(refused.err.contains("nothing waits"), "{}", refused.output());
    assert_eq!(place.command("start").expect_code(0).out, "accepted\n");
    wait_for("motion", || (place.status()?.cycles > 0).then_some(()));
    let again = place.command("start").expect_code(1);
    assert!(again.err.contains("started before"), "{}", again.output());
    place.quit(daemon);
    nobody_lingers(&place);

    let gone = place.command("status").expect_code(1);
    assert!(gone.err.contains(&place.id), "{}", gone.output());
}
