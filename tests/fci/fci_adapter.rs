//! The adapter of Franka arms against a fake control unit that does things wrong, one known pain per test.

mod connecting;
mod fake_robot;

use fake_robot::{Fake, READY, World};
use plumbline_core::{Backend, Command, Fault, JointVec, Setpoint, State};
use plumbline_franka::wire::{
    ErrorBit, Errors, MAX_STATE, MotionGeneratorMode, MoveStatus, Protocol, Request, Response, RobotMode,
};
use plumbline_franka::{
    ConnectError, Connection, FrankaArm, Interface, Purpose, REFLEX_MODE, REFUSED_JUMP, REFUSED_MOVE, REFUSED_NO_START,
    REFUSED_NOT_FINITE, REFUSED_POSITION, REFUSED_STOPPED, RobotKind, Settings, Source, connect, explain, recover,
    recover_communication,
};

use std::time::{Duration, Instant};

/// A stop that waits for an arm without states or answers never ends; this is long enough for a loaded machine.
const STOP_ENDS: Duration = Duration::from_secs(20);

fn settings(fake: &Fake, protocol: Protocol) -> Settings {
    let robot = if protocol == Protocol::V5 { RobotKind::Panda } else { RobotKind::Fr3 };
    // A loaded machine may start the thread of the fake a second late.
    Settings { connect_timeout: Duration::from_secs(4), ..Settings::new(fake.address, robot) }
}

fn open(fake: &Fake, protocol: Protocol) -> (FrankaArm, Connection) {
    connect(&settings(fake, protocol)).unwrap_or_else(|error| panic!("{error}"))
}

fn command(state: &State, q: JointVec) -> Command {
    Command { seq: state.seq, desired: Setpoint { q, ..Setpoint::default() }, ..Command::default() }
}

/// Smooth from rest to rest, 0.1 rad out and back within two seconds, in every joint.
fn motion(from: &JointVec, tick: u64) -> JointVec {
    let t = tick.min(2000) as f64 * 1e-3;
    let mut q = *from;
    q[..7].iter_mut().for_each(|q| *q += 0.1 * (t * std::f64::consts::FRAC_PI_2).sin().powi(4));
    q
}

/// Drives the motion for `ticks` of the arm's milliseconds, or until something ends it.
fn drive(arm: &mut FrankaArm, ticks: u64) -> Result<State, Fault> {
    let start = arm.read()?;
    let mut state = start;
    while state.seq < start.seq + ticks {
        arm.write(&command(&state, motion(&start.q_d, state.seq + 1 - start.seq)))?;
        state = arm.read()?;
    }
    Ok(state)
}

fn healthy(_: &mut World) {}

