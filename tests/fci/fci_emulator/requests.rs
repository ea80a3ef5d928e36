//! Behaviour beside motions: setters, the operator's actions, other clients, bad bytes, descriptions.

use super::client::{Answer, Client};
use super::emulator::{OperatorAction, READY, Settings};
use super::{address, each_protocol, session, waiting};
use plumbline_franka::wire::{
    Architecture, CollisionBehavior, CommandKind, Deviation, ErrorBit, Header, LibraryTarget, Move, MoveController,
    MoveGenerator, MoveStatus, Protocol, RecoveryStatus, Request, RobotCommand, RobotMode, SetterStatus, System,
};
use plumbline_model::Mounting;
use std::io::Read;
use std::time::Duration;

fn thresholds(torque: f64, force: f64) -> CollisionBehavior {
    CollisionBehavior {
        lower_torque_acceleration: [torque; 7],
        upper_torque_acceleration: [torque; 7],
        lower_torque_nominal: [torque; 7],
        upper_torque_nominal: [torque; 7],
        lower_force_acceleration: [force; 6],
        upper_force_acceleration: [force; 6],
        lower_force_nominal: [force; 6],
        upper_force_nominal: [force; 6],
    }
}

/// Thresholds below what the sensors' noise amounts to: the arm takes that for a collision.
#[test]
fn a_collision_is_a_reflex_by_joint_and_by_force() {
    for (behavior, expected) in
        [(thresholds(0.001, 1e4), ErrorBit::JointReflex), (thresholds(1e4, 0.001), ErrorBit::CartesianReflex)]
    {
        let (_emulator, mut client) = session(waiting(Protocol::V10));
        assert_eq!(client.ask(Request::SetCollisionBehavior(behavior)), Answer::Setter(SetterStatus::Success));
        let id = client.start_positions();
        let q = client.state.q_d;
        for _ in 0..1000 {
            if client.state.robot_mode == RobotMode::Move {
                client.step_to(q);
            }
        }
        assert_eq!(client.state.robot_mode, RobotMode::Reflex);
        assert_eq!(client.state.reflex_reason.iter().collect::<Vec<_>>(), [expected]);
        assert_eq!(client.await_answer(id), Answer::Move(MoveStatus::ReflexAborted));
        assert_eq!(client.state.joint_collision.contains(&1.0), expected == ErrorBit::JointReflex);
    }
}

#[test]
fn the_operators_hand_ends_motions_and_keeps_others_from_starting() {
    each_protocol(|protocol| {
        let (emulator, mut client) = session(waiting(protocol));
        let id = client.start_positions();
        client.step_to(client.state.q_d);
        emulator.operate(OperatorAction::UserStop);
        client.until(RobotMode::UserStopped);
        assert!(client.state.reflex_reason.is_empty());
        assert_eq!(client.await_answer(id), Answer::Move(MoveStatus::EmergencyAborted));
        let wanted = Move::new(MoveController::JointImpedance, MoveGenerator::JointPosition);
        let refused = Answer::Move(MoveStatus::NotPossible);
        for (before, mode, after) in [
            (OperatorAction::UserStop, RobotMode::UserStopped, OperatorAction::Release),
            (OperatorAction::Lock, RobotMode::Other, OperatorAction::Unlock),
            (OperatorAction::Guide, RobotMode::Guiding, OperatorAction::LetGo),
        ] {
            emulator.operate(before);
            client.until(mode);
            assert_eq!(client.begin(wanted).1, refused, "{mode}");
            assert_eq!(client.ask(Request::AutomaticErrorRecovery), Answer::Recovery(RecoveryStatus::NotPossible));
            emulator.operate(after);
            client.until(RobotMode::Idle);
        }
        let id = client.start_positions();
        let last = RobotCommand { q_c: client.state.q_d, ..RobotCommand::default() };
        assert_eq!(client.finish(id, last), Answer::Move(MoveStatus::Success));
    });
}

