//! Cycle times of the recorded loop.

use super::replay::is_simulated;
use crate::recording::Recording;
use plumbline_core::{Histogram, LoopStatistics, PERIOD_NS, PERIOD_S};
use serde::Serialize;

/// Maximum length of the timeline and of the list of outliers.
pub(super) const MAX_LINES: usize = 60;

/// Conversion of sequence numbers to seconds before the end of the recording.
pub(super) struct TimeBase {
    last: u64,
}

impl TimeBase {
    pub fn of(recording: &Recording) -> TimeBase {
        let newest = recording.records.last().map_or(0, |record| record.state.seq);
        let unanswered = recording.unanswered.as_ref().map_or(0, |record| record.state.seq);
        let timed = recording.events.iter().map(|timed| timed.seq).max().unwrap_or(0);
        TimeBase { last: newest.max(unanswered).max(timed) }
    }

    pub fn before_end(&self, seq: u64) -> f64 {
        self.last.saturating_sub(seq) as f64 * PERIOD_S
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Timing {
    #[serde(flatten)]
    pub statistics: LoopStatistics,
    /// Lost states and late cycles, oldest first.
    pub outliers: Vec<Outlier>,
    pub more: usize,
}

impl Timing {
    /// Measured times by name: median, 99th and 99.9th percentile, maximum \[us\].
    pub fn times(&self) -> Vec<(&'static str, [f64; 4])> {
        let of = &self.statistics;
        let all = [("period", of.period), ("wake-up", of.wake_up), ("execution", of.execution)];
        all.into_iter().filter_map(|(name, times)| Some((name, times.in_us()?))).collect()
    }
}

/// A late cycle, or lost states.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outlier {
    /// Time \[s before the end\].
    pub before: f64,
    pub cycle: u64,
    pub text: String,
}

impl Timing {
    pub(super) fn of(recording: &Recording, time: &TimeBase) -> Timing {
        let records = &recording.records;
        let simulated = is_simulated(recording);
        let mut of = LoopStatistics { cycles: records.len() as u64, ..LoopStatistics::default() };
        if let (Some(first), Some(last)) = (records.first(), records.last()) {
            of.elapsed = last.state.seq.saturating_sub(first.state.seq).saturating_add(1);
        }
        let [wake_up, execution, period] = [(); 3].map(|()| Histogram::default());
        let mut late = 0;
        let mut outliers = Vec::new();
        for pair in records.windows(2).filter(|pair| pair[1].cycle == pair[0].cycle + 1) {
            let (earlier, later) = (&pair[0], &pair[1]);
            let gap = later.state.seq.saturating_sub(earlier.state.seq).max(1);
            let between = later.stamp_ns.saturating_sub(earlier.stamp_ns);
            period.add(between / gap);
            let mut push = |text: String| {
                outliers.push(Outlier { before: time.before_end(later.state.seq), cycle: later.cycle, text });
            };
            if gap > 1 {
                of.lost += gap - 1;
                of.longest_lost = of.longest_lost.max(gap - 1);
                push(format!("{} states lost", gap - 1));
            }
            if !simulated && between > gap.saturating_mul(PERIOD_NS).saturating_add(PERIOD_NS / 2) {
                late += 1;
                push(format!("{:.2} ms after the previous cycle", between as f64 / 1e6));
            }
        }
        records.iter().filter(|record| record.wake_ns > 0).for_each(|record| wake_up.add(record.wake_ns));
        records.iter().filter(|record| record.work_ns > 0).for_each(|record| execution.add(record.work_ns));
        (of.wake_up, of.execution) = (wake_up.distribution(), execution.distribution());
        if !simulated {
            (of.late, of.period) = (Some(late), period.distribution());
        }
        // The last outliers are kept.
        let more = outliers.len().saturating_sub(MAX_LINES);
        Timing { statistics: of, outliers: outliers.split_off(more), more }
    }
}
