//! The adapter against the emulator: the promises of every arm at every version, an excitation through the whole loop, and what goes wrong on
//! networks and with people, each ended or overcome as it should be.

use nalgebra::Vector3;
use plumbline_core::{Backend, Command, Fault, FeedForward, JointVec, Setpoint, State, Torque};
use plumbline_franka::wire::{MoveStatus, Protocol, RobotMode};
use plumbline_franka::{
    ConnectError, Connection, FrankaArm, Interface, RobotKind, Settings, Source, connect, explain, recover,
};
use plumbline_model::{Chain, LinkParameters, Mounting, rnea};
use plumbline_rt::cycle::End;
use plumbline_testkit::conformance::conformance;
use plumbline_testkit::emulator::{Emulator, Fault as NetworkFault, Settings as Emulated, address};
use plumbline_testkit::franka_loop::{Run, drive, drive_serving, drive_with_retries, plan, quick_plan};
use std::time::{Duration, Instant};

#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

fn start(emulated: Emulated) -> (Emulator, Settings) {
    let robot = if emulated.protocol == Protocol::V5 { RobotKind::Panda } else { RobotKind::Fr3 };
    // A loaded test machine can stand still for 100 ms.
    let settings = Settings { state_timeout: Duration::from_millis(500), ..Settings::new(emulated.address, robot) };
    (Emulator::start(emulated).unwrap_or_else(|error| panic!("{error}")), settings)
}

/// A robot whose time waits for us through a stall of this machine, but ends a motion when nothing comes.
fn waiting(protocol: Protocol) -> Emulated {
    Emulated { command_wait: Duration::from_millis(10), ..Emulated::new(address(), protocol) }
}

/// Connects again where the robot has not noticed yet that the last client left.
fn open(settings: &Settings) -> (FrankaArm, Connection) {
    let deadline = Instant::now() + Duration::from_secs(2);
    loop {
        match connect(settings) {
            Ok(open) => return open,
            Err(ConnectError::Closed { .. } | ConnectError::Mode { .. }) if Instant::now() < deadline => {
                // The conformance suite leaves an arm in a reflex where it is silent on purpose.
                let _ = recover(settings);
                std::thread::sleep(Duration::from_millis(20));
            }
            Err(error) => panic!("{error}"),
        }
    }
}

/// Each case has a robot of its own and keeps wall-clock time: they need not wait for one another.
fn side_by_side<T: Sync>(cases: &[T], check: impl Fn(&T) + Sync) {
    std::thread::scope(|scope| cases.iter().for_each(|case| drop(scope.spawn(|| check(case)))));
}

#[test]
fn it_keeps_the_promises_of_every_arm_at_every_version() {
    side_by_side(&Protocol::ALL, |&protocol| {
        for interface in [Interface::JointPosition, Interface::JointVelocity] {
            eprintln!("{protocol} {interface:?}");
            let (_emulator, settings) = start(waiting(protocol));
            let settings = Settings { interface, ..settings };
            conformance(|| open(&settings).0);
        }
    });
}