#[test]
fn a_motion_runs_and_ends_as_the_protocol_wants_it_at_every_version_and_interface() {
    for protocol in Protocol::ALL {
        for interface in [Interface::JointPosition, Interface::JointVelocity, Interface::Torque] {
            let fake = Fake::start(protocol, healthy);
            let (mut arm, connection) = connect(&Settings { interface, ..settings(&fake, protocol) }).unwrap();
            let info = &connection.info;
            assert_eq!(
                (info.protocol, info.state.q_d),
                (protocol, if protocol == Protocol::V10 { READY.map(|q| f64::from(q as f32)) } else { READY })
            );
            assert_eq!(info.urdf.is_some(), protocol != Protocol::V5);
            // The arm's own limits, where it serves them.
            assert_eq!(
                (info.limits_from_arm, info.limits.dq[0]),
                if protocol == Protocol::V5 { (false, 2.175) } else { (true, 2.5) }
            );
            let gravity = info.gravity.expect("at rest");
            assert_eq!((gravity.source, gravity.direction), (Source::Base, [0.0, 0.0, -1.0]));
            assert!(fake.with(|world| world.motion.is_none()), "no motion before the first read");
            assert!(fake.with(|world| {
                world.requests.iter().any(|request| matches!(request, Request::SetCollisionBehavior(_)))
            }));

            let end = drive(&mut arm, 700).unwrap();
            let moving = fake.with(|world| (world.motion.is_some(), world.state.dq_d));
            assert!(moving.0, "{protocol} {interface:?}");
            arm.stop();
            arm.stop();
            fake.with(|world| {
                assert_eq!(world.state.robot_mode, RobotMode::Idle, "{protocol} {interface:?}");
                let (_, last) = world.commands.last().unwrap();
                let torque_only = interface == Interface::Torque && protocol != Protocol::V5;
                assert_eq!(
                    (last.motion_generation_finished, last.torque_command_finished),
                    (!torque_only, torque_only)
                );
                let (_, first) = world.commands.first().unwrap();
                match interface {
                    Interface::JointPosition => {
                        assert_eq!(first.q_c, info.state.q_d, "the first command is q_d to the bit");
                        assert!((world.state.q_d[0] - READY[0]).abs() > 0.01, "{:?}", world.state.q_d);
                    }
                    Interface::JointVelocity => assert_eq!((first.dq_c, first.q_c), ([0.0; 7], [0.0; 7])),
                    Interface::Torque => assert_eq!((first.q_c, first.dq_c), ([0.0; 7], [0.0; 7])),
                }
                if interface != Interface::Torque {
                    // Braked from the motion, without a jump.
                    let points: Vec<(u64, f64)> =
                        world.commands.iter().map(|(at, command)| (*at, command.q_c[0])).collect();
                    let quick =
                        |pair: &[(u64, f64)]| (pair[1].1 - pair[0].1).abs() > 5e-4 * (pair[1].0 - pair[0].0) as f64;
                    assert!(!points.windows(2).any(quick), "{protocol} {interface:?}");
                }
            });
            let statistics = connection.telemetry.snapshot();
            assert_eq!(statistics.status(), Some(MoveStatus::Success), "{protocol} {interface:?}");
            assert!(statistics.commands > 300 && statistics.work.count == statistics.commands, "{statistics:?}");
            assert!(statistics.wake.count > 300 && statistics.interval.count > 300, "{statistics:?}");
            if interface == Interface::JointPosition {
                assert!(
                    statistics.round_trip.count > 50 && statistics.round_trip.p50_ns < 50_000_000,
                    "{statistics:?}"
                );
                assert!((end.q_d[0] - end.q[0]).abs() < 1e-6);
            }
            assert!(statistics.success_rate.min > 0.0 && statistics.success_rate.mean <= 1.0);
            assert_eq!(arm.write(&command(&end, end.q_d)), Err(Fault::Refused { code: REFUSED_STOPPED }));
            assert!(arm.read().is_ok(), "a stopped arm can still be watched");
        }
    }
}

#[test]
fn an_arm_that_is_watched_is_never_moved() {
    let fake = Fake::start(Protocol::V10, |world| world.state.robot_mode = RobotMode::UserStopped);
    let watch = Settings { purpose: Purpose::Monitor, ..settings(&fake, Protocol::V10) };
    let (mut arm, connection) = connect(&watch).unwrap();
    let first = arm.read().unwrap();
    for _ in 0..50 {
        let state = arm.read().unwrap();
        arm.write(&command(&state, [9.0; 8])).unwrap();
        assert!(state.seq > first.seq);
    }
    arm.stop();
    assert!(arm.read().is_ok());
    fake.with(|world| {
        assert!(
            world.commands.is_empty() && world.requests.iter().all(|request| matches!(request, Request::GetRobotModel))
        )
    });
    assert_eq!(connection.telemetry.snapshot().mode(), RobotMode::UserStopped);
}

