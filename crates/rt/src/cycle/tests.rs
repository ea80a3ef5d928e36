use super::super::sync::act_before_access;
use super::*;
use crate::guard::GuardSettings;
use crate::recorder::{RingSink, ring};
use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;

/// An arm that is at once where it is told to be.
struct Perfect(State);

impl Backend for Perfect {
    fn joints(&self) -> usize {
        1
    }

    fn read(&mut self) -> Result<State, Fault> {
        self.0.seq += 1;
        Ok(self.0)
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        self.0.q = command.desired.q;
        Ok(())
    }

    fn stop(&mut self) {}
}

/// A loop whose arm rests after a stop and waits for a permission.
fn stopped() -> (Cycle<Perfect, RingSink>, Handles) {
    let of = |value: f64| [value; MAX_JOINTS];
    let limits = plumbline_core::Limits {
        q_min: of(-1.0),
        q_max: of(1.0),
        dq: of(1.0),
        ddq: of(10.0),
        jerk: of(1000.0),
        tau: of(10.0),
        dtau: of(100.0),
    };
    let guard = GuardSettings { limits, envelope: None, workspace: None, tracking: of(0.1) };
    let settings = CycleSettings { rights: Rights::NONE, ..CycleSettings::new(guard) };
    let (mut cycle, handles) = new(Perfect(State::default()), ring(1).0, None, settings).unwrap();
    assert!(cycle.cycle().is_ok());
    handles.controls.stop();
    while !handles.controls.is_waiting() {
        assert!(cycle.cycle().is_ok());
    }
    (cycle, handles)
}

#[test]
fn a_stop_that_follows_a_permission_holds_at_whatever_moment_of_a_cycle_both_are_given() {
    let mut access = 0;
    loop {
        let given = Rc::new(Cell::new(false));
        let giving = Rc::clone(&given);
        let (mut cycle, mut handles) = stopped();
        let controls = Arc::clone(&handles.controls);
        act_before_access(access, move || {
            giving.set(true);
            assert!(controls.resume());
            controls.stop();
        });
        assert!(cycle.cycle().is_ok());
        if !given.get() {
            // A cycle has no more accesses than that: every moment has been tried.
            break;
        }
        let target = [0.5; MAX_JOINTS];
        let kind = OrderKind::MoveTo { target, phase: plumbline_core::Phase::Approach };
        assert!(handles.orders.give(Order { motion: 1, kind }).is_ok());
        for _ in 0..50 {
            assert!(cycle.cycle().is_ok());
        }
        assert!(cycle.motion.is_stopped(), "before access {access}");
        assert_eq!(cycle.backend.0.q, JointVec::default(), "before access {access}");
        access += 1;
    }
    assert!(access > 4, "only {access} accesses");
}
