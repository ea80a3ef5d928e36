//! What the loop counted and measured, as it stands in memory, in the daemon's status and in `report.json`.

use crate::Distribution;
use serde::{Deserialize, Serialize};

/// What the loop did during one connection to the arm, and how well it kept its time.
///
/// Every cycle of the arm is accounted for: `elapsed == cycles + lost` ([`LoopStatistics::accounted`]). A cycle that the loop missed is
/// skipped and counted under `lost`, whether the network or the loop itself was late; none is ever caught up in a burst.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct LoopStatistics {
    /// Cycles of the arm from the first state read to the last, by the arm's own counter.
    pub elapsed: u64,
    /// States read, each of which began one cycle of the loop.
    pub cycles: u64,
    /// States of the arm that never arrived.
    pub lost: u64,
    /// Longest run of lost states.
    pub longest_lost: u64,
    /// Periods of `CLOCK_MONOTONIC` from the first state's deadline to the last one's, both counted, as `elapsed` counts the arm's; `None`
    /// where the arm has no deadlines. An arm with a clock of its own may drift away from it by parts in a million.
    pub clock: Option<u64>,
    /// Cycles that began more than half a period later after the one before than the arm's counter says; `None` where the arm has no
    /// deadlines.
    pub late: Option<u64>,
    /// Records that found no room on their way to the bridge thread.
    pub dropped_records: u64,
    /// Orders that a stop discarded.
    pub discarded_orders: u64,
    /// Events that found no room.
    pub dropped_events: u64,
    /// Wake-up latency: from a state's deadline to its being read; empty where the arm has no deadlines.
    pub wake_up: Distribution,
    /// Execution time: from state read to command written.
    pub execution: Distribution,
    /// From one state read to the next, divided by the number of the arm's cycles between them; empty where the arm has no deadlines.
    pub period: Distribution,
}

impl LoopStatistics {
    /// Whether `elapsed == cycles + lost`: no cycle of the arm was counted twice or not at all.
    pub fn accounted(&self) -> bool {
        self.elapsed == self.cycles.saturating_add(self.lost)
    }
}
