//! Interfaces of the loop: arm, clock, record sink, motion, torque model, kinematics.

use crate::joint::{Command, JointVec, Record, Setpoint, State, Torque};

/// Cycle period: time between two states of the arm \[s\].
pub const PERIOD_S: f64 = 1e-3;
/// Cycle period \[ns\].
pub const PERIOD_NS: u64 = 1_000_000;
/// Consecutive missing commands that an arm extrapolates at constant acceleration. One more and the arm stops by itself: the FCI's
/// `communication_constraints_violation`.
pub const MAX_MISSED_COMMANDS: u32 = 20;

/// Interface to an arm. The constructor connects to it.
pub trait Backend: Send {
    /// Number of joints of the connected arm.
    fn joints(&self) -> usize;

    /// Blocks until the next state, 1 ms after the previous one. This read paces the loop.
    fn read(&mut self) -> Result<State, Fault>;

    /// Sends the command that responds to the last state read.
    fn write(&mut self, command: &Command) -> Result<(), Fault>;

    /// Stops the motion as fast as is safe. Idempotent, callable in any state, returns no error.
    fn stop(&mut self);

    /// Deadline of the last state read, `CLOCK_MONOTONIC` \[ns\]; `None` where the arm has no deadlines.
    fn deadline_ns(&self) -> Option<u64> {
        None
    }
}

impl<B: Backend + ?Sized> Backend for Box<B> {
    fn joints(&self) -> usize {
        (**self).joints()
    }

    fn read(&mut self) -> Result<State, Fault> {
        (**self).read()
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        (**self).write(command)
    }

    fn stop(&mut self) {
        (**self).stop();
    }

    fn deadline_ns(&self) -> Option<u64> {
        (**self).deadline_ns()
    }
}

/// Clock that paces a simulated arm. The program passes the real-time clock.
pub trait Clock: Send {
    /// Time now, `CLOCK_MONOTONIC` \[ns\].
    fn now_ns(&self) -> u64;

    /// Sleeps until `ns` on the same clock; returns at once when that is past. Allocates nothing.
    fn sleep_until(&self, ns: u64);
}

/// Receiver of the loop's records.
pub trait Sink: Send {
    /// Stores one record without blocking; `false` when the buffer is full and the record was dropped.
    fn put(&mut self, record: &Record) -> bool;
}

/// Motion that can be evaluated at any of its samples.
pub trait Reference: Send {
    /// Number of samples; the last one is at rest.
    fn ticks(&self) -> u64;

    /// Setpoint `tick` ms after the start.
    fn at(&self, tick: u64) -> Setpoint;
}

/// Torque model that can be evaluated in the loop.
pub trait FeedForward: Send {
    /// Identity of the model; 0 for the absence of a model, whose torque is zero.
    fn id(&self) -> u64;

    /// Torque of the model at `desired` \[Nm\].
    fn torque(&mut self, desired: &Setpoint) -> Torque;

    /// Rigid-body torque at rest at position `q` under the gravity that the arm's own controller compensates \[Nm\].
    fn vendor_torque(&mut self, q: &JointVec) -> Torque;
}

/// Forward kinematics that the guard uses.
pub trait Kinematics: Send {
    /// Position of the end effector in the base frame \[m\].
    fn end_effector(&self, q: &JointVec) -> [f64; 3];
}

/// Fault that ends a session of a backend. `Copy`, so that it fits into a real-time ring.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// Timeout: no state arrived in time.
    #[error("no state from the arm for {waited_ms} ms")]
    Silent {
        /// How long the loop waited \[ms\].
        waited_ms: u32,
    },
    /// The arm stopped by itself.
    #[error("the arm stopped by itself (code {code})")]
    Reflex {
        /// Backend-specific reason code.
        code: u32,
    },
    /// The arm rejected a command.
    #[error("the arm refused a command (code {code})")]
    Refused {
        /// Backend-specific reason code.
        code: u32,
    },
    /// The connection was lost.
    #[error("the connection to the arm is gone")]
    Disconnected,
}
