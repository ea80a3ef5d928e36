//! How the loop ended, and what it counted.

use crate::guard::Violation;
use crate::order::StopReason;
use crate::rights::Granted;
use crate::stats::NotForward;
use plumbline_core::{Fault, LoopStatistics, Record, State};

/// How the loop ended.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum End {
    /// It was requested, and the arm was at rest.
    #[error("ended on request, at rest")]
    Quit,
    /// The backend reported a fault.
    #[error("{0}")]
    Fault(Fault),
    /// The controlled stop itself broke a limit; the arm was stopped by its own means.
    #[error("while braking: {0}")]
    Unsafe(Violation),
    /// No controlled stop could be planned; the arm was stopped by its own means.
    #[error("no controlled stop from the last setpoint")]
    NoBrake,
    /// The machine did not grant rights that the settings require: nothing was read or sent.
    #[error("not real-time, and the configuration refuses to run so")]
    NotRealTime,
    /// The arm's cycle counter did not go forward.
    #[error("the arm's cycle counter went from {last} to {seq}")]
    Clock {
        /// Counter of the state before.
        last: u64,
        /// Counter of the last state.
        seq: u64,
    },
}

/// Result of the loop.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// How it ended.
    pub end: End,
    /// Number of controlled stops.
    pub stops: u32,
    /// Reason of the last of them.
    pub last_stop: Option<StopReason>,
    /// Counts and percentiles.
    pub summary: LoopStatistics,
    /// What the operating system granted.
    pub granted: Granted,
    /// Allocations and deallocations inside the loop; `None` when the program's allocator does not watch
    /// (`assert_no_alloc::AllocDisabler` is not its global allocator).
    pub allocations: Option<u32>,
    /// The last cycles, oldest first.
    pub flight: Vec<Record>,
    /// The state that was read last, where the loop ended before it was answered.
    pub unanswered: Option<State>,
}

impl From<NotForward> for End {
    fn from(NotForward { last, seq }: NotForward) -> End {
        End::Clock { last, seq }
    }
}