#[test]
fn a_reflex_in_motion_is_the_one_of_the_first_state_that_shows_it() {
    let fake = Fake::start(Protocol::V10, |world| {
        if world.ticks == 200 && world.motion.is_some() {
            let reasons = Errors::NONE.with(ErrorBit::CartesianReflex).with(ErrorBit::JointReflex);
            world.end(RobotMode::Reflex, reasons, Some(MoveStatus::ReflexAborted));
        } else if world.state.robot_mode == RobotMode::Reflex {
            // Later states say less.
            (world.state.errors, world.state.reflex_reason) = (Errors::NONE, Errors::NONE);
        }
    });
    let (mut arm, connection) = open(&fake, Protocol::V10);
    let fault = drive(&mut arm, 1000).unwrap_err();
    assert_eq!(fault, Fault::Reflex { code: ErrorBit::JointReflex as u32 });
    assert_eq!(arm.read(), Err(fault), "and it stays");
    let begin = Instant::now();
    arm.stop();
    assert!(begin.elapsed() < STOP_ENDS);
    let statistics = connection.telemetry.snapshot();
    assert_eq!(statistics.reflex().to_string(), "joint_reflex, cartesian_reflex");
    assert_eq!(statistics.status(), Some(MoveStatus::ReflexAborted), "the last word was read");
    let words = explain(&fault, &statistics);
    assert!(
        words.what.contains("joint_reflex, cartesian_reflex")
            && words.next.contains("touched")
            && words.next.contains("recovery"),
        "{words}"
    );
}

#[test]
fn a_program_recovers_by_itself_from_lost_communication_alone() {
    use ErrorBit::{CommunicationConstraintsViolation as Communication, ControllerTorqueDiscontinuity, JointReflex};
    let asked = |fake: &Fake| fake.with(|world| world.requests.contains(&Request::AutomaticErrorRecovery));
    for (more, recovers) in [(None, true), (Some(JointReflex), false), (Some(ControllerTorqueDiscontinuity), false)] {
        let reasons = more.into_iter().fold(Errors::NONE.with(Communication), Errors::with);
        let fake = Fake::start(Protocol::V10, move |world| {
            if world.ticks == 200 && world.motion.is_some() {
                world.end(RobotMode::Reflex, reasons, Some(MoveStatus::ReflexAborted));
            }
        });
        let (mut arm, _) = open(&fake, Protocol::V10);
        let fault = drive(&mut arm, 1000).unwrap_err();
        arm.stop();
        drop(arm);
        // Any reason besides it stands before lost communication, whatever its number.
        assert_eq!(fault, Fault::Reflex { code: more.unwrap_or(Communication) as u32 });
        let settings = settings(&fake, Protocol::V10);
        match recover_communication(&settings) {
            Ok(()) => assert!(recovers && asked(&fake), "{more:?}"),
            Err(error) => {
                assert!(!recovers && !asked(&fake), "{error}");
                assert!(matches!(error, ConnectError::NotByItself { reasons: named } if named == reasons), "{error}");
                let text = error.to_string();
                assert!(text.contains(more.unwrap().name()) && text.contains("Desk"), "{text}");
                assert_eq!(fake.with(|world| world.state.robot_mode), RobotMode::Reflex);
                // A person who has looked at it may.
                recover(&settings).unwrap();
                assert!(asked(&fake));
            }
        }
        assert_eq!(fake.with(|world| world.state.robot_mode), RobotMode::Idle, "{more:?}");
    }
}

#[test]
fn a_collision_behind_a_broken_network_is_left_to_a_person() {
    // Nothing is heard of the arm while it stops; it is in its reflex when it comes back.
    let mut dark = 0;
    let fake = Fake::start(Protocol::V5, move |world| {
        if world.ticks == 200 && world.motion.is_some() {
            world.end(RobotMode::Reflex, Errors::NONE.with(ErrorBit::CartesianReflex), None);
            (world.closes, dark) = (true, 200);
        }
        dark -= i32::from(dark > 0);
        world.sends = dark == 0;
    });
    let (mut arm, _) = open(&fake, Protocol::V5);
    let fault = drive(&mut arm, 1000).unwrap_err();
    assert!(matches!(fault, Fault::Disconnected | Fault::Silent { .. }), "{fault:?}");
    arm.stop();
    drop(arm);
    let error = recover_communication(&settings(&fake, Protocol::V5)).expect_err("it has met something");
    assert!(
        matches!(error, ConnectError::NotByItself { .. }) && error.to_string().contains("cartesian_reflex"),
        "{error}"
    );
    assert!(fake.with(|world| !world.requests.contains(&Request::AutomaticErrorRecovery)));
}