#[test]
fn a_second_client_is_sent_away_and_the_next_one_served() {
    let (emulator, client) = session(Settings::new(address(), Protocol::V10));
    let second = std::net::TcpStream::connect((client.address(), 1337)).and_then(|mut stream| {
        stream.set_read_timeout(Some(Duration::from_secs(10)))?;
        stream.read(&mut [0; 1])
    });
    assert!(matches!(second, Ok(0) | Err(_)), "{second:?}");
    std::thread::sleep(Duration::from_millis(50));
    assert_eq!(emulator.snapshot().counts.refused, 1);
    let address = client.address();
    client.close();
    let mut next = Client::connect(address, Protocol::V10);
    assert_eq!(next.read().robot_mode, RobotMode::Idle);
}

#[test]
fn a_client_that_goes_leaves_an_arm_at_rest() {
    let (emulator, mut client) = session(waiting(Protocol::V10));
    client.start_positions();
    let q = client.state.q_d;
    client.step_to(q);
    client.close();
    std::thread::sleep(Duration::from_millis(200));
    let state = emulator.snapshot().state;
    assert_eq!((state.robot_mode, state.dq_d), (RobotMode::Idle, [0.0; 7]));
}

#[test]
fn bad_bytes_are_no_commands_and_bad_requests_end_the_session() {
    let (emulator, mut client) = session(waiting(Protocol::V10));
    let id = client.start_positions();
    let q = client.state.q_d;
    for length in [0, 1, 370, 372, 1000] {
        client.send_bytes(&vec![0xff; length]);
        // Neither one of the past nor one of the future is the answer to the newest state.
        client.send(&RobotCommand {
            message_id: client.state.message_id - 1,
            q_c: [9.0; 7],
            ..RobotCommand::default()
        });
        client.send(&RobotCommand {
            message_id: client.state.message_id + 5,
            q_c: [9.0; 7],
            ..RobotCommand::default()
        });
        client.step_to(q);
        assert_eq!(client.state.robot_mode, RobotMode::Move, "{}", client.state.reflex_reason);
    }
    let counts = emulator.snapshot().counts;
    assert!(counts.bad >= 5 && counts.untimely >= 10, "{counts:?}");
    assert_eq!(
        client.finish(id, RobotCommand { q_c: q, ..RobotCommand::default() }),
        Answer::Move(MoveStatus::Success)
    );
    client.say(&Header { command: 99, command_id: 77, size: 12 }.encode());
    let start = std::time::Instant::now();
    while matches!(client.poll(), Ok(true)) {
        assert!(start.elapsed() < Duration::from_secs(10), "an unknown command is answered with the end");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// libfranka's example of a joint impedance loads the model when its motion runs.
#[test]
fn a_description_is_served_while_a_motion_runs() {
    for protocol in [Protocol::V9, Protocol::V10] {
        let (_emulator, mut client) = session(waiting(protocol));
        let motion = client.start_positions();
        let q = client.state.q_d;
        let id = client.call(Request::GetRobotModel);
        let answer = loop {
            client.step_to(q);
            assert_eq!(client.state.robot_mode, RobotMode::Move, "{}", client.state.reflex_reason);
            if let Some(answer) = client.answer(id) {
                break answer;
            }
        };
        assert!(matches!(answer, Answer::Model(Some(_))), "{protocol}: {answer:?}");
        let last = RobotCommand { q_c: q, ..RobotCommand::default() };
        assert_eq!(client.finish(motion, last), Answer::Move(MoveStatus::Success));
    }
}

#[test]
fn models_are_served_where_the_version_has_them() {
    let target = LibraryTarget { architecture: Architecture::X64, system: System::Linux };
    each_protocol(|protocol| {
        let library = Some(vec![1, 2, 3, 4, 5]);
        let (_emulator, mut client) = session(Settings { model_library: library.clone(), ..waiting(protocol) });
        if protocol != Protocol::V10 {
            assert_eq!(client.ask(Request::LoadModelLibrary(target)), Answer::Library(library));
            let other = LibraryTarget { architecture: Architecture::Arm64, ..target };
            assert_eq!(client.ask(Request::LoadModelLibrary(other)), Answer::Library(None));
        }
        if protocol != Protocol::V5 {
            let Answer::Model(Some(urdf)) = client.ask(Request::GetRobotModel) else { panic!("a description") };
            let document = roxmltree::Document::parse(&urdf).expect("XML");
            let mut joints = document.root_element().children().filter(|node| node.has_tag_name("joint"));
            for number in 1..=7 {
                let joint = joints.next().expect("a joint");
                assert_eq!(joint.attribute("name"), Some(format!("joint{number}").as_str()));
                let element = |name| joint.children().find(|node| node.has_tag_name(name)).expect("an element");
                let real = |name, attribute| {
                    element(name).attribute(attribute).expect("an attribute").parse::<f64>().expect("a number")
                };
                let limits = super::emulator::limits::Limits::of(super::emulator::RobotKind::Fr3, protocol);
                assert_eq!(real("limit", "upper"), limits.q_max[number - 1]);
                assert_eq!(real("limit", "velocity"), limits.dq[number - 1]);
                let envelope = limits.envelope.expect("an FR3 has one");
                assert_eq!(real("position_based_velocity_limits", "velocity_offset"), envelope.offset[number - 1]);
            }
        }
    });
    let (_emulator, mut client) = session(waiting(Protocol::V5));
    assert_eq!(client.ask(Request::LoadModelLibrary(target)), Answer::Library(None));
}

/// The robot's own gravity is a guess of the upright; its accelerometers know better.
#[test]
fn accelerometers_know_the_mounting_and_the_base_does_not() {
    let settings = Settings { mounting: Mounting::WALL, ..Settings::new(address(), Protocol::V10) };
    let (_emulator, mut client) = session(settings);
    let mut mean = [0.0; 3];
    for _ in 0..100 {
        client.read();
        mean.iter_mut().zip(client.state.accelerometer_top[0]).for_each(|(sum, value)| *sum += value / 100.0);
    }
    assert_eq!(client.state.o_ddp_o[0], 0.0);
    // Link 1 stands as the base does where joint 1 is at zero, and the base's x axis points down on a wall.
    assert_eq!(READY[0], 0.0);
    let expected = [-9.81, 0.0, 0.0];
    for axis in 0..3 {
        assert!((mean[axis] - expected[axis]).abs() < 0.02, "{mean:?}");
    }
}

#[test]
fn a_log_holds_every_millisecond() {
    let dir = tempfile::tempdir().expect("a folder");
    let path = dir.path().join("cycles.csv");
    let (emulator, mut client) = session(Settings { log: Some(path.clone()), ..waiting(Protocol::V10) });
    let id = client.start_positions();
    let mut q = client.state.q_d;
    client.step_to(q);
    q[0] += 0.01;
    client.step_to(q);
    client.await_answer(id);
    client.close();
    drop(emulator);
    let mut reader = csv::Reader::from_path(path).expect("a log");
    let rows: Vec<_> = reader.records().map(|row| row.expect("a whole row")).collect();
    for pair in rows.windows(2) {
        let number = |row: &csv::StringRecord| row[0].parse::<u64>().expect("a number");
        assert_eq!(number(&pair[1]), number(&pair[0]) + 1);
    }
    let bit = 1u64 << ErrorBit::JointMotionGeneratorVelocityDiscontinuity as u8;
    let reflexes = rows.iter().filter(|row| row[3].parse::<u64>().expect("a mask") & bit != 0);
    assert!(reflexes.clone().all(|row| &row[1] == "4") && reflexes.count() > 0);
}

#[test]
fn a_malformed_move_is_an_invalid_argument() {
    let (_emulator, mut client) = session(waiting(Protocol::V5));
    let wanted = Move {
        max_path_deviation: Deviation { translation: -1.0, ..Deviation::default() },
        ..Move::new(MoveController::JointImpedance, MoveGenerator::JointPosition)
    };
    assert_eq!(client.begin(wanted).1, Answer::Move(MoveStatus::InvalidArgument));
    // A motion generator that version 5 does not know, which the codec would not write.
    let id = client.expect(CommandKind::Move);
    let size = Protocol::V5.move_bytes();
    let mut message = vec![0; size];
    message[..12].copy_from_slice(&Header { command: 1, command_id: id, size: size as u32 }.encode());
    message[16] = 4;
    client.say(&message);
    assert_eq!(client.await_answer(id), Answer::Move(MoveStatus::InvalidArgument));
}
