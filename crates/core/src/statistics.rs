//! Counters and timing of the loop, in the daemon's status and in `report.json`.

use crate::Distribution;
use serde::{Deserialize, Serialize};

/// Counters and timing of the loop during one connection to the arm.
///
/// Every cycle of the arm is accounted for: `elapsed == cycles + lost` ([`LoopStatistics::accounted`]). A missed cycle is skipped and
/// counted in `lost`, whether the network or the loop was late. Missed cycles are never run later in a burst.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoopStatistics {
    /// Cycles of the arm from the first state read to the last, by the arm's counter.
    pub elapsed: u64,
    /// States read; each starts one cycle of the loop.
    pub cycles: u64,
    /// States of the arm that were not received.
    pub lost: u64,
    /// Longest run of lost states.
    pub longest_lost: u64,
    /// Periods of `CLOCK_MONOTONIC` from the first state's deadline to the last one's, both counted, as `elapsed` counts the arm's; `None`
    /// where the arm has no deadlines. A hardware arm's clock drifts from it by parts per million.
    pub clock: Option<u64>,
    /// Cycles that started more than half a period later than the arm's counter implies; `None` where the arm has no deadlines.
    pub late: Option<u64>,
    /// Records dropped because the ring to the bridge thread was full.
    pub dropped_records: u64,
    /// Motion requests that a stop discarded.
    pub discarded_orders: u64,
    /// Events dropped because their ring was full.
    pub dropped_events: u64,
    /// Wake-up latency: from a state's deadline to the read; empty where the arm has no deadlines.
    pub wake_up: Distribution,
    /// Execution time: from state read to command written.
    pub execution: Distribution,
    /// Time between two state reads divided by the number of arm cycles between them; empty where the arm has no deadlines.
    pub period: Distribution,
}

impl LoopStatistics {
    /// Whether `elapsed == cycles + lost`: every cycle of the arm was counted exactly once.
    pub fn accounted(&self) -> bool {
        self.elapsed == self.cycles.saturating_add(self.lost)
    }
}
