//! Motions that a robot carries out, from the first state to the last answer.

use super::client::{Answer, knock};
use super::emulator::READY;
use super::{address, each_protocol, session, waiting};
use plumbline_franka::wire::{
    ConnectStatus, ControllerMode, MotionGeneratorMode, Move, MoveController, MoveGenerator, MoveStatus, Protocol,
    Request, RobotCommand, RobotMode, StopStatus,
};
use plumbline_testkit::emulator::{Emulator, Settings};

/// A quintic from 0 to 1 in 1 s, at rest at both ends.
fn quintic(s: f64) -> f64 {
    let s = s.clamp(0.0, 1.0);
    s * s * s * (10.0 + s * (6.0 * s - 15.0))
}

const TICKS: u32 = 400;

fn away(tick: u32) -> [f64; 7] {
    let share = quintic(f64::from(tick) / f64::from(TICKS));
    std::array::from_fn(|j| READY[j] + if j % 2 == 0 { 0.06 } else { -0.06 } * share)
}

#[test]
fn states_come_each_millisecond_and_show_an_idle_arm() {
    each_protocol(|protocol| {
        let (emulator, mut client) = session(Settings::new(address(), protocol));
        let first = client.read();
        for k in 1..=300 {
            assert_eq!(client.read().message_id, first.message_id + k);
        }
        let state = client.state;
        assert_eq!(state.robot_mode, RobotMode::Idle);
        assert_eq!(
            (state.motion_generator_mode, state.controller_mode),
            (MotionGeneratorMode::Idle, ControllerMode::Other)
        );
        assert!(state.errors.is_empty() && state.reflex_reason.is_empty());
        assert_eq!(state.control_command_success_rate, 0.0);
        for (j, ready) in READY.iter().enumerate() {
            assert!((state.q[j] - ready).abs() < 2e-3 && (state.q_d[j] - ready).abs() < 1e-6, "joint {}", j + 1);
        }
        // The pose that Franka's documentation shows for a Panda that is ready: the flange half a metre up, 0.3 m in front.
        assert!((state.o_t_ee[12] - 0.307).abs() < 0.01 && state.o_t_ee[13].abs() < 0.01, "{:?}", state.o_t_ee);
        assert_eq!(state.o_ddp_o.map(|value| (value * 100.0).round()), [0.0, 0.0, -981.0]);
        assert_eq!(emulator.snapshot().counts.refused, 0);
    });
}

/// As libfranka's examples since 0.21 do, whose first position is the measured one.
#[test]
fn a_motion_may_begin_at_the_measured_position() {
    each_protocol(|protocol| {
        let (_emulator, mut client) = session(waiting(protocol));
        // What this arm measures at rest, and up to what a real one is off by: some of it would be a legal step, most would not.
        for off in [None, Some(1e-6), Some(4e-6), Some(1e-5), Some(1e-4), Some(1.5e-3)] {
            let id = client.start_positions();
            let (q, q_d) = (client.state.q, client.state.q_d);
            let start: [f64; 7] = std::array::from_fn(|j| match off {
                None => q[j],
                Some(off) => q_d[j] + if j % 2 == 0 { off } else { -off },
            });
            let goal = |tick: u32| start.map(|q| q + 0.03 * quintic(f64::from(tick) / f64::from(TICKS)));
            for tick in 0..=TICKS {
                client.step_to(goal(tick));
                assert_eq!(client.state.robot_mode, RobotMode::Move, "{off:?}, {tick}: {}", client.state.reflex_reason);
                if tick == 0 {
                    // No velocity but what a legal step has.
                    assert!(client.state.dq_d.iter().all(|dq| dq.abs() < 0.01), "{off:?}: {:?}", client.state.dq_d);
                }
            }
            let last = RobotCommand { q_c: goal(TICKS), ..RobotCommand::default() };
            assert_eq!(client.finish(id, last), Answer::Move(MoveStatus::Success), "{off:?}");
            client.until(RobotMode::Idle);
        }
    });
}

