//! Statistics of the real-time loop and the sample stream in `report.json`.

use crate::config::job::Pace;
use plumbline_ipc::{Session, Status, StreamCounters};
use serde::{Deserialize, Serialize};

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LoopReport {
    /// `fast`, which is simulated time as fast as possible, or `wall-clock`.
    pub pace: Pace,
    /// Cycles run, those of the connection included that had not ended when the report was written.
    pub cycles: u64,
    /// Cycles that came late; `None` where simulated time doesn't follow the clock.
    pub late: Option<u64>,
    pub lost: u64,
    /// Records dropped because the ring to the bridge thread was full.
    pub dropped_records: u64,
    /// Connections to the arm that have ended, in their order.
    pub sessions: Vec<Session>,
}

impl LoopReport {
    pub fn new(status: &Status, wall_clock: bool) -> LoopReport {
        LoopReport {
            pace: if wall_clock { Pace::WallClock } else { Pace::Fast },
            cycles: status.cycles,
            late: wall_clock.then_some(status.late),
            lost: status.lost,
            dropped_records: status.dropped_records,
            sessions: status.sessions.clone(),
        }
    }

    pub fn is_fast(&self) -> bool {
        self.pace == Pace::Fast
    }

    /// Allocations inside cycles; `None` if one session was not counted.
    pub fn allocations(&self) -> Option<u32> {
        self.sessions.iter().map(|session| session.allocations).sum()
    }

    /// The longest session: its percentiles stand for the whole loop, because percentiles can't be added.
    pub fn longest(&self) -> Option<&Session> {
        self.sessions.iter().max_by_key(|session| session.statistics.cycles)
    }

    /// Rights refused by the operating system, each once.
    pub fn refusals(&self) -> Vec<&str> {
        let mut all: Vec<&str> = Vec::new();
        for refusal in self.sessions.iter().flat_map(|session| &session.refusals) {
            if !all.contains(&refusal.as_str()) {
                all.push(refusal);
            }
        }
        all
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IpcReport {
    pub sent: u64,
    #[serde(flatten)]
    pub counters: StreamCounters,
}
