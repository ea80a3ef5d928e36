use super::*;
use plumbline_core::{Command, Fault, JointVec, Limits, MAX_JOINTS, Phase, State};
use plumbline_ipc::now_ns;
use plumbline_rt::cycle::{self, End};
use plumbline_rt::{CycleSettings, GuardSettings, Order, OrderKind, os, recorder};
use std::sync::{Arc, Mutex};

/// An ideal arm with one state per millisecond; its last commanded velocities outlive it.
struct Follows {
    state: State,
    dq: Arc<Mutex<JointVec>>,
}

impl Backend for Follows {
    fn joints(&self) -> usize {
        1
    }

    fn read(&mut self) -> Result<State, Fault> {
        os::sleep_until(now_ns() + 1_000_000);
        self.state.seq += 1;
        Ok(self.state)
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        self.state.q = command.desired.q;
        *self.dq.lock().unwrap() = command.desired.dq;
        Ok(())
    }

    fn stop(&mut self) {}
}

#[test]
fn after_a_panic_of_the_bridge_thread_the_loop_brakes_before_it_ends() {
    let of = |value: f64| [value; MAX_JOINTS];
    let (q_min, q_max, dq, ddq) = (of(-1.0), of(1.0), of(0.2), of(1.0));
    let limits = Limits { q_min, q_max, dq, ddq, jerk: of(100.0), tau: of(10.0), dtau: of(100.0) };
    let guard = GuardSettings { limits, envelope: None, workspace: None, tracking: of(0.1) };
    let settings = CycleSettings { rights: Rights::NONE, ..CycleSettings::new(guard) };
    let dq = Arc::new(Mutex::new(JointVec::default()));
    let arm = Follows { state: State::default(), dq: Arc::clone(&dq) };
    let (mut cycle, mut handles) = cycle::new(arm, recorder::ring(RING).0, None, settings).unwrap();
    let kind = OrderKind::MoveTo { target: of(0.9), phase: Phase::Approach };
    assert!(handles.orders.give(Order { motion: 1, kind }).is_ok());
    let controls = Arc::clone(&handles.controls);
    let thread = std::thread::spawn(move || run_to_end(&mut cycle));
    let message = catch_panic(&controls, || {
        while dq.lock().unwrap()[0] < 0.01 {
            assert!(!thread.is_finished(), "the loop ended before the fault");
            std::thread::sleep(Duration::from_millis(1));
        }
        panic!("a fault of the test");
    });
    assert_eq!(message.unwrap_err(), "a fault of the test");
    await_end(&thread, None);
    assert!(thread.is_finished(), "the loop goes on");
    let LoopEnd::Ended(outcome) = thread.join().unwrap() else { panic!("the loop panicked, too") };
    assert_eq!((outcome.end, outcome.stops), (End::Quit, 1));
    assert_eq!(*dq.lock().unwrap(), JointVec::default(), "the arm is at rest");
}
