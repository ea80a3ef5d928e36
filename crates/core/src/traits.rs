//! What the parts around the loop are to it: an arm, a motion, a torque model, kinematics, a place for records.

use crate::joint::{Command, JointVec, Record, Setpoint, State, Torque};

/// Time between two states of the arm \[s\].
pub const PERIOD_S: f64 = 1e-3;
/// The same \[ns\].
pub const PERIOD_NS: u64 = 1_000_000;
/// Commands in a row that an arm goes on without, at constant acceleration, before it stops by itself: the FCI's
/// `communication_constraints_violation`.
pub const MAX_MISSED_COMMANDS: u32 = 20;

/// The hardware seam. Connecting is the constructor's business.
pub trait Backend: Send {
    /// Number of joints of the connected arm.
    fn joints(&self) -> usize;

    /// Blocks until the next state (1 ms after the last), so that the hardware paces the loop.
    fn read(&mut self) -> Result<State, Fault>;

    /// Sends the command that answers the state read last.
    fn write(&mut self, command: &Command) -> Result<(), Fault>;

    /// Ends the motion as fast as is safe. Idempotent, callable in any state, and silent: there is no one left to tell.
    fn stop(&mut self);

    /// Deadline of the state read last, `CLOCK_MONOTONIC` \[ns\]; `None` where the arm has none.
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

/// A clock that an arm without hardware is paced by; the program passes in the real-time one.
pub trait Clock: Send {
    /// Time now, `CLOCK_MONOTONIC` \[ns\].
    fn now_ns(&self) -> u64;

    /// Returns at `ns` on the same clock, at once when that is past. Allocates nothing.
    fn sleep_until(&self, ns: u64);
}

/// Where the loop puts its records; `false` says that there was no room and the record is lost.
pub trait Sink: Send {
    /// Takes one record without blocking.
    fn put(&mut self, record: &Record) -> bool;
}

/// A motion that can be asked for any of its samples.
pub trait Reference: Send {
    /// Number of samples, the last of which is at rest.
    fn ticks(&self) -> u64;

    /// Sample `tick` at `tick` ms after the start.
    fn at(&self, tick: u64) -> Setpoint;
}

/// A torque model that can be evaluated in the loop.
pub trait FeedForward: Send {
    /// Identity of the model; 0 for one that stands for none and has no torque.
    fn id(&self) -> u64;

    /// Torque the arm needs at `desired` \[Nm\].
    fn torque(&mut self, desired: &Setpoint) -> Torque;

    /// The rigid body's torque at rest at position `q`, under the gravity that the arm's own controller compensates \[Nm\].
    fn vendor_torque(&mut self, q: &JointVec) -> Torque;
}

/// Forward kinematics for the guard.
pub trait Kinematics: Send {
    /// Position of the end effector in the base frame \[m\].
    fn end_effector(&self, q: &JointVec) -> [f64; 3];
}

/// Why a backend could not go on. `Copy`, so that it can leave the loop through a ring.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// No state arrived in time.
    #[error("no state from the arm for {waited_ms} ms")]
    Silent {
        /// How long the loop waited \[ms\].
        waited_ms: u32,
    },
    /// The arm stopped by itself; the code is the backend's own.
    #[error("the arm stopped by itself (code {code})")]
    Reflex {
        /// The backend's own reason code.
        code: u32,
    },
    /// The arm refused a command; the code is the backend's own.
    #[error("the arm refused a command (code {code})")]
    Refused {
        /// The backend's own reason code.
        code: u32,
    },
    /// The connection is gone.
    #[error("the connection to the arm is gone")]
    Disconnected,
}
