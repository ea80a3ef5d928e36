//! The first hour with an arm, on the emulator: each step passes where all is well, and fails or refuses for the reason that there is.
#![allow(dead_code)] // the emulator and the rig are whole programs

use clap::Parser;
use plumbline_franka::wire::Protocol;
use plumbline_model::Mounting;
use plumbline_testkit::emulator::{Emulator, Settings as Emulated, address};
use plumbline_testkit::job::program;
use plumbline_testkit::rig::verdict::Verdict;
use plumbline_testkit::rig::{Cli, Given, Rig, Step, communication, excitation, gravity};
use std::time::Duration;

/// A Panda on a wall, and the words that begin a step with it.
struct Scene {
    _emulator: Emulator,
    arguments: Vec<String>,
    folder: tempfile::TempDir,
}

fn scene() -> Scene {
    let address = address();
    // A test machine stalls now and then: this robot's time waits for it.
    let emulated = Emulated {
        mounting: Mounting::WALL,
        command_wait: Duration::from_millis(20),
        ..Emulated::new(address, Protocol::V5)
    };
    let folder = tempfile::tempdir().unwrap();
    let config = concat!(env!("CARGO_MANIFEST_DIR"), "/config/panda-emulator-wall.toml");
    let sets = [
        format!("backend.franka.address={address}"),
        format!("output.dir={}", folder.path().join("out").display()),
        "backend.franka.state-timeout=1 s".to_string(),
    ];
    let mut arguments = vec![config.to_string()];
    sets.iter().for_each(|set| arguments.extend(["--set".into(), set.clone()]));
    Scene { _emulator: Emulator::start(emulated).unwrap(), arguments, folder }
}

impl Scene {
    fn step(&self, name: &str, more: &[&str]) -> Step {
        let words =
            ["rig", name].into_iter().chain(self.arguments.iter().map(String::as_str)).chain(more.iter().copied());
        Cli::try_parse_from(words).unwrap_or_else(|error| panic!("{error}")).step
    }

    fn load(&self, given: &Given) -> Rig {
        let program = program();
        Rig { program, ..given.load().unwrap_or_else(|error| panic!("{error}")) }
    }
}

const THERE: &str = "--i-am-at-the-robot";

fn passed(verdict: &Verdict) -> bool {
    println!("{verdict}");
    matches!(verdict, Verdict::Pass(_))
}

#[test]
fn no_step_begins_where_nobody_is_at_the_robot() {
    let scene = scene();
    for name in ["communication", "gravity", "slow", "full"] {
        let given = match scene.step(name, &[]) {
            Step::Communication(options) => options.given,
            Step::Gravity(options) => options.given,
            Step::Slow(given) | Step::Full(given) => given,
        };
        let error = given.load().err().expect(name).to_string();
        assert!(error.contains("stop button") && error.contains(THERE), "{name}: {error}");
    }
}

#[test]
fn communication_holds_the_arm_and_gives_a_verdict() {
    let scene = scene();
    let Step::Communication(options) = scene.step("communication", &[THERE, "--watch", "1", "--hold", "3"]) else {
        unreachable!()
    };
    let verdict = communication::run(&scene.load(&options.given), &options).unwrap();
    // A machine without a real-time kernel may miss the verdict's own marks; then it says by what.
    match &verdict {
        Verdict::Pass(words) => assert!(words.contains("came in time"), "{words}"),
        Verdict::Fail(reasons) => assert!(
            reasons.iter().all(|reason| reason.contains("passed over") || reason.contains("in time")),
            "{verdict}"
        ),
    }
}

#[test]
fn gravity_agrees_with_the_true_mounting_and_contradicts_another() {
    let scene = scene();
    let Step::Gravity(options) = scene.step("gravity", &[THERE]) else { unreachable!() };
    assert!(passed(&gravity::run(&scene.load(&options.given), &options).unwrap()));
    let upright = ["--set", "mounting=upright", "--set", "validation.mountings=[\"upright\"]"];
    let Step::Gravity(options) = scene.step("gravity", &[&[THERE], &upright[..]].concat()) else { unreachable!() };
    let verdict = gravity::run(&scene.load(&options.given), &options).unwrap();
    assert!(!passed(&verdict) && verdict.to_string().contains("off the declared mounting"), "{verdict}");
}

#[test]
fn the_slow_step_drives_a_small_excitation_to_its_end() {
    let scene = scene();
    // Less than half the usual length: two periods of 4 s of a coarse search.
    let sets = ["excitation.period=4 s", "excitation.starts=1", "excitation.rounds=0", "realtime.lock-memory=false"];
    let more: Vec<&str> = [THERE].into_iter().chain(sets.into_iter().flat_map(|set| ["--set", set])).collect();
    let Step::Slow(given) = scene.step("slow", &more) else { unreachable!() };
    let verdict = excitation::slow(&scene.load(&given), &given).unwrap();
    assert!(passed(&verdict), "{verdict}");
    let out = scene.folder.path().join("out/rig-slow");
    assert!(out.join("report.html").is_file() && out.join("model.toml").is_file());
}
