//! Every arm keeps the promises of the trait, and the suite that says so can fail.

use plumbline_core::{Backend, Command, Fault, State};
use plumbline_sim::{Gate, Pace};
use plumbline_testkit::conformance::conformance;
use plumbline_testkit::sim::{READY, THREE_EFFECTS, TestClock, arm, arm_with, sim};
use std::sync::Arc;
use std::time::Instant;

#[test]
fn simulated_arm_at_full_speed() {
    conformance(|| sim(&arm("sim-panda"), 1, Pace::Fast(Arc::new(Gate::unlimited()))));
}

#[test]
fn simulated_arm_on_the_wall_clock() {
    // A machine that is busy with other tests stalls for longer than a robot waits.
    let clock = || Pace::WallClock(Box::new(TestClock(Instant::now())));
    conformance(|| sim(&arm("sim-panda"), 2, clock()).with_max_missed(1000));
}

#[test]
fn simulated_arm_that_loses_states() {
    let mut truth = arm("sim-panda");
    (truth.drop_probability, truth.drop_burst) = (0.02, 3);
    conformance(|| sim(&truth, 3, Pace::Fast(Arc::new(Gate::unlimited()))));
}

#[test]
fn simulated_arm_with_effects() {
    conformance(|| sim(&arm_with("sim-panda", THREE_EFFECTS), 4, Pace::Fast(Arc::new(Gate::unlimited()))));
}

/// What a fake arm does wrong.
#[derive(Clone, Copy, PartialEq)]
enum Defect {
    Nothing,
    SeqStandsStill,
    Drifts,
    TakesNan,
    StaysBehind,
    RunsOnAfterStop,
}

/// An arm that is always exactly where it was sent, but for its fault.
struct Fake {
    fault: Defect,
    state: State,
    step: [f64; 7],
    stopped: bool,
}

impl Fake {
    fn new(fault: Defect) -> Fake {
        let state = State { q: READY, q_d: READY, ..State::default() };
        Fake { fault, state, step: [0.0; 7], stopped: false }
    }
}

impl Backend for Fake {
    fn joints(&self) -> usize {
        7
    }

    fn read(&mut self) -> Result<State, Fault> {
        if self.fault != Defect::SeqStandsStill {
            self.state.seq += 1;
        }
        self.state.time = self.state.seq as f64 * 1e-3;
        if self.fault == Defect::Drifts {
            self.state.q[2] += 1e-5;
        }
        if self.stopped && self.fault == Defect::RunsOnAfterStop {
            for (q, step) in self.state.q.iter_mut().zip(self.step) {
                *q += step;
            }
        }
        Ok(self.state)
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        let q = command.desired.q;
        if self.fault != Defect::TakesNan && q.iter().any(|value| !value.is_finite()) {
            return Err(Fault::Refused { code: 1 });
        }
        if q.iter().all(|value| value.is_finite()) && !self.stopped {
            self.step = std::array::from_fn(|j| q[j] - self.state.q_d[j]);
            self.state.q_d = q;
            if self.fault == Defect::StaysBehind {
                self.state.q = std::array::from_fn(|j| self.state.q[j] + 0.005 * (q[j] - self.state.q[j]));
            } else if self.fault != Defect::Drifts {
                self.state.q = q;
            }
        }
        Ok(())
    }

    fn stop(&mut self) {
        self.stopped = true;
    }
}

#[test]
fn a_perfect_fake_arm_passes() {
    conformance(|| Fake::new(Defect::Nothing));
}

#[test]
fn the_suite_finds_every_broken_promise() {
    let broken = [
        (Defect::SeqStandsStill, "seq went from"),
        (Defect::Drifts, "holding still"),
        (Defect::TakesNan, "NaN was accepted"),
        (Defect::StaysBehind, "following"),
        (Defect::RunsOnAfterStop, "at rest after a stop"),
    ];
    for (fault, says) in broken {
        let panic = std::panic::catch_unwind(|| conformance(|| Fake::new(fault))).expect_err(says);
        let message = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
        assert!(message.is_some_and(|message| message.contains(says)), "expected `{says}`, got {message:?}");
    }
}
