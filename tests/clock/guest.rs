//! An arm that another program controls: it publishes the states of a simulated Panda at the pace of the clock, plumbline listens.
//!
//! The child processes are this test binary with a role in [`ROLE`].

use plumbline::dataset::Dataset;
use plumbline_client::{Expected, Guest, Model};
use plumbline_core::{Backend, Command as ArmCommand, JointVec, Setpoint, Validity};
use plumbline_ipc::{GuestMessage, GuestPublisher, GuestStatus, Progress, RobotId};
use plumbline_rt::os;
use plumbline_sim::{Exact, Gate, Pace, SimArm};
use plumbline_testkit::job::*;
use plumbline_testkit::sim::{READY, arm, arm_with, sim};
use serde_json::Value;
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

const JOB: &str = "config/guest.toml";
const ROLE: &str = "PLUMBLINE_TEST_ROLE";
const ROBOT: &str = "PLUMBLINE_TEST_ROBOT";

fn job(place: &Place, subcommand: &str, more: &[&str]) -> Command {
    let mut command = plumbline();
    command.arg(subcommand).arg(JOB).arg("--out").arg(place.out());
    command.args((subcommand == "run").then_some("--verbose"));
    command.args(["--set", &format!("serve.id={}", place.id), "--set", "mounting=wall"]);
    more.iter().for_each(|set| {
        command.arg("--set").arg(set);
    });
    command
}

/// A motion that nobody planned and that never repeats: two tones per joint, all of them incommensurate, faded in from rest.
fn wanders(tick: u64) -> Setpoint {
    let t = tick as f64 * 1e-3;
    let fade = if t < 2.0 { (t / 2.0).powi(3) * (10.0 - 7.5 * t + 1.5 * t * t) } else { 1.0 };
    let mut desired = Setpoint { q: READY, ..Setpoint::default() };
    for j in 0..7 {
        let (slow, quick) = (1.1 + 0.21 * (j as f64).sqrt(), 2.3 + 0.37 * (1.0 + j as f64).sqrt());
        desired.q[j] += fade * (0.4 * (slow * t + j as f64).sin() + 0.22 * (quick * t).sin());
        // The fade begins in the pose.
        desired.q[j] -= 0.4 * fade * (j as f64).sin();
    }
    desired
}

/// The program of somebody else: controls its arm at 1 kHz and publishes every state.
fn control(robot: &str, running: &AtomicBool, mut seen: impl FnMut(u64, &Exact)) -> u64 {
    let mut arm = sim(&arm("sim-panda"), 5, Pace::Fast(Arc::new(Gate::unlimited())));
    let mut guest = Guest::open(robot, 7).unwrap();
    let start = os::now_ns();
    let mut tick = 0;
    while running.load(Ordering::Relaxed) {
        os::sleep_until(start + tick * 1_000_000);
        let state = arm.read().unwrap();
        let n = |values: &JointVec| -> [f64; 7] { std::array::from_fn(|j| values[j]) };
        // One that finds no room is counted on both sides.
        let _ = guest.publish(&n(&state.q), &n(&state.dq), &n(&state.tau), &n(&state.q_d));
        seen(tick, arm.exact());
        arm.write(&ArmCommand { seq: state.seq, desired: wanders(tick), ..ArmCommand::default() }).unwrap();
        tick += 1;
    }
    guest.lost()
}

/// The same on a thread of this process, and exact states of its arm, ten per second.
struct Controller {
    running: Arc<AtomicBool>,
    exact: Arc<Mutex<Vec<Exact>>>,
    thread: JoinHandle<u64>,
}

impl Controller {
    fn start(robot: &str) -> Controller {
        let (running, exact) = (Arc::new(AtomicBool::new(true)), Arc::new(Mutex::new(Vec::new())));
        let (flag, states, robot) = (Arc::clone(&running), Arc::clone(&exact), robot.to_string());
        let keep = move |tick: u64, state: &Exact| {
            if tick.is_multiple_of(100) {
                states.lock().unwrap().push(*state);
            }
        };
        let thread = std::thread::spawn(move || control(&robot, &flag, keep));
        Controller { running, exact, thread }
    }

