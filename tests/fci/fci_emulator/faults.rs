//! Faults of network and robot, as a client meets them.

use super::client::{Answer, knock};
use super::emulator::{Emulator, Fault, Settings};
use super::{address, session, waiting};
use plumbline_franka::wire::{
    ConnectStatus, ErrorBit, MoveStatus, Protocol, RecoveryStatus, Request, RobotCommand, RobotMode,
};
use std::time::Duration;

fn fault(text: &str) -> Fault {
    text.parse().unwrap_or_else(|error| panic!("{error}"))
}

/// Numbers of `count` datagrams in the order in which they arrive; `None` for what is no state.
fn numbers(text: &str, count: usize) -> Vec<Option<u64>> {
    let (emulator, mut client) = session(Settings::new(address(), Protocol::V10));
    emulator.fault(fault(&format!("{text},of=states")));
    std::thread::sleep(Duration::from_millis(20));
    client.drain();
    (0..count).map(|_| client.receive().ok().map(|state| state.message_id)).collect()
}

#[test]
fn states_are_lost_doubled_swapped_cut_and_spoiled() {
    let lost: Vec<u64> = numbers("loss=0.3", 300).into_iter().flatten().collect();
    let gaps = lost.last().expect("states") - lost[0] + 1 - lost.len() as u64;
    assert!(lost.is_sorted() && (60..=240).contains(&gaps), "{gaps} lost beside 300 received");
    let doubled: Vec<u64> = numbers("duplicate=1", 100).into_iter().flatten().collect();
    assert!(doubled.windows(2).filter(|pair| pair[0] == pair[1]).count() >= 45);
    let swapped: Vec<u64> = numbers("reorder=0.3", 300).into_iter().flatten().collect();
    assert!(!swapped.is_sorted());
    for spoiled in ["truncate=1", "garbage=1"] {
        assert!(numbers(spoiled, 50).iter().all(Option::is_none), "{spoiled}");
    }
}

#[test]
fn lost_commands_end_a_motion_and_duplicates_do_not() {
    let (emulator, mut client) = session(waiting(Protocol::V5));
    emulator.fault(fault("duplicate=1,of=commands"));
    let id = client.start_positions();
    let q = client.state.q_d;
    for _ in 0..100 {
        client.step_to(q);
    }
    assert_eq!(client.state.robot_mode, RobotMode::Move, "{}", client.state.reflex_reason);
    assert!(emulator.snapshot().counts.untimely >= 50);
    assert_eq!(
        client.finish(id, RobotCommand { q_c: q, ..RobotCommand::default() }),
        Answer::Move(MoveStatus::Success)
    );

    let (emulator, mut client) = session(Settings::new(address(), Protocol::V5));
    emulator.fault(fault("loss=1,of=commands"));
    let id = client.start_positions();
    let q = client.state.q_d;
    while client.state.robot_mode == RobotMode::Move {
        client.step_to(q);
    }
    assert!(client.state.reflex_reason.contains(ErrorBit::CommunicationConstraintsViolation));
    assert_eq!(client.await_answer(id), Answer::Move(MoveStatus::ReflexAborted));
    emulator.heal();
    assert_eq!(client.ask(Request::AutomaticErrorRecovery), Answer::Recovery(RecoveryStatus::Success));
}

#[test]
fn a_reset_ends_the_session_and_the_arm_brakes() {
    let (emulator, mut client) = session(waiting(Protocol::V10));
    emulator.fault(fault("tcp-reset,at=motion+0.03"));
    client.start_positions();
    let q = client.state.q_d;
    let error = loop {
        client.write(RobotCommand { q_c: q, ..RobotCommand::default() });
        match client.poll() {
            Ok(true) if client.hears(Duration::from_millis(300)) => client.state.message_id += 1,
            Ok(true) => {}
            other => break other,
        }
    };
    assert_eq!(error.expect_err("a reset").kind(), std::io::ErrorKind::ConnectionReset);
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(emulator.snapshot().state.robot_mode, RobotMode::Idle);
    assert!(!emulator.snapshot().connected);
}

#[test]
fn a_robot_falls_silent_and_speaks_again() {
    let (emulator, mut client) = session(Settings::new(address(), Protocol::V10));
    emulator.fault(fault("silence,for=1"));
    std::thread::sleep(Duration::from_millis(300));
    client.drain();
    assert!(!client.hears(Duration::from_millis(100)));
    assert!(client.hears(Duration::from_secs(5)), "it speaks again");
    assert!(client.poll().expect("the connection stands"));
}

#[test]
fn a_wrong_version_is_claimed() {
    let address = address();
    let settings = Settings { faults: vec![fault("wrong-version=4")], ..Settings::new(address, Protocol::V5) };
    let _emulator = Emulator::start(settings).expect("an emulator");
    for version in [4, 5, 10] {
        let (connected, ..) = knock(address, version);
        assert_eq!((connected.status, connected.version), (ConnectStatus::IncompatibleVersion, 4));
    }
}