/// The emulator's own view is a moment behind the state that it sent.
fn assert_idle(emulator: &Emulator, protocol: Protocol) {
    let deadline = Instant::now() + Duration::from_millis(500);
    while emulator.snapshot().state.robot_mode != RobotMode::Idle {
        assert!(Instant::now() < deadline, "{protocol}: {:?}", emulator.snapshot().state.robot_mode);
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn hold(arm: &mut FrankaArm, start: &State, last: &State) -> Result<State, Fault> {
    arm.write(&Command {
        seq: last.seq,
        desired: Setpoint { q: start.q_d, ..Setpoint::default() },
        ..Command::default()
    })?;
    arm.read()
}

#[test]
fn the_torque_interface_holds_the_arm_against_gravity_that_the_robot_carries() {
    for protocol in Protocol::ALL {
        let (emulator, settings) = start(waiting(protocol));
        let (mut arm, connection) = open(&Settings { interface: Interface::Torque, ..settings });
        let start = arm.read().unwrap();
        let mut last = start;
        for _ in 0..1500 {
            last = hold(&mut arm, &start, &last)
                .unwrap_or_else(|fault| panic!("{protocol}: {}", explain(&fault, &connection.telemetry.snapshot())));
        }
        assert!((0..7).all(|j| (last.q[j] - start.q[j]).abs() < 0.02), "{protocol}: {:?} from {:?}", last.q, start.q);
        arm.stop();
        assert_idle(&emulator, protocol);
        assert_eq!(connection.telemetry.snapshot().status(), Some(MoveStatus::Success), "{protocol}");
    }
}

/// What the emulated arm's links need, gravity included, by another route than its own dynamics.
struct Links {
    chain: Chain,
    links: Vec<LinkParameters>,
    gravity: Vector3<f64>,
    vendor: Vector3<f64>,
    /// Whether the torque of the motion is part of it, beside gravity's.
    moving: bool,
}

impl FeedForward for Links {
    fn id(&self) -> u64 {
        1
    }

    fn torque(&mut self, desired: &Setpoint) -> Torque {
        let mut torque = Torque::default();
        let [dq, ddq] = [desired.dq, desired.ddq].map(|rate| if self.moving { rate } else { [0.0; 8] });
        rnea(&self.chain, &self.links, &self.gravity, &desired.q, &dq, &ddq, &mut torque.0);
        torque
    }

    fn vendor_torque(&mut self, q: &JointVec) -> Torque {
        let mut torque = Torque::default();
        rnea(&self.chain, &self.links, &self.vendor, q, &[0.0; 8], &[0.0; 8], &mut torque.0);
        torque
    }
}

#[test]
fn the_served_model_helps_the_torque_interface_and_makes_up_for_what_the_arm_compensates() {
    let mounting = Mounting::WALL;
    let (emulator, settings) = start(Emulated { mounting, ..waiting(Protocol::V5) });
    let settings = Settings { interface: Interface::Torque, ..settings };
    let tracking = |moving: bool| {
        let robot = plumbline_model::Robot::load("panda", None).unwrap();
        let truth = plumbline_testkit::sim::arm("sim-panda");
        let (arm, connection) = open(&settings);
        // The arm compensates as if it were upright.
        let vendor = Vector3::from(connection.info.compensates);
        let links = truth.link_parameters();
        let links = Links { chain: robot.chain, links, gravity: mounting.gravity(), vendor, moving };
        let run = drive_serving(arm, connection, &quick_plan(0.3), Duration::from_secs(60), Some(Box::new(links)));
        assert_in_order(&run, &emulator, Protocol::V5);
        run.tracking()
    };
    let (alone, served) = (tracking(false), tracking(true));
    eprintln!("tracking with gravity alone and with the whole model: {alone:?} {served:?}");
    let sum = |rms: [f64; 7]| rms.iter().sum::<f64>();
    // What is left is friction, which these links know nothing of.
    assert!(sum(served) < 0.8 * sum(alone), "{alone:?} {served:?}");
    // A wrong remainder of gravity would push the shoulder away by some 20 Nm over 600 Nm/rad.
    assert!(served.iter().all(|rms| *rms < 0.02), "{served:?}");
}

fn assert_in_order(run: &Run, emulator: &Emulator, protocol: Protocol) {
    assert!(run.ended && run.outcome.end == End::Quit, "{protocol}: {}", run.describe());
    let statistics = &run.statistics;
    assert_eq!((statistics.reflex().to_string(), statistics.status()), ("none".into(), Some(MoveStatus::Success)));
    assert_eq!(run.outcome.allocations, Some(0), "{protocol}");
    assert_idle(emulator, protocol);
    eprintln!(
        "{protocol}: {} cycles, lost {}, skipped {}, late {}, returning {}, limited {}, unexplained {}, rate {:?}, work {:?}, wake {:?}, round \
         trip {:?}",
        run.outcome.summary.cycles,
        statistics.lost,
        statistics.skipped,
        statistics.late_commands,
        statistics.returning,
        statistics.limited,
        statistics.unexplained_points,
        statistics.success_rate,
        statistics.work,
        statistics.wake,
        statistics.round_trip
    );
}

#[test]
fn a_whole_excitation_runs_through_the_loop_without_a_reflex_and_without_an_allocation() {
    side_by_side(&Protocol::ALL, |&protocol| {
        let (emulator, settings) = start(waiting(protocol));
        let share = if protocol == Protocol::V5 { 0.9 } else { 0.5 };
        let run = drive(&settings, &plan(share), Duration::from_secs(60)).unwrap();
        assert_in_order(&run, &emulator, protocol);
        // Nothing was lost on the way, so the arm was where our history says in every cycle, in single precision too.
        assert_eq!((run.statistics.unexplained_points, run.statistics.limited), (0, 0), "{protocol}");
        assert!(run.tracking().iter().all(|rms| *rms < 0.01), "{protocol}: {:?}", run.tracking());
    });
}

#[test]
fn a_bad_network_costs_a_way_back_and_no_discontinuity() {
    let cases = [
        (Protocol::V5, ["loss=0.05", "duplicate=0.1"]),
        (Protocol::V9, ["garbage=0.03", "truncate=0.03"]),
        (Protocol::V10, ["loss=0.1", "jitter=0.001"]),
    ];
    side_by_side(&cases, |&(protocol, texts)| {
        let faults = texts.iter().map(|text| format!("{text},at=motion").parse::<NetworkFault>().unwrap()).collect();
        let command_wait = Duration::from_millis(5);
        let (emulator, settings) = start(Emulated { faults, command_wait, ..waiting(protocol) });
        // The lost commands of the case beside a stall of this machine are more than a robot allows.
        let run = drive_with_retries(&settings, &quick_plan(0.2), Duration::from_secs(120), 6);
        assert_in_order(&run, &emulator, protocol);
        let statistics = &run.statistics;
        assert!(
            statistics.lost + statistics.late_commands > 100 && statistics.returning > 100,
            "{protocol}: {statistics:?}"
        );
        match protocol {
            Protocol::V5 => assert!(statistics.duplicates > 100, "{statistics:?}"),
            Protocol::V9 => assert!(statistics.bad_packets > 100, "{statistics:?}"),
            Protocol::V10 => assert!(statistics.lost > 500, "{statistics:?}"),
        }
    });
}

#[test]
fn the_direction_of_gravity_is_the_arms_own_word_or_what_its_sensors_show() {
    for (protocol, mounting) in
        [(Protocol::V5, Mounting::WALL), (Protocol::V10, Mounting::WALL), (Protocol::V10, Mounting::CEILING)]
    {
        let (_emulator, settings) = start(Emulated { mounting, ..waiting(protocol) });
        let (_, connection) = open(&settings);
        let gravity = connection.info.gravity.expect("the arm is at rest");
        let truth = mounting.gravity().normalize();
        if protocol == Protocol::V5 {
            assert_eq!((gravity.source, gravity.direction), (Source::Base, [0.0, 0.0, -1.0]));
        } else {
            assert_eq!(gravity.source, Source::Accelerometers, "{gravity:?}");
            let cosine: f64 = gravity.direction.iter().zip(truth.iter()).map(|(a, b)| a * b).sum();
            assert!(cosine > 0.999 && gravity.spread < 0.2, "{gravity:?} {truth:?}");
        }
        assert_eq!(gravity.base, [0.0, 0.0, -1.0], "robots report this wherever they hang");
    }
}
