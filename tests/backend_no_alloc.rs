//! A simulated arm allocates nothing between its construction and its end.

mod backend_support;

use assert_no_alloc::{AllocDisabler, assert_no_alloc, violation_count};
use backend_support::{TestClock, arm_file, command, excitation, sim};
use plumbline::backend::sim::{Gate, Pace};
use plumbline::rt::Backend;
use std::sync::Arc;
use std::time::Instant;

#[global_allocator]
static GUARD: AllocDisabler = AllocDisabler;

fn run(pace: Pace, ticks: u64) -> u32 {
    let mut truth = arm_file("sim-panda-effect.toml");
    (truth.drop_probability, truth.drop_burst) = (0.02, 2);
    let mut arm = sim(&truth, 5, pace);
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
