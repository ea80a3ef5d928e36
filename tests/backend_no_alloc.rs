//! A simulated arm allocates nothing between its construction and its end.

mod backend_support;

use assert_no_alloc::{AllocDisabler, assert_no_alloc, violation_count};
use backend_support::{TestClock, command, excitation, sim};
use plumbline::backend::sim::{Gate, Pace, Truth};
use plumbline::rt::Backend;
use std::sync::Arc;
use std::time::Instant;

#[global_allocator]
static GUARD: AllocDisabler = AllocDisabler;

/// Every effect with a state, a memory or a search of its own, and the faults, besides those of the shipped file.
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
    let text = std::fs::read_to_string(format!("{}/config/arms/sim-panda-effect.toml", env!("CARGO_MANIFEST_DIR")));
    let mut truth = Truth::parse("shipped file and more", &(text.unwrap() + MORE)).unwrap();
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
                    Err(plumbline::rt::Fault::Disconnected)
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

#[test]
fn the_guard_sees_an_allocation() {
    let before = violation_count();
    assert_no_alloc(|| drop(std::hint::black_box(Box::new(1))));
    assert!(violation_count() > before);
}
