//! Plans and the limits of the arm that is connected: whatever it serves, motions are checked and planned under it before anything moves.

use plumbline::store::load_plan;
use plumbline_excite::Plan;
use plumbline_franka::wire::{Protocol, RobotMode};
use plumbline_testkit::emulator::limits::{JOINTS, Limits};
use plumbline_testkit::emulator::{Emulator, READY, RobotKind, Settings, Snapshot, address};
use plumbline_testkit::job::{Done, Place, Running, plumbline, wait_for};
use std::net::IpAddr;
use std::process::Command;
use std::time::Duration;

/// An FR3 whose description has tighter limits than the robot file: less range and speed in every joint, and a speed that falls earlier.
fn narrow() -> Limits {
    let mut limits = Limits::of(RobotKind::Fr3, Protocol::V10);
    for j in 0..JOINTS {
        let cut = 0.1 * (limits.q_max[j] - limits.q_min[j]);
        (limits.q_min[j], limits.q_max[j]) = (limits.q_min[j] + cut, limits.q_max[j] - cut);
        limits.dq[j] *= 0.5;
    }
    if let Some(envelope) = &mut limits.envelope {
        (envelope.lower, envelope.upper) = (limits.q_min, limits.q_max);
        envelope.offset = envelope.offset.map(|offset| offset + 0.1);
        envelope.deceleration = envelope.deceleration.map(|deceleration| 0.5 * deceleration);
    }
    limits
}

/// The emulator and the job for it: one short motion to identify from, one to validate with.
struct Scene {
    place: Place,
    address: IpAddr,
    settings: Settings,
    emulator: Option<Emulator>,
}

impl Scene {
    fn new(name: &str, limits: Option<Limits>, start: [f64; JOINTS]) -> Scene {
        let address = address();
        // A loaded test machine stalls the daemon: the robot's time waits for its commands.
        let command_wait = Duration::from_millis(500);
        let settings = Settings { limits, start, command_wait, ..Settings::new(address, Protocol::V10) };
        let emulator = Emulator::start(settings.clone()).unwrap_or_else(|error| panic!("{error}"));
        Scene { place: Place::new(name), address, settings, emulator: Some(emulator) }
    }

    /// The arm at the address is replaced by one of other limits.
    fn replace(&mut self, limits: Limits) {
        self.emulator = None;
        let settings = Settings { limits: Some(limits), ..self.settings.clone() };
        self.emulator = Some(Emulator::start(settings).unwrap_or_else(|error| panic!("{error}")));
    }

    fn arm(&self) -> Snapshot {
        self.emulator.as_ref().unwrap().snapshot()
    }

    fn command(&self, verb: &str, sets: &[&str]) -> Command {
        let mut command = plumbline();
        command.args([verb, "config/fr3.toml", "--out"]).arg(self.place.out());
        command.args((verb == "run").then_some("--verbose"));
        let own = [
            format!("serve.id={}", self.place.id),
            format!("backend.franka.address={}", self.address),
            "backend.franka.state-timeout=2 s".into(),
            // Nor does a stalled estimator or a run of lost states end a job that is about limits.
            "safety.on-estimator-loss=finish".into(),
            "safety.max-lost=19".into(),
            "excitation.period=4 s".into(),
            "excitation.trajectories=1".into(),
            "excitation.periods=1".into(),
            "excitation.lead-in=0".into(),
            "excitation.starts=1".into(),
            "excitation.rounds=0".into(),
            "validation.trajectories=1".into(),
            "diagnosis.enabled=false".into(),
            "realtime.lock-memory=false".into(),
        ];
        for set in own.iter().map(String::as_str).chain(sets.iter().copied()) {
            command.args(["--set", set]);
        }
        command
    }

    fn plan(&self, name: &str) -> Plan {
        load_plan(&self.place.out().join("plans").join(format!("{name}.toml"))).unwrap()
    }

    /// Nothing was driven: the arm is where it was.
    fn assert_at_rest(&self, done: &Done) {
        let state = self.arm().state;
        assert_eq!(state.robot_mode, RobotMode::Idle, "{}", done.output());
        assert!((0..JOINTS).all(|j| (state.q_d[j] - READY[j]).abs() < 1e-6), "{:?}\n{}", state.q_d, done.output());
    }
}

