//! A backend without dynamics: it is where the last command put it, and a script disturbs it.

pub mod drive;

use plumbline_core::{Backend, Command, Fault, JointVec, MAX_JOINTS, State};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What happens at one of the reads.
pub enum Disturbance {
    /// So many states before this one never arrive.
    Lose(u64),
    ReadFault(Fault),
    WriteFault(Fault),
    /// The counter does not advance.
    Repeat,
    /// A NaN in the measured position of a joint.
    NanPosition(usize),
    /// A measured torque \[Nm\].
    Torque(usize, f64),
    /// The measured position is this far from the commanded one \[rad\].
    Push(usize, f64),
    /// Anything else: an operator, a second thread.
    Call(Box<dyn FnMut() + Send>),
}

/// Calls of the arm, readable while the loop owns it.
#[derive(Default)]
pub struct Calls {
    pub reads: AtomicU64,
    pub writes: AtomicU64,
    pub stops: AtomicU64,
    pub writes_after_stop: AtomicU64,
}

impl Calls {
    pub fn get(&self) -> (u64, u64, u64, u64) {
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        (get(&self.reads), get(&self.writes), get(&self.stops), get(&self.writes_after_stop))
    }
}

/// An arm without dynamics: it is at once where it is commanded. Disturbances are scripted by the number of the read, counted from 0.
pub struct FakeArm {
    joints: usize,
    state: State,
    script: Vec<(u64, Disturbance)>,
    write_fault: Option<Fault>,
    pub calls: Arc<Calls>,
}

impl FakeArm {
    pub fn new(joints: usize, start: JointVec) -> FakeArm {
        let state = State { seq: 1000, q: start, q_d: start, ..State::default() };
        FakeArm { joints, state, script: Vec::new(), write_fault: None, calls: Arc::default() }
    }

    pub fn at(mut self, read: u64, disturbance: Disturbance) -> FakeArm {
        self.script.push((read, disturbance));
        self
    }

    /// The arm's own desired position differs from where it is.
    pub fn with_desired(mut self, q_d: JointVec) -> FakeArm {
        self.state.q_d = q_d;
        self
    }
}

impl Backend for FakeArm {
    fn joints(&self) -> usize {
        self.joints
    }

    fn read(&mut self) -> Result<State, Fault> {
        let read = self.calls.reads.fetch_add(1, Ordering::Relaxed);
        let mut advance = 1;
        let mut out = self.state;
        self.write_fault = None;
        for (_, disturbance) in self.script.iter_mut().filter(|(at, _)| *at == read) {
            match disturbance {
                Disturbance::Lose(count) => advance += *count,
                Disturbance::ReadFault(fault) => return Err(*fault),
                Disturbance::WriteFault(fault) => self.write_fault = Some(*fault),
                Disturbance::Repeat => advance = 0,
                Disturbance::NanPosition(joint) => out.q[*joint] = f64::NAN,
                Disturbance::Torque(joint, value) => out.tau[*joint] = *value,
                Disturbance::Push(joint, distance) => out.q[*joint] += *distance,
                Disturbance::Call(call) => call(),
            }
        }
        self.state.seq += advance;
        self.state.time += 1e-3 * advance as f64;
        (out.seq, out.time) = (self.state.seq, self.state.time);
        Ok(out)
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        self.calls.writes.fetch_add(1, Ordering::Relaxed);
        if self.calls.stops.load(Ordering::Relaxed) > 0 {
            self.calls.writes_after_stop.fetch_add(1, Ordering::Relaxed);
        }
        assert_eq!(command.seq, self.state.seq, "a command answers the state read last");
        if let Some(fault) = self.write_fault {
            return Err(fault);
        }
        for j in 0..MAX_JOINTS {
            self.state.dq[j] = (command.desired.q[j] - self.state.q[j]) / 1e-3;
        }
        (self.state.q, self.state.q_d) = (command.desired.q, command.desired.q);
        Ok(())
    }

    fn stop(&mut self) {
        self.calls.stops.fetch_add(1, Ordering::Relaxed);
    }
}
