//! Every limit crossed, every name; and what follows a reflex.

use super::client::{Answer, Client};
use super::emulator::Settings;
use super::emulator::limits::{Limits, RobotKind};
use super::{address, each_protocol, session, waiting};
use plumbline_franka::wire::{
    ErrorBit, MotionGeneratorMode, Move, MoveController, MoveGenerator, MoveStatus, Protocol, RecoveryStatus, Request,
    RobotCommand, RobotMode, RobotState,
};

fn limits(protocol: Protocol) -> Limits {
    Limits::of(RobotKind::of(protocol), protocol)
}

/// The state that first shows the end of a motion has to say why, and the motion's call is answered with a reflex.
fn reflex(client: &mut Client, id: u32, expected: &[ErrorBit]) -> RobotState {
    assert_eq!(client.state.robot_mode, RobotMode::Reflex, "expected {expected:?}");
    let first = client.state;
    assert_eq!(first.motion_generator_mode, MotionGeneratorMode::Idle);
    assert_eq!(first.reflex_reason.iter().collect::<Vec<_>>(), expected);
    assert_eq!(first.errors, first.reflex_reason);
    assert_eq!(client.await_answer(id), Answer::Move(MoveStatus::ReflexAborted));
    first
}

fn recover(client: &mut Client) {
    assert_eq!(client.ask(Request::AutomaticErrorRecovery), Answer::Recovery(RecoveryStatus::Success));
    client.until(RobotMode::Idle);
}

/// Constant jerk for `ticks`, then constant acceleration: positions by backward Euler from rest.
struct Push {
    q: f64,
    dq: f64,
    ddq: f64,
}

impl Push {
    fn step(&mut self, jerk: f64) -> f64 {
        self.ddq += jerk * 1e-3;
        self.dq += self.ddq * 1e-3;
        self.q += self.dq * 1e-3;
        self.q
    }
}

/// Drives joint 1 by `jerk(push)` until the motion ends or 3 s have passed.
fn push(client: &mut Client, mut jerk: impl FnMut(&Push) -> f64) -> u32 {
    let id = client.start_positions();
    let start = client.state.q_d;
    let mut push = Push { q: start[0], dq: 0.0, ddq: 0.0 };
    // The first command begins the motion where the arm is: otherwise the first step could count as the place where the motion starts.
    client.step_to(start);
    for _ in 0..3000 {
        let next = jerk(&push);
        let mut q = start;
        q[0] = push.step(next);
        client.step_to(q);
        if client.state.robot_mode != RobotMode::Move {
            break;
        }
    }
    id
}

/// A first command may start the motion a little off the desired position, but neither far off nor in motion.
#[test]
fn a_first_command_that_jumps_or_moves_is_a_discontinuity() {
    let expected =
        [ErrorBit::JointMotionGeneratorVelocityDiscontinuity, ErrorBit::JointMotionGeneratorAccelerationDiscontinuity];
    each_protocol(|protocol| {
        let (_emulator, mut client) = session(waiting(protocol));
        let id = client.start_positions();
        let mut q = client.state.q_d;
        q[2] += 0.0021;
        client.step_to(q);
        reflex(&mut client, id, &expected);
        recover(&mut client);
        // As near as a start may be, and on with 0.5 rad/s.
        let id = client.start_positions();
        let mut q = client.state.q_d;
        q[2] += 0.0005;
        client.step_to(q);
        assert_eq!(client.state.robot_mode, RobotMode::Move, "{}", client.state.reflex_reason);
        q[2] += 0.0005;
        client.step_to(q);
        reflex(&mut client, id, &expected);
        recover(&mut client);
        // Back to where the desired position was: the motion has started where the first command was.
        let id = client.start_positions();
        let before = client.state.q_d;
        let mut q = before;
        q[2] += 0.0005;
        client.step_to(q);
        client.step_to(before);
        reflex(&mut client, id, &expected);
    });
}

#[test]
fn velocities_and_torques_are_judged_too() {
    each_protocol(|protocol| {
        let (_emulator, mut client) = session(waiting(protocol));
        let id = client.start(MoveController::JointImpedance, MoveGenerator::JointVelocity);
        client.write(RobotCommand { dq_c: [0.1; 7], ..RobotCommand::default() });
        client.read();
        let discontinuities = [
            ErrorBit::JointMotionGeneratorVelocityDiscontinuity,
            ErrorBit::JointMotionGeneratorAccelerationDiscontinuity,
        ];
        reflex(&mut client, id, &discontinuities);
        recover(&mut client);
        let id = client.start(MoveController::External, MoveGenerator::torque_only(protocol));
        let tau = client.state.tau_j_d;
        client.write(RobotCommand { tau_j_d: tau.map(|tau| tau + 2.0), ..RobotCommand::default() });
        client.read();
        reflex(&mut client, id, &[ErrorBit::ControllerTorqueDiscontinuity]);
        recover(&mut client);
        let id = client.start(MoveController::External, MoveGenerator::torque_only(protocol));
        client.write(RobotCommand { tau_j_d: [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 13.0], ..RobotCommand::default() });
        client.read();
        reflex(&mut client, id, &[ErrorBit::ControllerTorqueDiscontinuity, ErrorBit::TauJRangeViolation]);
    });
}