    /// Ends it; the states that it could not send.
    fn stop(self) -> u64 {
        self.running.store(false, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

/// Entry point of the child processes; does nothing without a role.
#[test]
fn child() {
    if std::env::var(ROLE).is_ok_and(|role| role == "guest") {
        control(&std::env::var(ROBOT).unwrap(), &AtomicBool::new(true), |_, _| ());
    }
}

/// A process that controls the arm for ever.
fn controller(place: &Place) -> Running {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command.args(["--exact", "guest::child", "--nocapture"]).env(ROLE, "guest").env(ROBOT, &place.id);
    Running::start(command.stdin(Stdio::null()))
}

fn guest(place: &Place) -> Option<GuestStatus> {
    place.status().and_then(|status| status.guest)
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn the_arm_of_another_controller_is_identified_diagnosed_and_served() {
    let place = Place::new("guest");
    let times = ["backend.guest.identify=40 s", "backend.guest.validate=10 s", "backend.guest.run=10 s"];
    let controller = Controller::start(&place.id);
    let run = Running::start(job(&place, "run", &times));

    // The controller's own process has the model as soon as it is identified, while the validation is still recorded.
    wait_for("the daemon", || place.status());
    let expected = Expected { robot: Some("panda".into()), gravity: Some([9.81, 0.0, 0.0]) };
    let mut model = Model::follow(&place.id, expected, TIMEOUT).unwrap();
    wait_for("the model", || model.status().validity == Validity::Valid);
    let states = controller.exact.lock().unwrap().clone();
    let errors = errors(&mut model, &states);
    let done = run.end().expect_code(0);
    let unsent = controller.stop();

    let noise = torque_noise(&arm("sim-panda"));
    let report = place.report();
    let ratios: Vec<f64> = report.validate.iter().map(|run| mean(&run.rms_raw) / mean(&noise)).collect();
    eprintln!("torque of the followed model against the truth [Nm]: {errors:.4?}; noise {noise:.4?}");
    eprintln!("validation: {ratios:.3?} of the noise; {:?}", report.guest);
    eprintln!("{}", done.out);
    assert!(
        states.len() > 300 && errors.iter().zip(&noise).all(|(error, noise)| *error < 0.2 * noise),
        "{errors:?} {noise:?}"
    );
    assert!(!ratios.is_empty() && ratios.iter().all(|ratio| (0.9..1.05).contains(ratio)), "{ratios:?}");

    let counts = report.guest.unwrap();
    assert_eq!((counts.publishers, counts.doubled, counts.out_of_order, counts.not_finite), (1, 0, 0, 0));
    assert!(counts.received > 40_000 && report.control_loop.is_none(), "{counts:?}, {unsent} unsent");
    assert_eq!(report.ipc.unwrap().counters.missed, 0);
    assert_eq!((report.base.kind.as_str(), report.base.count), ("GBS", 59));
    assert!(report.identifiability.not_identifiable.is_empty());
    assert!(report.diagnosis.is_some());
    for words in ["listened to 1 publisher, commanded nothing", "the motion was not planned; it determines 59 of 59"] {
        assert!(done.out.contains(words), "no `{words}`: {}", done.output());
    }
    let dataset = Dataset::read(&place.out().join("dataset")).unwrap();
    assert!(dataset.runs.iter().all(|run| run.data.period.is_none() && run.extra("q_d7").is_some()));
    let samples: usize = dataset.runs.iter().map(|run| run.samples()).sum();
    assert!(samples > 40_000, "{samples}");
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn a_publisher_that_is_absent_killed_or_started_again_loses_nothing() {
    let place = Place::new("guest-killed");
    let times = ["backend.guest.identify=60 s", "backend.guest.validate=20 s", "backend.guest.run=20 s"];
    let run = Running::start(job(&place, "run", &times));
    let nobody = |status: &GuestStatus| status.problem.as_ref().is_some_and(|why| why.contains("nobody publishes"));
    let absent = wait_for("the word that nobody publishes", || guest(&place).filter(nobody));
    assert!(absent.problem.unwrap().contains("Guest::publish") && absent.counts.received == 0);

    let received = |least: u64| {
        wait_for("states", || guest(&place).filter(|of| of.counts.received > least && of.problem.is_none()))
            .counts
            .received
    };
    let first = controller(&place);
    received(9000);
    // A second publisher is refused; the first goes on.
    let second = Guest::open(&place.id, 7).err().unwrap();
    assert_eq!(second.to_string(), plumbline_client::Error::SecondPublisher { robot: place.id.clone() }.to_string());
    signal(first.pid(), "KILL");
    drop(first);
    let killed = wait_for("the loss", || guest(&place).filter(nobody)).counts;
    assert_eq!(place.status().unwrap().progress, Progress::Driving, "the recording waits");

    let next = controller(&place);
    received(killed.received + 9000);
    place.command("stop").expect_code(0);
    let done = run.end().expect_code(0);
    drop(next);

    let report = place.report();
    let counts = report.guest.unwrap();
    assert_eq!(counts.publishers, 2);
    let dataset = Dataset::read(&place.out().join("dataset")).unwrap();
    let samples: usize = dataset.runs.iter().map(|run| run.samples()).sum();
    // What is not in it is in parts of less than two seconds.
    let parts = counts.publishers + counts.pauses + 2;
    assert!(samples as u64 + 2000 * parts > 18_000, "{samples} samples, {counts:?}");
    let names: Vec<&str> = dataset.runs.iter().map(|run| run.data.name.as_str()).collect();
    assert!(names.iter().any(|name| name.contains("-part-")), "{names:?}");
    assert!(report.validate.is_empty(), "{names:?}");
    for words in ["nobody publishes the states of robot", "the recording ends; the arm itself is not stopped"] {
        assert!(done.err.contains(words), "no `{words}`: {}", done.output());
    }
}

#[test]
fn states_that_are_no_use_are_counted_by_name() {
    let place = Place::new("guest-bad");
    let daemon = Running::start(job(&place, "daemon", &[]));
    wait_for("the daemon", || place.status());
    let robot = RobotId::parse("test", "robot", &place.id).unwrap();
    let mut publisher = GuestPublisher::open(&robot).unwrap();
    let state = |seq: u64| GuestMessage { n: 7, seq, stamp_ns: seq * 1_000_000, ..GuestMessage::default() };
    let mut send = |samples: Vec<GuestMessage>| publisher.send(&samples).unwrap();
    send((0..100).map(state).collect());
    send(vec![state(99), state(40), GuestMessage { tau: [f64::NAN; 8], ..state(100) }, state(101)]);
    // Three are missing, then one is late and one is paused for.
    send(vec![state(105), GuestMessage { stamp_ns: 106_800_000, ..state(106) }, state(107)]);
    send((0..50).map(|k| GuestMessage { stamp_ns: 300_000_000 + k * 1_000_000, ..state(108 + k) }).collect());
    let counts = wait_for("the states", || guest(&place).map(|of| of.counts).filter(|of| of.received == 154));
    assert_eq!((counts.publishers, counts.lost, counts.doubled, counts.out_of_order), (1, 3, 1, 1), "{counts:?}");
    assert_eq!((counts.not_finite, counts.late, counts.pauses), (1, 2, 1), "{counts:?}");

    send((0..10).map(|k| GuestMessage { n: 6, ..state(158 + k) }).collect());
    let other = wait_for("the other arm", || guest(&place).filter(|of| of.counts.other_joints == 10));
    assert!(other.problem.unwrap().contains("have 6 joints, the robot has 7"));
    // 500 Hz, which goes on: after a second without states the problem would be another.
    let mut sent = 0;
    wait_for("the other rate", || {
        let states = sent..sent + 1500;
        sent = states.end;
        send(states.map(|k| GuestMessage { stamp_ns: 500_000_000 + 2 * k * 1_000_000, ..state(168 + k) }).collect());
        let slow = guest(&place).filter(|of| of.counts.other_rate > 0)?;
        slow.problem.filter(|why| why.contains("every 2000 us"))
    });

    let status = place.status().unwrap();
    assert_eq!((status.lost, status.progress), (3, Progress::Idle));
    place.quit(daemon);
}

#[test]
fn a_job_that_would_drive_the_arm_is_refused_by_its_key() {
    let place = Place::new("guest-keys");
    for (set, key, expected) in [
        ("backend.arm=sim-panda", "backend.arm", "none, for kind"),
        ("backend.guest.identify=2 s", "backend.guest.identify", "5 s to"),
        ("backend.guest.run=2 s", "backend.guest.run", "5 s to"),
        ("backend.guest.rate=2 kHz", "backend.guest.rate", "100 Hz to 1000 Hz"),
        ("diagnosis.rounds=1", "diagnosis.rounds", "plumbline next"),
        ("live.motion=10 s", "live.motion", "0 s"),
        ("backend.guest.identfy=20 s", "backend.guest.identfy", "identify"),
    ] {
        let done = Done::of(job(&place, "run", &[set])).expect_code(2);
        assert!([key, expected].iter().all(|words| done.err.contains(words)), "{set}: {}", done.err);
    }
    let sim = Done::of(place.job("run", &["backend.guest.run=20 s"])).expect_code(2);
    assert!(sim.err.contains("backend.guest"), "{}", sim.err);
}

/// A controller in simulated time: publishes as fast as the daemon receives, with stamps of the arm's own time.
struct Simulated {
    arm: SimArm,
    publisher: GuestPublisher,
    /// Milliseconds between two states.
    period: u64,
    tick: u64,
    sent: u64,
}

impl Simulated {
    /// Moves the arm until `end` \[s\] and publishes its states; exact ones, ten per second.
    fn until(&mut self, end: f64, place: &Place) -> Vec<Exact> {
        let mut exact = Vec::new();
        let mut batch = Vec::new();
        let last = (1000.0 * end) as u64;
        while self.tick < last {
            let state = self.arm.read().unwrap();
            if self.tick.is_multiple_of(self.period) {
                let (seq, stamp_ns) = (self.sent, self.tick * 1_000_000);
                let (q, dq, tau, q_d) = (state.q, state.dq, state.tau, state.q_d);
                batch.push(GuestMessage { n: 7, seq, stamp_ns, q, dq, tau, q_d, ..GuestMessage::default() });
                self.sent += 1;
            }
            if self.tick.is_multiple_of(100) {
                exact.push(*self.arm.exact());
            }
            self.arm
                .write(&ArmCommand { seq: state.seq, desired: wanders(self.tick), ..ArmCommand::default() })
                .unwrap();
            self.tick += 1;
            if batch.len() == 2000 || self.tick == last {
                self.publisher.send(&batch).unwrap();
                batch.clear();
                wait_for("the states", || guest(place).filter(|of| of.counts.received == self.sent));
            }
        }
        exact
    }
}

/// RMS of the followed model's torque less the true one, per joint \[Nm\].
fn errors(model: &mut Model, states: &[Exact]) -> [f64; 7] {
    let mut square = [0.0; 7];
    for exact in states {
        let mut tau = [0.0; 7];
        model.torque(&exact.q[..7], &exact.dq[..7], &exact.ddq[..7], None, &mut tau).unwrap();
        (0..7).for_each(|j| square[j] += (tau[j] - exact.tau[j]).powi(2));
    }
    square.map(|square: f64| (square / states.len() as f64).sqrt())
}

/// Moment at which the arm of [`watched_at_500_hz`] picks up 0.73 kg \[s\].
const PICKED_UP: f64 = 62.0;

/// Daemon and estimator that listen to an arm at 500 Hz, which is identified from its first 40 s and watched after 50 s.
fn watched_at_500_hz(name: &str) -> (Place, Running, Running, Simulated) {
    let place = Place::new(name);
    let sets = [
        "backend.guest.rate=500 Hz",
        "backend.guest.identify=40 s",
        "backend.guest.validate=10 s",
        "backend.guest.run=10 s",
        "diagnosis.enabled=false",
        "live.watch=true",
        "live.adopt=auto",
    ];
    let daemon = Running::start(job(&place, "daemon", &sets));
    wait_for("the daemon", || place.status());
    let estimator = Running::start(job(&place, "estimator", &sets));
    wait_for("the estimator", || place.status().filter(|now| !now.served.followers.is_empty()));
    place.command("start").expect_code(0);

    let payload = format!(
        "\n[[effect]]\nid = \"payload\"\nmass = 0.73\ncom = [0.0, 0.0, 0.15]\n\
         inertia = [0.001, 0.0, 0.0, 0.0025, 0.0, 0.0017]\nfrom = {PICKED_UP}\n"
    );
    let controller = Simulated {
        arm: sim(&arm_with("sim-panda", &payload), 5, Pace::Fast(Arc::new(Gate::unlimited()))),
        publisher: GuestPublisher::open(&RobotId::parse("test", "robot", &place.id).unwrap()).unwrap(),
        period: 2,
        tick: 0,
        sent: 0,
    };
    (place, daemon, estimator, controller)
}

/// Log of the watch, once its last stretch ends later than this \[s\].
fn log_beyond(end: f64, place: &Place) -> Value {
    wait_for("the end of the log", || {
        let log: Value = serde_json::from_str(&std::fs::read_to_string(place.out().join("live.json")).ok()?).ok()?;
        let last = log["stretches"].as_array()?.last()?.get("end")?.as_f64()?;
        (last > end).then_some(log)
    })
}

#[test]
fn the_payload_of_an_arm_at_500_hz_is_named_and_served_while_plumbline_listens() {
    let (place, daemon, estimator, mut controller) = watched_at_500_hz("guest-live");
    let states = controller.until(51.0, &place);
    let first = wait_for("the model", || place.status().map(|now| now.model).filter(|model| *model != 0));
    let expected = Expected { robot: Some("panda".into()), gravity: Some([9.81, 0.0, 0.0]) };
    let mut model = Model::follow(&place.id, expected, TIMEOUT).unwrap();
    wait_for("the followed model", || model.status().validity == Validity::Valid);
    let (identified, noise) = (errors(&mut model, &states), torque_noise(&arm("sim-panda")));
    wait_for("the report", || place.out().join("report.json").is_file());

    controller.until(PICKED_UP, &place);
    assert_eq!(place.status().unwrap().doubt, None, "before the payload");
    // Before anything can be named: the estimator may be as fast as the states come.
    let states = controller.until(PICKED_UP + 2.0, &place);
    let without = errors(&mut model, &states);
    let states = controller.until(PICKED_UP + 20.0, &place);
    let second = wait_for("another model", || place.status().map(|now| now.model).filter(|model| *model != first));
    wait_for("the followed one", || model.status().model == second);
    let with = errors(&mut model, &states);
    let states = controller.until(PICKED_UP + 30.0, &place);
    // What the estimator has not read yet goes with the daemon.
    wait_for("the estimator", || {
        place.status().is_some_and(|now| now.served.followers.iter().all(|of| of.acknowledged == now.served.published))
    });
    place.quit(daemon);
    let log = log_beyond(PICKED_UP + 28.0, &place);
    signal(estimator.pid(), "TERM");

    let counts = place.report().guest.unwrap();
    assert_eq!((counts.lost, counts.late, counts.pauses, counts.other_rate), (0, 0, 0, 0), "{counts:?}");
    let dataset = Dataset::read(&place.out().join("dataset")).unwrap();
    let run = &dataset.runs[0];
    assert_eq!((dataset.runs.len(), run.samples(), run.data.t[1]), (5, 5000, 0.002));
    let ratios: Vec<f64> = place.report().validate.iter().map(|run| mean(&run.rms_raw) / mean(&noise)).collect();
    let events = |kind: &str| {
        let all = log["events"].as_array().unwrap().iter();
        all.filter(|event| event["event"] == kind).cloned().collect::<Vec<Value>>()
    };
    eprintln!("followed torque against the truth [Nm]: {identified:.4?}, with the payload {without:.4?} -> {with:.4?}");
    eprintln!("validation: {ratios:.3?} of the noise; {:?}", events("lost"));
    assert!(ratios.len() == 1 && (0.9..1.05).contains(&ratios[0]), "{ratios:?}");
    let good = |errors: &[f64; 7]| errors.iter().zip(&noise).all(|(error, noise)| *error < 0.2 * noise);
    assert!(good(&identified) && !good(&without), "{identified:.4?} {without:.4?}");
    let last = errors(&mut model, &states);
    assert!(good(&last), "{last:.4?}");

    let lost = events("lost");
    let since = lost[0]["since"].as_f64().unwrap();
    assert!(lost.len() == 1 && (since - PICKED_UP).abs() < 0.5, "{lost:?}");
    let proposed = events("proposed");
    assert!(!proposed.is_empty(), "{log}");
    for event in &proposed {
        let effects = event["effects"].as_array().unwrap();
        assert_eq!(effects.iter().map(|effect| &effect["id"]).collect::<Vec<_>>(), ["payload"]);
        let mass = effects[0]["parameters"]["mass"].as_f64().unwrap();
        assert!((mass / 0.73 - 1.0).abs() < 0.01, "{mass} kg");
    }
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn what_an_estimator_has_received_is_evaluated_though_the_daemon_has_ended() {
    let (place, daemon, mut estimator, mut controller) = watched_at_500_hz("guest-ended");
    controller.until(51.0, &place);
    wait_for("the model", || place.status().is_some_and(|now| now.model != 0));
    wait_for("the report", || place.out().join("report.json").is_file());
    signal(estimator.pid(), "STOP");
    controller.until(PICKED_UP + 4.0, &place);
    place.quit(daemon);
    signal(estimator.pid(), "CONT");
    let log = log_beyond(PICKED_UP + 2.0, &place);
    assert!(log["events"].as_array().unwrap().iter().any(|event| event["event"] == "lost"), "{log}");
    assert!(estimator.runs(), "an estimator waits for the next daemon");
    signal(estimator.pid(), "TERM");
}
