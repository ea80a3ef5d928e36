// loom's atomics work only inside its model.
#![cfg(not(loom))]

use super::super::sync::act_before_access;
use super::*;
use crate::guard::GuardSettings;
use crate::recorder::{RingSink, ring};
use plumbline_core::Fault;
use std::cell::Cell;
use std::rc::Rc;
use std::sync::Arc;

/// An ideal arm: it reaches every commanded position at once.
struct Perfect(State, u32);

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

    fn stop(&mut self) {
        self.1 += 1;
    }
}

/// A loop of an arm that rests at zero.
fn resting(change: impl FnOnce(&mut CycleSettings)) -> (Cycle<Perfect, RingSink>, Handles) {
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
    let mut settings = CycleSettings { rights: Rights::NONE, ..CycleSettings::new(guard) };
    change(&mut settings);
    new(Perfect(State::default(), 0), ring(1).0, None, settings).unwrap()
}

/// A loop whose arm rests after a stop and waits for a permission.
fn stopped() -> (Cycle<Perfect, RingSink>, Handles) {
    let (mut cycle, handles) = resting(|_| ());
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

#[test]
fn a_loop_without_required_rights_stops_the_arm_before_the_first_cycle() {
    // No machine has that processor.
    let nowhere = Rights { cpu: Some(100_000), ..Rights::NONE };
    for (must, rights, refused) in [
        (true, nowhere.clone(), true),
        (true, Rights::NONE, false),
        (false, nowhere, false),
        (false, Rights::NONE, false),
    ] {
        let (mut cycle, handles) = resting(|settings| {
            (settings.must_be_realtime, settings.rights) = (must, rights.clone());
        });
        handles.controls.quit();
        let outcome = cycle.run();
        assert_eq!(outcome.end, if refused { End::NotRealTime } else { End::Quit });
        assert_eq!((cycle.backend.0.seq, cycle.backend.1), (0, 1));
        // The allocator of this program does not count.
        assert_eq!(outcome.allocations, None);
    }
}

#[test]
fn an_answered_state_is_not_reported_as_unanswered() {
    let (mut cycle, handles) = resting(|_| ());
    assert!(cycle.cycle().is_ok());
    handles.controls.quit();
    assert_eq!(cycle.run().unanswered, None);
}

#[test]
fn unused_joints_agree_with_any_value() {
    let (mut cycle, _handles) = resting(|_| ());
    let state = &mut cycle.backend.0;
    (state.q_d[0], state.q_d[5]) = (0.05, 5.0);
    assert!(cycle.cycle().is_ok());
    assert_eq!(cycle.backend.0.q[0], 0.05);
}

#[test]
fn events_without_room_are_counted_and_each_has_the_cycle_that_it_is_of() {
    let (mut cycle, mut handles) = resting(|settings| settings.queue = 1);
    // Room for 260; each order is begun and ended.
    for motion in 1..=200 {
        assert!(handles.orders.give(Order { motion, kind: OrderKind::Dwell { ticks: 1 } }).is_ok());
        for _ in 0..2 {
            assert!(cycle.cycle().is_ok());
        }
    }
    assert_eq!(cycle.tally.summary.dropped_events, 400 - 260);
    let timed: Vec<TimedEvent> = std::iter::from_fn(|| handles.events.pop().ok()).collect();
    assert_eq!(timed.len(), 260);
    for (index, timed) in timed.into_iter().enumerate() {
        let (motion, ended) = (index as u32 / 2 + 1, index % 2 == 1);
        assert_eq!(timed.event, if ended { Event::Ended { motion } } else { Event::Started { motion } });
        assert_eq!((timed.orders, timed.cycle + 1), (motion, timed.seq));
    }
}

#[test]
fn a_loop_restored_at_rest_after_a_stop_waits_for_permission() {
    use crate::checkpoint::Doing;
    for (doing, waits) in [(Doing::Stopped, true), (Doing::Hold, false), (Doing::Dwell { ticks: 5 }, false)] {
        let (mut cycle, handles) = resting(|_| ());
        let checkpoint = Checkpoint { doing, last: [Record::default(); 3], models: Default::default() };
        cycle.restore(checkpoint).unwrap();
        assert_eq!(handles.controls.is_waiting(), waits);
    }
}

#[test]
fn an_order_of_a_new_permission_runs_at_whatever_moment_of_a_cycle_both_are_given() {
    let mut access = 0;
    loop {
        let given = Rc::new(Cell::new(false));
        let giving = Rc::clone(&given);
        let (mut cycle, mut handles) = stopped();
        act_before_access(access, move || {
            giving.set(true);
            assert!(handles.controls.resume());
            assert!(handles.orders.give(Order { motion: 1, kind: OrderKind::Dwell { ticks: 5 } }).is_ok());
        });
        assert!(cycle.cycle().is_ok());
        if !given.get() {
            break;
        }
        (0..3).for_each(|_| assert!(cycle.cycle().is_ok()));
        assert_eq!((cycle.tally.summary.discarded_orders, cycle.motion.number()), (0, 1), "before access {access}");
        access += 1;
    }
    assert!(access > 4, "only {access} accesses");
}

/// A model, or a reference that rests at zero; the count shows how many exist.
struct Box0(#[allow(dead_code)] Arc<()>);

impl plumbline_core::FeedForward for Box0 {
    fn id(&self) -> u64 {
        1
    }

    fn torque(&mut self, _: &plumbline_core::Setpoint) -> plumbline_core::Torque {
        Default::default()
    }

    fn vendor_torque(&mut self, _: &JointVec) -> plumbline_core::Torque {
        Default::default()
    }
}

impl Reference for Box0 {
    fn ticks(&self) -> u64 {
        1_000
    }

    fn at(&self, _: u64) -> plumbline_core::Setpoint {
        Default::default()
    }
}

/// Fills the ring of retired boxes until `room` places are left.
fn fill(cycle: &mut Cycle<Perfect, RingSink>, room: usize) {
    while cycle.inlets.retired.slots() > room {
        assert!(cycle.inlets.retired.push(Retired::Model(Box::new(Box0(Arc::default())))).is_ok());
    }
}

#[test]
fn a_reference_waits_for_room_in_the_retired_ring_and_blocks_new_orders() {
    let of = |motion: u32, kind: OrderKind| Order { motion, kind };
    let (mut cycle, mut handles) = resting(|_| ());
    let held = Arc::new(());
    assert!(handles.orders.give(of(1, OrderKind::Follow(Box::new(Box0(Arc::clone(&held)))))).is_ok());
    (0..3).for_each(|_| assert!(cycle.cycle().is_ok()));
    fill(&mut cycle, 0);
    handles.controls.stop();
    while !handles.controls.is_waiting() {
        assert!(cycle.cycle().is_ok());
    }
    assert!(handles.controls.resume());
    assert!(handles.orders.give(of(2, OrderKind::Dwell { ticks: 5 })).is_ok());
    assert!(handles.models.serve(Box::new(Box0(Arc::default()))).is_ok());
    (0..9).for_each(|_| assert!(cycle.cycle().is_ok()));
    assert_eq!((Arc::strong_count(&held), cycle.motion.number(), cycle.torque.id()), (2, 1, 0));
    // Room on the other side is no room while the reference has not left.
    let full = handles.retired.slots();
    let freed = handles.free_retired();
    assert_eq!((freed, Arc::strong_count(&held)), (full, 2));
    assert!(!cycle.can_retire());
    (0..3).for_each(|_| assert!(cycle.cycle().is_ok()));
    assert_eq!((Arc::strong_count(&held), cycle.motion.number(), cycle.torque.id()), (2, 2, 1));
    assert_eq!((handles.free_retired(), Arc::strong_count(&held)), (1, 1));

    // An order needs a place for its reference, and one for another that may go in the same cycle.
    for (room, begins) in [(1, false), (2, true)] {
        let (mut cycle, mut handles) = resting(|_| ());
        fill(&mut cycle, room);
        assert!(handles.orders.give(of(1, OrderKind::Dwell { ticks: 5 })).is_ok());
        assert!(cycle.cycle().is_ok());
        assert_eq!(cycle.motion.number() == 1, begins);
    }
}