#[test]
fn a_user_stop_in_motion_is_no_reflex_of_an_earlier_motion() {
    let fake = Fake::start(Protocol::V9, |world| {
        if world.ticks == 100 && world.motion.is_some() {
            world.end(RobotMode::UserStopped, Errors::NONE, Some(MoveStatus::EmergencyAborted));
        }
    });
    let (mut arm, connection) = open(&fake, Protocol::V9);
    let fault = drive(&mut arm, 1000).unwrap_err();
    assert_eq!(fault, Fault::Reflex { code: REFLEX_MODE + u32::from(RobotMode::UserStopped.code()) });
    arm.stop();
    let words = explain(&fault, &connection.telemetry.snapshot());
    assert!(words.what.contains("user stopped") && words.next.contains("user stop"), "{words}");
}

/// What a stall of ours of `pause` at tick 150 ends in.
fn stall(pause: Duration, in_write: bool) -> (Fault, String) {
    let fake = Fake::start(Protocol::V10, |world| world.waits = false);
    let (mut arm, connection) = open(&fake, Protocol::V10);
    let start = arm.read().unwrap();
    let mut state = start;
    let begin = Instant::now();
    let fault = loop {
        let stalled = state.seq > start.seq + 150 && state.seq < start.seq + 170;
        if stalled && in_write {
            std::thread::sleep(pause);
        }
        let sent = arm.write(&command(&state, motion(&start.q_d, state.seq + 1 - start.seq)));
        if stalled && !in_write {
            std::thread::sleep(pause);
        }
        match sent.and_then(|()| arm.read()) {
            Ok(next) => state = next,
            Err(fault) => break fault,
        }
        assert!(begin.elapsed() < Duration::from_secs(60), "no fault from a stall");
    };
    arm.stop();
    (fault, explain(&fault, &connection.telemetry.snapshot()).to_string())
}

#[test]
fn a_stall_ends_in_a_violation_that_says_who_stalled() {
    let communication = Fault::Reflex { code: ErrorBit::CommunicationConstraintsViolation as u32 };
    let (fault, words) = stall(Duration::from_millis(250), true);
    assert_eq!(fault, communication);
    assert!(words.contains("communication_constraints_violation") && words.contains("our own work took 2"), "{words}");
    let (fault, words) = stall(Duration::from_millis(250), false);
    assert_eq!(fault, communication);
    assert!(words.contains("not woken in time"), "{words}");
}

#[test]
fn a_network_that_stops_is_told_from_our_own_stall() {
    // States stop, and with them our commands, until the arm has stopped for that reason.
    let fake = Fake::start(Protocol::V10, |world| world.sends = world.motion.is_none() || world.ticks < 200);
    let (mut arm, connection) = open(&fake, Protocol::V10);
    let fault = drive(&mut arm, 1000).unwrap_err();
    arm.stop();
    assert_eq!(fault, Fault::Reflex { code: ErrorBit::CommunicationConstraintsViolation as u32 });
    let words = explain(&fault, &connection.telemetry.snapshot());
    assert!(
        words.cause.as_ref().is_some_and(|cause| cause.contains("never arrived") && cause.contains("network")),
        "{words}"
    );
    // For good: the read gives up, and the stop does not wait for what never comes.
    let fake = Fake::start(Protocol::V5, |world| world.sends = world.ticks < 200);
    let (mut arm, connection) = open(&fake, Protocol::V5);
    let fault = drive(&mut arm, 1000).unwrap_err();
    assert!(matches!(fault, Fault::Silent { waited_ms: 100.. }), "{fault:?}");
    let begin = Instant::now();
    arm.stop();
    assert!(begin.elapsed() < STOP_ENDS);
    let words = explain(&fault, &connection.telemetry.snapshot());
    assert!(words.what.contains("no state") && !words.to_string().contains("preempted"), "{words}");
}

