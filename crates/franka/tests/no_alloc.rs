//! An arm allocates nothing between its construction and its end.

use assert_no_alloc::{AllocDisabler, assert_no_alloc, violation_count};
use plumbline_core::{Backend, Setpoint, State};
use plumbline_franka::wire::Protocol;
use plumbline_franka::{Interface, Purpose, RobotKind, Settings, connect, explain};
use plumbline_sim::{Gate, Pace, Truth};
use plumbline_testkit::sim::{THREE_EFFECTS, TestClock, arm_with, command, excitation, sim};
use std::sync::Arc;
use std::time::Instant;

#[global_allocator]
static GUARD: AllocDisabler = AllocDisabler;

/// Every effect with a state, a memory or a search of its own, and the faults, besides [`THREE_EFFECTS`].
const MORE: &str = "
[[effect]]
id = 'presliding'
joint = 2
elements = [{ share = 0.6, delta = 0.001 }, { share = 0.4, delta = 0.01 }]
[[effect]]
id = 'joint-elasticity'
joint = 2
stiffness = 9000
[[effect]]
id = 'backlash'
joint = 3
gap = 0.001
[[effect]]
id = 'delay'
delay = 0.0023
[[effect]]
id = 'contact'
force = [5.0, 0.0, 0.0]
from = 0.05
to = 0.4
[[effect]]
id = 'spring'
joint = 1
stiffness = 2.0
from = 0.1
[[effect]]
id = 'mounting'
tilt = [0.01, 0.0, 0.0]
[[effect]]
id = 'foreign'
form = 'beat'
joint = 1
size = 0.1
every = 1.0
";

fn truth() -> Truth {
    let mut truth = arm_with("sim-panda", &[THREE_EFFECTS, MORE].concat());
    (truth.drop_probability, truth.drop_burst) = (0.02, 2);
    (truth.outlier_probability, truth.outlier_size, truth.repeat_probability) = (0.01, 3.0, 0.02);
    truth.joints.iter_mut().for_each(|joint| joint.torque_noise_coloured = 0.05);
    truth
}

fn run(pace: Pace, ticks: u64) -> u32 {
    let mut arm = sim(&truth(), 5, pace);
    let before = violation_count();
    let mut end = Ok(());
    assert_no_alloc(|| {
        while end.is_ok() {
            end = arm.read().and_then(|state| {
                let desired = excitation(state.seq);
                if state.seq > ticks {
                    arm.stop()
                }
                if state.seq > ticks + 50 {
                    Err(plumbline_core::Fault::Disconnected)
                } else {
                    arm.write(&command(state.seq, desired))
                }
            });
        }
    });
    violation_count() - before
}

#[test]
fn the_simulated_arm_allocates_nothing() {
    assert_eq!(run(Pace::Fast(Arc::new(Gate::unlimited())), 500), 0);
    assert_eq!(run(Pace::WallClock(Box::new(TestClock(Instant::now()))), 100), 0);
}

/// Connects to an emulator and counts what reading, writing and stopping allocate, through whatever `troubles` do.
fn run_franka(
    protocol: Protocol,
    interface: Interface,
    purpose: Purpose,
    troubles: &[&str],
    silent: bool,
) -> (u32, u64, String) {
    let address = plumbline_testkit::emulator::address();
    let faults = troubles.iter().map(|text| text.parse().unwrap()).collect();
    // Two states lost in a row take twice that, and our own timeout is 100 ms.
    let command_wait = std::time::Duration::from_millis(20);
    let emulated = plumbline_testkit::emulator::Settings {
        faults,
        command_wait,
        ..plumbline_testkit::emulator::Settings::new(address, protocol)
    };
    let _emulator = plumbline_testkit::emulator::Emulator::start(emulated).unwrap();
    let robot = if protocol == Protocol::V5 { RobotKind::Panda } else { RobotKind::Fr3 };
    let settings = Settings { interface, purpose, ..Settings::new(address, robot) };
    let (mut arm, connection) = connect(&settings).unwrap();
    let before = violation_count();
    let mut cycles = 0;
    let mut end = Ok(());
    assert_no_alloc(|| {
        let mut start = None;
        while end.is_ok() && cycles < 400 {
            end = arm.read().and_then(|state: State| {
                let start = *start.get_or_insert(state.q_d);
                cycles += 1;
                let mut desired = Setpoint { q: start, ..Setpoint::default() };
                desired.q[6] += 1e-6 * (cycles as f64).powi(2);
                if silent && cycles > 200 { Ok(()) } else { arm.write(&command(state.seq, desired)) }
            });
        }
        arm.stop();
        arm.stop();
        let _ = arm.read();
    });
    let allocations = violation_count() - before;
    let words = end.err().map_or(String::new(), |fault| explain(&fault, &connection.telemetry.snapshot()).to_string());
    (allocations, cycles, words)
}

#[test]
fn a_franka_arm_allocates_nothing_whatever_happens_to_it() {
    use Interface::{JointPosition, JointVelocity, Torque};
    let trouble = ["loss=0.05,at=motion", "garbage=0.02,at=motion", "duplicate=0.05,at=motion"];
    let every_trouble = |protocol| {
        for (interface, troubles, silent) in [
            (JointPosition, &trouble[..], false),
            (JointVelocity, &[], false),
            (Torque, &[], false),
            // A reflex, a connection that is reset, and an arm that falls silent.
            (JointPosition, &[], true),
            (JointPosition, &["tcp-reset,at=motion+0.1"], false),
            (JointPosition, &["silence,at=motion+0.1"], false),
        ] {
            // Losses that are drawn may end a motion early; what counts is that a long one allocates nothing, and no other does.
            let long = (0..5).any(|_| {
                let (allocations, cycles, words) = run_franka(protocol, interface, Purpose::Drive, troubles, silent);
                assert_eq!(allocations, 0, "{protocol} {interface:?} {troubles:?}");
                eprintln!("{protocol} {interface:?} {troubles:?}: {cycles} cycles. {words}");
                cycles > 50
            });
            assert!(long, "{protocol} {interface:?} {troubles:?}: no long motion in five");
        }
        let (allocations, cycles, _) = run_franka(protocol, JointPosition, Purpose::Monitor, &[], false);
        assert_eq!((allocations, cycles), (0, 400));
    };
    // Each has an address of its own, each thread an account of its own, and most of the time all of them wait.
    std::thread::scope(|scope| {
        for protocol in Protocol::ALL {
            let every_trouble = &every_trouble;
            scope.spawn(move || every_trouble(protocol));
        }
    });
}

#[test]
fn the_guard_sees_an_allocation() {
    let before = violation_count();
    assert_no_alloc(|| drop(std::hint::black_box(Box::new(1))));
    assert!(violation_count() > before);
}