/// Torques from the client beside positions from the client: both are judged, the torques move the arm, and the flag of the motion
/// generator ends it.
#[test]
fn torques_run_beside_a_motion_generator() {
    each_protocol(|protocol| {
        let (_emulator, mut client) = session(waiting(protocol));
        let id = client.start(MoveController::External, MoveGenerator::JointPosition);
        let (start, goal) = (client.state.q, client.state.q_d);
        let mut q_d = goal;
        for tick in 0..200 {
            q_d[6] = goal[6] + 0.02 * quintic(f64::from(tick) / 200.0);
            client.write(RobotCommand { q_c: q_d, ..RobotCommand::default() });
            client.read();
            assert_eq!(client.state.robot_mode, RobotMode::Move, "{}", client.state.reflex_reason);
        }
        assert!((client.state.q_d[6] - q_d[6]).abs() < 1e-6);
        assert!((client.state.q[6] - start[6]).abs() < 5e-3, "no torque, no motion");
        let last = RobotCommand { q_c: q_d, motion_generation_finished: true, ..RobotCommand::default() };
        while client.state.robot_mode == RobotMode::Move {
            client.write(last);
            client.read();
        }
        assert_eq!(client.await_answer(id), Answer::Move(MoveStatus::Success));
    });
}

#[test]
fn a_stop_is_answered_twice_and_leaves_the_arm_idle() {
    each_protocol(|protocol| {
        let (_emulator, mut client) = session(waiting(protocol));
        // Nothing to stop: libfranka's Python examples ask for it after a motion that has ended by itself.
        assert_eq!(client.ask(Request::StopMove), Answer::StopMove(StopStatus::Success));
        let id = client.start_positions();
        for tick in 0..TICKS / 2 {
            client.step_to(away(tick));
        }
        let moving = client.state.dq_d[0];
        assert!(moving > 0.2, "{moving}");
        let stop = client.call(Request::StopMove);
        // Nobody commands any more, and the robot does not mind.
        assert_eq!(client.await_answer(stop), Answer::StopMove(StopStatus::Success));
        assert_eq!(client.await_answer(id), Answer::Move(MoveStatus::Preempted));
        let state = client.until(RobotMode::Idle);
        assert_eq!(state.dq_d, [0.0; 7]);
        assert!(state.reflex_reason.is_empty());
    });
}

#[test]
fn what_a_robot_has_and_this_one_has_not_is_not_possible() {
    each_protocol(|protocol| {
        let (_emulator, mut client) = session(waiting(protocol));
        let refused = Answer::Move(MoveStatus::NotPossible);
        for generator in [MoveGenerator::CartesianPose, MoveGenerator::CartesianVelocity] {
            assert_eq!(client.begin(Move::new(MoveController::JointImpedance, generator)).1, refused);
        }
        if protocol == Protocol::V10 {
            let wanted = Move::new(MoveController::JointImpedance, MoveGenerator::JointPosition);
            assert_eq!(client.begin(Move { use_async: true, ..wanted }).1, refused);
        }
        if protocol.has_torque_only() {
            let wanted = Move::new(MoveController::JointImpedance, MoveGenerator::None);
            assert_eq!(client.begin(wanted).1, Answer::Move(MoveStatus::InvalidArgument));
        }
        let mut wanted = Move::new(MoveController::JointImpedance, MoveGenerator::JointPosition);
        wanted.max_path_deviation.rotation = f64::NAN;
        assert_eq!(client.begin(wanted).1, Answer::Move(MoveStatus::InvalidArgument));
        assert_eq!(client.state.robot_mode, RobotMode::Idle);
    });
}

#[test]
fn other_versions_are_told_this_one() {
    each_protocol(|protocol| {
        let address = address();
        let _emulator = Emulator::start(Settings::new(address, protocol)).expect("an emulator");
        for version in [0, 3, 4, 5, 6, 9, 10, 11, u16::MAX] {
            let (connected, ..) = knock(address, version);
            let fits = version == protocol.number();
            let status = if fits { ConnectStatus::Success } else { ConnectStatus::IncompatibleVersion };
            assert_eq!((connected.status, connected.version), (status, protocol.number()), "{version}");
        }
    });
}