#[test]
fn after_lost_states_the_arm_goes_on_from_where_it_went_by_itself() {
    for protocol in Protocol::ALL {
        // Twelve states are lost in the quickest part of the motion, then single ones; some come twice, late or broken.
        let fake = Fake::start(protocol, move |world| {
            world.sends = world.motion.is_none() || !(400..412).contains(&world.ticks) && world.ticks % 97 != 0;
            if world.ticks == 600 {
                let mut bytes = [0; MAX_STATE];
                let mut old = world.state;
                let length = old.encode(protocol, &mut bytes);
                world.extra.push(bytes[..length].to_vec());
                old.message_id -= 3;
                let length = old.encode(protocol, &mut bytes);
                world.extra.push(bytes[..length].to_vec());
                world.extra.push(bytes[..length - 1].to_vec());
                world.extra.push(vec![1; 3000]);
            }
        });
        let (mut arm, connection) = open(&fake, protocol);
        let end = drive(&mut arm, 2300).unwrap();
        let statistics = connection.telemetry.snapshot();
        arm.stop();
        assert!(statistics.lost >= 12 && statistics.longest_gap >= 12, "{statistics:?}");
        assert!(
            statistics.returning > 10 && statistics.duplicates >= 1 && statistics.out_of_order >= 1,
            "{statistics:?}"
        );
        assert!(statistics.bad_packets >= 2, "{statistics:?}");
        assert!((0..7).all(|j| (end.q_d[j] - READY[j]).abs() < 1e-4), "back where it began: {:?}", end.q_d);
        // As the arm differences them, no command breaks a limit.
        fake.with(|world| {
            let limits = connection.info.limits;
            let mut worst = [0.0f64; 2];
            let mut point =
                (READY.map(|q| if protocol == Protocol::V10 { f64::from(q as f32) } else { q }), [0.0; 7], [0.0; 7]);
            let mut tick = world.commands[0].0 - 1;
            for (at, command) in &world.commands {
                while tick + 1 < *at {
                    for j in 0..7 {
                        point.1[j] += 1e-3 * point.2[j];
                        point.0[j] += 1e-3 * point.1[j];
                    }
                    tick += 1;
                }
                for j in 0..7 {
                    let dq = (command.q_c[j] - point.0[j]) / 1e-3;
                    let ddq = (dq - point.1[j]) / 1e-3;
                    worst[0] = worst[0].max(ddq.abs() / limits.ddq[j]);
                    worst[1] = worst[1].max((ddq - point.2[j]).abs() / 1e-3 / limits.jerk[j]);
                    (point.0[j], point.1[j], point.2[j]) = (command.q_c[j], dq, ddq);
                }
                tick = *at;
            }
            assert!(worst[0] < 1.0 && worst[1] < 1.0, "{protocol}: shares of acceleration and jerk {worst:?}");
        });
    }
}

#[test]
fn a_motion_that_ends_before_it_shows_itself_is_an_answer_not_a_hang() {
    let fake = Fake::start(Protocol::V10, |world| {
        if let Some(id) = world.motion.take() {
            world.end(RobotMode::Idle, Errors::NONE, None);
            world.answer(id, Response::Move(MoveStatus::Success));
        }
    });
    let (mut arm, _) = open(&fake, Protocol::V10);
    let index = MoveStatus::ALL.iter().position(|status| *status == MoveStatus::Success).unwrap();
    assert_eq!(arm.read(), Err(Fault::Refused { code: REFUSED_MOVE + index as u32 }));
    arm.stop();
    // And one that we end with the very first command.
    let fake = Fake::start(Protocol::V10, healthy);
    let (mut arm, connection) = open(&fake, Protocol::V10);
    arm.read().unwrap();
    arm.stop();
    assert_eq!(connection.telemetry.snapshot().status(), Some(MoveStatus::Success));
    fake.with(|world| {
        assert!(
            world.motion.is_none()
                && world.commands.iter().all(|(_, command)| command.q_c == READY.map(|q| f64::from(q as f32)))
        )
    });
}

#[test]
fn a_motion_that_is_refused_or_never_starts_is_told_apart() {
    let fake = Fake::start(Protocol::V5, healthy);
    let (mut arm, connection) = open(&fake, Protocol::V5);
    fake.with(|world| world.state.robot_mode = RobotMode::Guiding);
    let fault = arm.read().unwrap_err();
    let index = MoveStatus::ALL.iter().position(|status| *status == MoveStatus::NotPossible).unwrap();
    assert_eq!(fault, Fault::Refused { code: REFUSED_MOVE + index as u32 });
    let words = explain(&fault, &connection.telemetry.snapshot());
    assert!(words.next.contains("guided by hand"), "{words}");
    drop(arm);
    let fake = Fake::start(Protocol::V5, |world| world.moves = false);
    let (mut arm, _) = open(&fake, Protocol::V5);
    let begin = Instant::now();
    assert_eq!(arm.read(), Err(Fault::Refused { code: REFUSED_NO_START }));
    arm.stop();
    assert!(begin.elapsed() >= Duration::from_secs(1) && begin.elapsed() < STOP_ENDS);
}

