//! Deadline statistics of the loop, in memory that is allocated before it starts.

use plumbline_core::{Distribution, Histogram, LoopStatistics, PERIOD_NS, Record};

/// The arm's counter did not go forward, so its time can't be trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct NotForward {
    pub last: u64,
    pub seq: u64,
}

/// Counts and histograms, filled once per cycle.
pub(super) struct Tally {
    first: Option<u64>,
    last: u64,
    last_ns: u64,
    first_due_ns: Option<u64>,
    late: u64,
    pub summary: LoopStatistics,
    wake: Histogram,
    work: Histogram,
    period: Histogram,
}

impl Tally {
    /// Allocates the histograms.
    pub fn new() -> Tally {
        Tally {
            first: None,
            last: 0,
            last_ns: 0,
            first_due_ns: None,
            late: 0,
            summary: LoopStatistics::default(),
            wake: Histogram::default(),
            work: Histogram::default(),
            period: Histogram::default(),
        }
    }

    /// Counts a state that was read at `now_ns`; the number of cycles of the arm since the one before, at least 1.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn arrived(&mut self, seq: u64, now_ns: u64) -> Result<u64, NotForward> {
        let gap = match self.first {
            None => {
                self.first = Some(seq);
                1
            }
            Some(_) if seq <= self.last => return Err(NotForward { last: self.last, seq }),
            Some(_) => {
                let gap = seq - self.last;
                let period = now_ns.saturating_sub(self.last_ns);
                self.period.add(period / gap);
                self.late += u64::from(period > gap.saturating_mul(PERIOD_NS).saturating_add(PERIOD_NS / 2));
                gap
            }
        };
        self.summary.cycles += 1;
        self.summary.lost += gap - 1;
        self.summary.longest_lost = self.summary.longest_lost.max(gap - 1);
        self.summary.elapsed = (seq - self.first.unwrap_or(seq)).saturating_add(1);
        (self.last, self.last_ns) = (seq, now_ns);
        Ok(gap)
    }

    /// Cycles that began after their deadline, where the arm has deadlines.
    pub fn late(&self) -> u64 {
        if self.first_due_ns.is_some() { self.late } else { 0 }
    }

    /// The arm's counter in the state that arrived last.
    pub fn last(&self) -> u64 {
        self.last
    }

    /// Goes on after `record`: the numbers of the cycles do, the counts begin anew.
    pub fn restore(&mut self, record: &Record) {
        (self.first, self.last, self.last_ns) = (Some(record.state.seq), record.state.seq, record.stamp_ns);
        self.summary.cycles = record.cycle.saturating_add(1);
    }

    /// Adds a wake-up latency \[ns\].
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn woke(&mut self, late_ns: u64) {
        self.wake.add(late_ns);
    }

    /// Notes the deadline of the state that arrived last, on the clock \[ns\].
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn due(&mut self, deadline_ns: u64) {
        let first = *self.first_due_ns.get_or_insert(deadline_ns);
        self.summary.clock = Some((deadline_ns.saturating_sub(first) + PERIOD_NS / 2) / PERIOD_NS + 1);
    }

    /// Adds a work time \[ns\].
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn worked(&mut self, ns: u64) {
        self.work.add(ns);
    }

    /// Counts and percentiles so far.
    pub fn summary(&self) -> LoopStatistics {
        let paced = self.first_due_ns.is_some();
        LoopStatistics {
            late: paced.then_some(self.late),
            wake_up: self.wake.distribution(),
            execution: self.work.distribution(),
            period: if paced { self.period.distribution() } else { Distribution::default() },
            ..self.summary
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_cycle_of_the_arm_is_accounted_for() {
        let mut tally = Tally::new();
        let mut now = 5_000;
        for (seq, gap) in [(100, 1), (101, 1), (104, 3), (105, 1), (111, 6)] {
            now += gap * PERIOD_NS;
            assert_eq!(tally.arrived(seq, now), Ok(gap));
        }
        let summary = tally.summary();
        assert_eq!((summary.elapsed, summary.cycles, summary.lost, summary.longest_lost), (12, 5, 7, 5));
        assert_eq!((summary.late, summary.period.count), (None, 0), "this arm has no deadlines");
        assert!(summary.accounted());
        assert_eq!(tally.arrived(111, now), Err(NotForward { last: 111, seq: 111 }));
        assert_eq!(tally.arrived(3, now), Err(NotForward { last: 111, seq: 3 }));
    }

    #[test]
    fn a_late_cycle_is_half_a_period_late_and_percentiles_are_exact() {
        let mut tally = Tally::new();
        let mut now = 0;
        for seq in 0..1001 {
            // One cycle in a hundred begins 0.6 ms late, the next one catches up.
            now = seq * PERIOD_NS + if seq % 100 == 50 { 600_000 } else { 0 };
            assert!(tally.arrived(seq, now).is_ok());
            tally.woke(seq);
            tally.due(seq * PERIOD_NS);
        }
        let summary = tally.summary();
        assert_eq!((summary.late, summary.clock), (Some(10), Some(1001)));
        let near = |got: u64, expected: u64| assert!(got.abs_diff(expected) <= expected / 500 + 1, "{got} {expected}");
        near(summary.wake_up.p50_ns, 500);
        near(summary.wake_up.p99_ns, 990);
        near(summary.wake_up.p999_ns, 999);
        near(summary.period.p50_ns, PERIOD_NS);
        assert_eq!((summary.wake_up.max_ns, summary.wake_up.count), (1000, 1001));
        assert_eq!(summary.period.max_ns, 1_600_000);
        tally.woke(u64::MAX);
        assert_eq!(tally.summary().wake_up.max_ns, u64::MAX, "a value past the histogram's bounds is not lost");
        let _ = now;
    }
}