#[test]
fn motions_are_planned_under_the_limits_of_the_connected_arm() {
    let scene = Scene::new("limits-run", Some(narrow()), READY);
    let done = Done::of(scene.command("run", &[])).expect_code(0);
    let narrow = narrow();
    for name in ["identify-upright", "validate-upright-1"] {
        let limits = scene.plan(name).constraints;
        for j in 0..JOINTS {
            assert!(limits.q_min[j] >= narrow.q_min[j] && limits.q_max[j] <= narrow.q_max[j], "{name}: {limits:?}");
            assert!(limits.dq[j] <= 0.99 * narrow.dq[j], "{name}: {limits:?}");
        }
    }
    assert!(done.out.contains("2 motions, each uses per joint at least [%]: range "), "{}", done.output());
}

/// A plan for the robot file's limits, as an earlier version or another arm has left it.
#[test]
fn a_plan_past_the_connected_arms_limits_is_refused_before_anything_moves() {
    let scene = Scene::new("limits-plan", Some(narrow()), READY);
    let plan = scene.place.path().join("plan.toml");
    Done::of(plumbline().args(["plan", "--robot", "fr3", "--starts", "1", "--rounds", "0", "--out"]).arg(&plan))
        .expect_code(0);
    let set = format!("excitation.plan={}", plan.display());
    for verb in ["run", "daemon"] {
        let done = Done::of(scene.command(verb, &[&set])).expect_code(2);
        assert!(done.err.contains("plan.toml: motion: got joint "), "{}", done.output());
        assert!(
            done.err.contains("a motion inside every limit of the job and of the connected arm"),
            "{}",
            done.output()
        );
        let next = "Without `excitation.plan` in config/fr3.toml, `plumbline run config/fr3.toml` plans a motion";
        assert!(done.err.contains(next), "{}", done.output());
        scene.assert_at_rest(&done);
    }
}

/// Between the daemon's start and the operator's another arm, or the same one with another description, is at the address.
#[test]
fn an_arm_with_other_limits_than_at_the_daemons_start_is_not_driven() {
    let mut scene = Scene::new("limits-other", None, READY);
    // It goes on by itself after a lost connection, and so meets the other arm.
    let daemon = Running::start(scene.command("daemon", &["backend.franka.recovery=automatic"]));
    wait_for("the daemon", || scene.place.status().filter(|now| now.cycles > 100));
    scene.replace(narrow());
    wait_for("the other arm", || {
        let connected = scene.arm().connected;
        scene.place.status().filter(|now| connected && now.sessions.len() == 1)
    });
    scene.place.command("start").expect_code(0);
    let done = daemon.end().expect_code(1);
    let words = "the connected arm has other limits than when this daemon started";
    assert!(done.err.contains(words) && done.err.contains("nothing has moved"), "{}", done.output());
    assert!(done.err.contains("`plumbline run config/fr3.toml`"), "{}", done.output());
    scene.assert_at_rest(&done);
}

/// A joint outside the limits of the job can't be driven; what helps is a hand. Watched, the arm may stand there.
#[test]
fn an_arm_that_stands_outside_the_jobs_limits_is_told_what_to_do() {
    let scene = Scene::new("limits-pose", None, READY);
    // Joint 6 stands at 90 deg.
    let q_max = "limits.override.q-max=[2.9, 1.83, 2.9, -0.12, 2.87, 1.5, 3.05]";
    let start = "backend.start=[\"0 deg\", \"-45 deg\", \"0 deg\", \"-135 deg\", \"0 deg\", \"60 deg\", \"45 deg\"]";
    let done = Done::of(scene.command("run", &[q_max, start])).expect_code(1);
    let words =
        "joint 6 stands at 1.5708 rad, outside the range of job and arm, 0.4398 to 1.5000 rad; nothing has moved";
    assert!(done.err.contains(words) && done.err.contains("by hand (guiding mode)"), "{}", done.output());
    assert!(!done.err.contains("while braking"), "{}", done.output());
    scene.assert_at_rest(&done);
}
