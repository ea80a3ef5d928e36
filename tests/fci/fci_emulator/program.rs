//! The program around the emulator: its options, and its lines on standard input.

use super::emulator::{Fault, Kind, RobotKind, Settings, StartError};
use super::{address, session};
use clap::Parser;
use plumbline_franka::wire::{Protocol, RobotMode};
use plumbline_testkit::emulator::control::{Outcome, carry_out};
use plumbline_testkit::emulator::options::{Options, settings};
use std::time::Duration;

fn parsed(arguments: &[&str]) -> Result<Settings, String> {
    let options = Options::try_parse_from([&["fci-emulator"], arguments].concat());
    options.map_err(|error| error.to_string()).and_then(|options| settings(options).map_err(|error| error.to_string()))
}

#[test]
fn options_become_settings() {
    let plain = parsed(&[]).expect("defaults");
    assert_eq!((plain.protocol, plain.robot, plain.port), (Protocol::V10, RobotKind::Fr3, 1337));
    assert_eq!(plain.address.to_string(), "127.0.0.7");
    assert_eq!((plain.command_wait, plain.base_acceleration[2]), (Duration::ZERO, -9.81));
    let rich = parsed(&[
        "--protocol=5",
        "--mounting=0.1,0.2",
        "--start=0.1,-0.4,0,-2,0.3,1.8,0.5",
        "--base-acceleration=mounting",
        "--fault=loss=0.1,at=motion,for=2",
        "--fault=tcp-reset,at=5",
        "--command-wait=20",
    ])
    .expect("options");
    assert_eq!((rich.robot, rich.start[3], rich.mounting.phi), (RobotKind::Panda, -2.0, 0.2));
    assert_eq!(rich.base_acceleration, <[f64; 3]>::from(rich.mounting.gravity()));
    // The gravity that the arm compensates shows in its states, and is upright in any mounting unless told otherwise.
    let upright = [0.0, 0.0, -9.81];
    let wall = parsed(&["--mounting=wall"]).expect("options");
    assert_eq!((wall.compensates, wall.base_acceleration), (upright, upright));
    let compensated = parsed(&["--mounting=wall", "--compensates=true"]).expect("options");
    assert_eq!(
        (compensated.compensates, compensated.base_acceleration),
        ([compensated.mounting.gravity().into(); 2]).into()
    );
    assert_eq!(rich.compensates, upright);
    assert_eq!((rich.faults[0].kind, rich.faults[1].kind), (Kind::Loss(0.1), Kind::TcpReset));
    assert_eq!(rich.command_wait, Duration::from_millis(20));
    for wrong in [
        "--protocol=7",
        "--robot=ur10",
        "--mounting=floor",
        "--compensates=wall",
        "--start=1,2",
        "--start=0,0,0,0,0,0,NaN",
        "--fault=thunder",
        "--arm=/nowhere.toml",
        "--model-library=/nowhere.so",
    ] {
        assert!(parsed(&[wrong]).is_err(), "{wrong}");
    }
}

#[test]
fn an_emulator_that_can_not_start_says_why() {
    let mut outside = Settings::new(address(), Protocol::V10);
    outside.start[3] = 0.0;
    let start = |settings| super::emulator::Emulator::start(settings).err().expect("no start");
    assert!(matches!(start(outside), StartError::Pose { joint: 4, .. }));
    let settings = Settings::new(address(), Protocol::V10);
    let _first = super::emulator::Emulator::start(settings.clone()).expect("an emulator");
    assert!(matches!(start(settings), StartError::Address { port: 1337, .. }));
    let log = Some("/nowhere/log.csv".into());
    assert!(matches!(start(Settings { log, ..Settings::new(address(), Protocol::V10) }), StartError::Log { .. }));
}

#[test]
fn lines_are_carried_out() {
    let (emulator, mut client) = session(Settings::new(address(), Protocol::V10));
    for (line, mode) in [
        ("user-stop", RobotMode::UserStopped),
        ("release", RobotMode::Idle),
        ("lock", RobotMode::Other),
        ("unlock", RobotMode::Idle),
        ("guide", RobotMode::Guiding),
        ("let-go", RobotMode::Idle),
    ] {
        assert_eq!(carry_out(&emulator, line), Outcome::Done);
        client.until(mode);
    }
    assert!("silence".parse::<Fault>().is_ok() && "wrong-version=4,for=1s".parse::<Fault>().is_ok());
    assert_eq!(carry_out(&emulator, "fault silence"), Outcome::Done);
    std::thread::sleep(Duration::from_millis(50));
    client.drain();
    assert!(!client.hears(Duration::from_millis(100)));
    assert_eq!(carry_out(&emulator, "heal"), Outcome::Done);
    client.read();
    for (line, part) in
        [("status", "idle"), ("fault thunder", "unknown kind"), ("help", "user-stop"), ("dance", "none of")]
    {
        let Outcome::Say(text) = carry_out(&emulator, line) else { panic!("`{line}` says nothing") };
        assert!(text.contains(part), "{line}: {text}");
    }
    assert_eq!(carry_out(&emulator, ""), Outcome::Done);
    assert_eq!(carry_out(&emulator, "quit"), Outcome::Quit);
}
