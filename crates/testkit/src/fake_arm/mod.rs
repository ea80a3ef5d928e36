//! What whole-part tests share. Every test binary uses its own part of it.

pub mod drive;

use plumbline_core::{Backend, Command, Fault, JointVec, MAX_JOINTS, State};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Something that happens to the arm at one of its reads.
pub enum Trick {
    /// So many states before this one never arrive.
    Lose(u64),
    ReadFault(Fault),
    WriteFault(Fault),
    /// The counter stands still.
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

/// What the arm has seen, readable while the loop owns it.
#[derive(Default)]
pub struct Seen {
    pub reads: AtomicU64,
    pub writes: AtomicU64,
    pub stops: AtomicU64,
    pub writes_after_stop: AtomicU64,
}

impl Seen {
    pub fn get(&self) -> (u64, u64, u64, u64) {
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        (get(&self.reads), get(&self.writes), get(&self.stops), get(&self.writes_after_stop))
    }
}

/// A perfect arm: it is at once where it is told to be. Tricks are scripted by the number of the read, counted from 0.
pub struct FakeArm {
    joints: usize,
    state: State,
    script: Vec<(u64, Trick)>,
    write_fault: Option<Fault>,
    pub seen: Arc<Seen>,
}

impl FakeArm {
    pub fn new(joints: usize, start: JointVec) -> FakeArm {
        let state = State { seq: 1000, q: start, q_d: start, ..State::default() };
        FakeArm { joints, state, script: Vec::new(), write_fault: None, seen: Arc::default() }
    }

    pub fn at(mut self, read: u64, trick: Trick) -> FakeArm {
        self.script.push((read, trick));
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
        let read = self.seen.reads.fetch_add(1, Ordering::Relaxed);
        let mut advance = 1;
        let mut out = self.state;
        self.write_fault = None;
        for (_, trick) in self.script.iter_mut().filter(|(at, _)| *at == read) {
            match trick {
                Trick::Lose(count) => advance += *count,
                Trick::ReadFault(fault) => return Err(*fault),
                Trick::WriteFault(fault) => self.write_fault = Some(*fault),
                Trick::Repeat => advance = 0,
                Trick::NanPosition(joint) => out.q[*joint] = f64::NAN,
                Trick::Torque(joint, value) => out.tau[*joint] = *value,
                Trick::Push(joint, distance) => out.q[*joint] += *distance,
                Trick::Call(call) => call(),
            }
        }
        self.state.seq += advance;
        self.state.time += 1e-3 * advance as f64;
        (out.seq, out.time) = (self.state.seq, self.state.time);
        Ok(out)
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        self.seen.writes.fetch_add(1, Ordering::Relaxed);
        if self.seen.stops.load(Ordering::Relaxed) > 0 {
            self.seen.writes_after_stop.fetch_add(1, Ordering::Relaxed);
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
        self.seen.stops.fetch_add(1, Ordering::Relaxed);
    }
}
