//! A whole job under torque control on a wall: the robot's own controller compensates the gravity of an upright arm, so a model that was checked at
//! rest holds the arm from the first cycle on.

use plumbline_franka::wire::{Protocol, RobotMode};
use plumbline_model::Mounting;
use plumbline_testkit::emulator::{Emulator, Settings, address};
use plumbline_testkit::job::{Done, Place, plumbline};
use std::process::Command;
use std::time::Duration;

/// A Panda on a wall, and `plumbline run` with torque commands for it.
fn scene(name: &str) -> (Emulator, Place, Command) {
    let address = address();
    // A loaded test machine stalls the daemon: the robot's time waits for its commands.
    let command_wait = Duration::from_millis(500);
    let settings = Settings { mounting: Mounting::WALL, command_wait, ..Settings::new(address, Protocol::V5) };
    let place = Place::new(name);
    let mut command = plumbline();
    command.args(["run", "--verbose", "config/panda-emulator-wall.toml", "--out"]).arg(place.out());
    for set in [
        format!("serve.id={}", place.id),
        format!("backend.franka.address={address}"),
        "backend.franka.interface=torque".into(),
        "backend.franka.state-timeout=2 s".into(),
        "safety.max-lost=19".into(),
        "excitation.period=4 s".into(),
        "excitation.periods=1".into(),
        "excitation.lead-in=0".into(),
        "excitation.starts=1".into(),
        "excitation.rounds=0".into(),
        "validation.trajectories=0".into(),
        "diagnosis.enabled=false".into(),
        "realtime.lock-memory=false".into(),
    ] {
        command.args(["--set", &set]);
    }
    (Emulator::start(settings).unwrap_or_else(|error| panic!("{error}")), place, command)
}

#[test]
fn a_torque_controlled_job_on_a_wall_is_driven_after_the_models_check() {
    let (emulator, place, mut command) = scene("torque-job");
    command.args(["--model", "config/models/panda-paper-table3.toml"]);
    let done = Done::of(command).expect_code(0);
    // A start that comes before the check waits for it; on a loaded machine it comes later.
    let position = |words: &str| done.err.find(words).unwrap_or_else(|| panic!("no `{words}`: {}", done.output()));
    let (refused, checked) = (position("is not served yet"), position("is served again"));
    assert!(position("`start` from process") > checked || done.err.contains("the start waits"), "{}", done.output());
    assert!(refused < checked && checked < position("the arm is mounted wall"), "{}", done.output());
    assert_eq!(emulator.snapshot().state.robot_mode, RobotMode::Idle, "{}", done.output());
    assert!(
        place.out().join("model.toml").is_file() && done.err.contains("everything was driven"),
        "{}",
        done.output()
    );
    // A joint that oscillates between two cycles is held at the torque rate in most of them.
    let sessions = place.report().control_loop.unwrap().sessions;
    let cycles: u64 = sessions.iter().map(|session| session.statistics.cycles).sum();
    let limited: u64 = sessions.iter().filter_map(|session| Some(session.link.as_ref()?.limited)).sum();
    assert!(cycles > 5000 && limited < cycles / 100, "the torque rate was held in {limited} of {cycles} cycles");
}

#[test]
fn a_torque_controlled_job_on_a_wall_without_a_model_is_refused() {
    let (emulator, _place, command) = scene("torque-none");
    let done = Done::of(command).expect_code(1);
    for words in ["would fall", "[0.00, 0.00, -9.81]", "no model", "or command positions"] {
        assert!(done.err.contains(words), "{words}: {}", done.output());
    }
    assert_eq!(emulator.snapshot().state.dq_d, [0.0; 7], "{}", done.output());
}
