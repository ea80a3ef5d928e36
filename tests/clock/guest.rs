//! An arm that another program controls: it publishes the states of a simulated Panda at the pace of the clock, plumbline listens.
//!
//! The child processes are this test binary with a role in [`ROLE`].

use plumbline::dataset::Dataset;
use plumbline_client::{Expected, Guest, Model};
use plumbline_core::{Backend, Command as ArmCommand, JointVec, Setpoint, Validity};
use plumbline_ipc::{GuestMessage, GuestPublisher, GuestStatus, Progress, RobotId};
use plumbline_rt::os;
use plumbline_sim::{Exact, Gate, Pace};
use plumbline_testkit::job::*;
use plumbline_testkit::sim::{READY, arm, sim};
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
    let (mut square, mut count) = ([0.0; 7], 0.0);
    for exact in controller.exact.lock().unwrap().iter() {
        let mut tau = [0.0; 7];
        model.torque(&exact.q[..7], &exact.dq[..7], &exact.ddq[..7], None, &mut tau).unwrap();
        (0..7).for_each(|j| square[j] += (tau[j] - exact.tau[j]).powi(2));
        count += 1.0;
    }
    let done = run.end().expect_code(0);
    let unsent = controller.stop();

    let noise = torque_noise(&arm("sim-panda"));
    let errors = square.map(|square: f64| (square / count).sqrt());
    let report = place.report();
    let ratios: Vec<f64> = report.validate.iter().map(|run| mean(&run.rms_raw) / mean(&noise)).collect();
    eprintln!("torque of the followed model against the truth [Nm]: {errors:.4?}; noise {noise:.4?}");
    eprintln!("validation: {ratios:.3?} of the noise; {:?}", report.guest);
    eprintln!("{}", done.out);
    assert!(
        count > 300.0 && errors.iter().zip(&noise).all(|(error, noise)| *error < 0.2 * noise),
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
    // 500 Hz.
    send((0..1500).map(|k| GuestMessage { stamp_ns: 500_000_000 + 2 * k * 1_000_000, ..state(168 + k) }).collect());
    let slow = wait_for("the other rate", || guest(&place).filter(|of| of.counts.other_rate > 0));
    assert!(slow.problem.unwrap().contains("every 2000 us"));

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