#[test]
fn numbers_that_are_none_are_an_input_error() {
    each_protocol(|protocol| {
        for wrong in [f64::NAN, f64::INFINITY] {
            let (_emulator, mut client) = session(waiting(protocol));
            let id = client.start_positions();
            let mut q = client.state.q_d;
            client.step_to(q);
            q[4] = wrong;
            client.step_to(q);
            assert_eq!(client.state.robot_mode, RobotMode::Reflex);
            assert!(!client.state.reflex_reason.is_empty());
            assert_eq!(client.await_answer(id), Answer::Move(MoveStatus::InputErrorAborted));
        }
    });
}

/// Nineteen missing commands are forgiven, twenty are not; the arm goes on at constant acceleration meanwhile.
#[test]
fn twenty_missing_commands_end_a_motion() {
    let (_emulator, mut client) = session(Settings::new(address(), Protocol::V10));
    let id = client.start_positions();
    // No command at all.
    client.until(RobotMode::Reflex);
    reflex(&mut client, id, &[ErrorBit::CommunicationConstraintsViolation]);
    recover(&mut client);

    // A stalling machine may lose more than the 19 that are left out here; then that try says nothing.
    let kept = (0..20).any(|_| {
        let id = client.start_positions();
        let q = client.state.q_d;
        for _ in 0..5 {
            client.step_to(q);
        }
        for _ in 0..17 {
            client.read();
        }
        client.step_to(q);
        client.step_to(q);
        let rate = client.state.control_command_success_rate;
        let moving = client.state.robot_mode == RobotMode::Move;
        if moving {
            let answer = client.finish(id, RobotCommand { q_c: q, ..RobotCommand::default() });
            assert!(rate < 0.5, "{rate}");
            answer == Answer::Move(MoveStatus::Success)
        } else {
            client.await_answer(id);
            recover(&mut client);
            false
        }
    });
    assert!(kept, "seventeen missing commands are forgiven");
}

/// While commands are missing, the desired motion goes on at the acceleration that it had.
#[test]
fn the_arm_goes_on_at_constant_acceleration_without_commands() {
    let own = limits(Protocol::V5);
    let settings = Settings { command_wait: std::time::Duration::from_millis(300), ..waiting(Protocol::V5) };
    let (emulator, mut client) = session(settings);
    let id = client.start_positions();
    let start = client.state.q_d;
    let mut push = Push { q: start[0], dq: 0.0, ddq: 0.0 };
    for tick in 0..60 {
        let mut q = start;
        q[0] = push.step(if tick < 2 { 0.3 * own.jerk[0] } else { 0.0 });
        client.step_to(q);
    }
    let before = client.state;
    assert!(before.ddq_d[0] > 1.0 && before.dq_d[0] > 0.1, "{} {}", before.ddq_d[0], before.dq_d[0]);
    // No answer from here on, and an emulator with a command wait does not wait for ever.
    for missing in 1..=3 {
        let state = client.read();
        assert_eq!(state.robot_mode, RobotMode::Move);
        let t = f64::from(missing) * 1e-3;
        // Backward Euler: a tick's velocity is the one at its end.
        let q = before.q_d[0] + before.dq_d[0] * t + 0.5 * before.ddq_d[0] * t * (t + 1e-3);
        assert!((state.q_d[0] - q).abs() < 1e-10, "{missing}: {} {q}", state.q_d[0]);
        assert!((state.ddq_d[0] - before.ddq_d[0]).abs() < 1e-6);
    }
    emulator.operate(super::emulator::OperatorAction::UserStop);
    client.until(RobotMode::UserStopped);
    assert_eq!(client.await_answer(id), Answer::Move(MoveStatus::EmergencyAborted));
}

#[test]
fn errors_clear_when_the_arm_has_braked_and_the_mode_stays_until_recovered() {
    each_protocol(|protocol| {
        let own = limits(protocol);
        let (_emulator, mut client) = session(waiting(protocol));
        let id = push(&mut client, |now| match now {
            Push { dq, .. } if *dq > 0.5 => 40.0 * own.jerk[0],
            Push { ddq, .. } if *ddq < 0.8 * own.ddq[0] => 0.5 * own.jerk[0],
            _ => 0.0,
        });
        let first = reflex(
            &mut client,
            id,
            &[
                ErrorBit::JointMotionGeneratorVelocityDiscontinuity,
                ErrorBit::JointMotionGeneratorAccelerationDiscontinuity,
            ],
        );
        assert!(first.dq[0] > 0.3, "{}", first.dq[0]);
        while !client.state.errors.is_empty() {
            client.read();
        }
        assert_eq!(client.state.robot_mode, RobotMode::Reflex);
        assert_eq!(client.state.reflex_reason, first.reflex_reason);
        assert_eq!(client.state.dq_d, [0.0; 7]);
        let wanted = Move::new(MoveController::JointImpedance, MoveGenerator::JointPosition);
        assert_eq!(client.begin(wanted).1, Answer::Move(MoveStatus::NotPossible));
        recover(&mut client);
        let id = client.start_positions();
        let last = RobotCommand { q_c: client.state.q_d, ..RobotCommand::default() };
        assert_eq!(client.finish(id, last), Answer::Move(MoveStatus::Success));
    });
}