#[test]
fn a_connection_that_dies_in_motion_ends_it_at_once() {
    let fake = Fake::start(Protocol::V10, |world| {
        // The states go on: it is the TCP connection alone that dies.
        world.closes = world.ticks == 300;
    });
    let (mut arm, connection) = open(&fake, Protocol::V10);
    let fault = drive(&mut arm, 1000).unwrap_err();
    assert_eq!(fault, Fault::Disconnected);
    let begin = Instant::now();
    arm.stop();
    arm.stop();
    assert!(begin.elapsed() < STOP_ENDS);
    assert!(explain(&fault, &connection.telemetry.snapshot()).to_string().contains("connection"));
}

/// Drives until the fake has done what its script does 100 ms into the motion; what ended it, in words. A machine that stalls before that ends the
/// motion otherwise, and says nothing.
fn ended_by(script: fn(&mut World)) -> (Fault, String) {
    for _ in 0..20 {
        let fake = Fake::start(Protocol::V10, move |world| {
            if world.ticks == 100 {
                script(world);
            }
        });
        let (mut arm, connection) = open(&fake, Protocol::V10);
        let fault = drive(&mut arm, 5000).expect_err("the script ends it");
        let words = explain(&fault, &connection.telemetry.snapshot()).to_string();
        if fake.with(|world| world.ticks >= 100) && !matches!(fault, Fault::Reflex { .. }) {
            return (fault, words);
        }
    }
    panic!("the machine stalls each time");
}

#[test]
fn what_is_no_message_over_tcp_is_told_from_a_closed_connection() {
    let (fault, words) = ended_by(|world| world.answers.extend_from_slice(b"HTTP/1.1 400 Bad Request\r\n\r\n"));
    assert_eq!(fault, Fault::Disconnected);
    assert!(words.contains("no message") && words.contains("`HTTP/1.1 400`") && words.contains("1337"), "{words}");
    assert!(!words.contains("closed"), "{words}");
}

#[test]
fn numbers_that_start_again_are_told_from_silence() {
    let (fault, words) = ended_by(|world| world.state.message_id = 7);
    assert!(matches!(fault, Fault::Silent { .. }), "{fault:?}");
    assert!(words.contains("count from the beginning again") && words.contains(" after 5"), "{words}");
    assert!(words.contains("started again") && !words.contains("no state came"), "{words}");
}

#[test]
fn commands_that_must_not_leave_are_refused_by_name_and_the_arm_brakes() {
    type Spoil = fn(&mut JointVec);
    let cases: [(Spoil, u32); 4] = [
        (|q| q[3] = f64::NAN, REFUSED_NOT_FINITE),
        (|q| q[0] = f64::INFINITY, REFUSED_NOT_FINITE),
        (|q| q[2] += 0.05, REFUSED_JUMP),
        (|q| q[3] = 0.5, REFUSED_POSITION),
    ];
    for (spoil, code) in cases {
        let fake = Fake::start(Protocol::V9, healthy);
        let (mut arm, _) = open(&fake, Protocol::V9);
        let state = drive(&mut arm, 300).unwrap();
        let mut q = state.q_d;
        spoil(&mut q);
        assert_eq!(arm.write(&command(&state, q)), Err(Fault::Refused { code }));
        let before = fake.with(|world| world.commands.len());
        arm.stop();
        fake.with(|world| {
            assert!(world.commands.len() > before && world.motion.is_none());
            assert!(world.state.motion_generator_mode == MotionGeneratorMode::Idle);
            assert!((0..7).all(|j| (world.state.q_d[j] - READY[j]).abs() < 0.1), "{:?}", world.state.q_d);
        });
    }
}
