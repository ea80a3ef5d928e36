//! Times and numbers of the states of an arm that another program controls.
//!
//! The publisher's numbers are the arm's cycles, 1 ms each. Its stamps are checked against them: a state later than half a period is counted as
//! late, a publisher that was paused, or that publishes at another rate than 1 kHz, is found. Time is an argument.

use crate::analysis::collector::MAX_GAP;
use plumbline_core::{PERIOD_NS, PERIOD_S, State};
use plumbline_ipc::{GuestCounts, GuestMessage};

/// Longest delay of a state that is no pause \[ns\].
const MAX_DELAY_NS: u64 = MAX_GAP * PERIOD_NS;
/// Share of a delay by which the schedule follows it: a publisher's clock may be slower than this machine's.
const FOLLOW: u64 = 64;
/// States over which the rate is measured. It is another one after two such measurements in a row.
const RATE_STATES: u64 = 500;
/// Mean time between states of a publisher at 1 kHz \[ns\].
const MEAN_NS: std::ops::RangeInclusive<u64> = PERIOD_NS - PERIOD_NS / 10..=PERIOD_NS + PERIOD_NS / 10;

/// Why the states of a publisher are not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unusable {
    #[error("the published states have {found} joints, the robot has {expected}: none of them is used")]
    Joints { found: u32, expected: usize },
    #[error("states are published every {} us, expected is one per 1000 us (1 kHz): none of them is used", mean_ns / 1000)]
    Rate { mean_ns: u64 },
}

/// Number and stamp of a state.
#[derive(Clone, Copy, Debug)]
struct Last {
    /// Number by the publisher.
    seq: u64,
    stamp_ns: u64,
    /// When it was due by the publisher's schedule \[ns\].
    due_ns: u64,
}

/// Cycle of the arm in this daemon's count, and the stamp of its state.
#[derive(Clone, Copy, Debug)]
struct Used {
    cycle: u64,
    stamp_ns: u64,
}

/// Measurement of the rate.
#[derive(Clone, Copy, Debug, Default)]
struct Rate {
    states: u64,
    /// Time of these states, and the same with every pause as a short one \[ns\].
    span_ns: u64,
    unpaused_ns: u64,
    /// Whether the measurement before was another rate.
    other_before: bool,
}

/// States received so far.
#[derive(Debug, Default)]
pub struct Arrivals {
    joints: usize,
    /// The state before; `None` after another publisher's start or states that are not used.
    last: Option<Last>,
    /// The last state that was used.
    used: Option<Used>,
    rate: Rate,
    unusable: Option<Unusable>,
    counts: GuestCounts,
}

impl Arrivals {
    /// For a robot with `joints` joints.
    pub fn new(joints: usize) -> Arrivals {
        Arrivals { joints, ..Arrivals::default() }
    }

    /// Another publisher: its numbers start again.
    pub fn restart(&mut self) {
        (self.last, self.rate, self.unusable) = (None, Rate::default(), None);
    }

    /// Why states are not used, if so.
    pub fn unusable(&self) -> Option<Unusable> {
        self.unusable
    }

    /// What was counted here, beside what the receiver counted.
    pub fn counts(&self, received: &GuestCounts) -> GuestCounts {
        let GuestCounts { other_joints, other_rate, late, pauses, .. } = self.counts;
        GuestCounts { other_joints, other_rate, late, pauses, ..*received }
    }

    /// The state of a sample, numbered by cycles of the arm since the first one; `None` where it is not used. After a pause, another
    /// publisher's start or unused states more than [`MAX_GAP`] numbers are missing.
    pub fn take(&mut self, sample: &GuestMessage) -> Option<State> {
        if sample.n as usize != self.joints {
            self.counts.other_joints += 1;
            self.unusable = Some(Unusable::Joints { found: sample.n, expected: self.joints });
            self.last = None;
            return None;
        }
        if matches!(self.unusable, Some(Unusable::Joints { .. })) {
            self.unusable = None;
        }
        let stamp_ns = sample.stamp_ns;
        let last = self.last;
        let gap = last.map_or(1, |last| sample.seq.saturating_sub(last.seq).max(1));
        let due_ns = last.map_or(stamp_ns, |last| last.due_ns.saturating_add(gap.saturating_mul(PERIOD_NS)));
        let delay_ns = stamp_ns.saturating_sub(due_ns);
        let paused = delay_ns > MAX_DELAY_NS;
        self.counts.late += u64::from(delay_ns > PERIOD_NS / 2);
        self.counts.pauses += u64::from(paused);
        if let Some(last) = last {
            self.measure_rate(stamp_ns.saturating_sub(last.stamp_ns), gap);
        }
        // The schedule follows early states at once and late ones slowly.
        let due_ns = if paused { stamp_ns } else { stamp_ns.min(due_ns + delay_ns / FOLLOW) };
        self.last = Some(Last { seq: sample.seq, stamp_ns, due_ns });
        if self.unusable.is_some() {
            self.counts.other_rate += 1;
            return None;
        }
        let cycle = match self.used {
            None => 0,
            Some(used) if last.is_some() && !paused && !self.skipped(&used, last) => used.cycle + gap,
            Some(used) => {
                let away = stamp_ns.saturating_sub(used.stamp_ns) / PERIOD_NS;
                used.cycle + away.max(MAX_GAP + 1)
            }
        };
        self.used = Some(Used { cycle, stamp_ns });
        let GuestMessage { q, dq, tau, q_d, .. } = *sample;
        Some(State { seq: cycle, time: cycle as f64 * PERIOD_S, q, dq, tau, q_d })
    }

    /// Whether states between the last one that was `used` and this one were not.
    fn skipped(&self, used: &Used, last: Option<Last>) -> bool {
        last.is_none_or(|last| last.stamp_ns != used.stamp_ns)
    }

    /// Adds the time between two states, `gap` numbers apart. A publisher that was paused may send what it had at once or not: the rate is another
    /// one where neither time is that of 1 kHz.
    fn measure_rate(&mut self, interval_ns: u64, gap: u64) {
        let longest = gap.saturating_mul(PERIOD_NS).saturating_add(MAX_DELAY_NS);
        let rate = &mut self.rate;
        rate.states = rate.states.saturating_add(gap);
        rate.span_ns = rate.span_ns.saturating_add(interval_ns);
        rate.unpaused_ns = rate.unpaused_ns.saturating_add(interval_ns.min(longest));
        if rate.states < RATE_STATES {
            return;
        }
        let [mean_ns, unpaused_ns] = [rate.span_ns, rate.unpaused_ns].map(|span| span / rate.states);
        let other = ![mean_ns, unpaused_ns].iter().any(|mean| MEAN_NS.contains(mean));
        self.unusable = (other && rate.other_before).then_some(Unusable::Rate { mean_ns: unpaused_ns });
        self.rate = Rate { other_before: other, ..Rate::default() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample(seq: u64, stamp_us: u64) -> GuestMessage {
        GuestMessage { n: 7, seq, stamp_ns: 1000 * stamp_us, ..GuestMessage::default() }
    }

    fn cycles(arrivals: &mut Arrivals, samples: impl Iterator<Item = (u64, u64)>) -> Vec<u64> {
        samples.filter_map(|(seq, us)| arrivals.take(&sample(seq, us))).map(|state| state.seq).collect()
    }

    fn counts(arrivals: &Arrivals) -> [u64; 4] {
        let GuestCounts { late, pauses, other_joints, other_rate, .. } = arrivals.counts(&GuestCounts::default());
        [late, pauses, other_joints, other_rate]
    }

    #[test]
    fn lost_states_leave_their_gap_and_late_ones_none() {
        let mut arrivals = Arrivals::new(7);
        let stamps = [(40, 0), (41, 1000), (44, 4000), (45, 5700), (46, 6100), (47, 7000)];
        assert_eq!(cycles(&mut arrivals, stamps.into_iter()), [0, 1, 4, 5, 6, 7]);
        assert_eq!(counts(&arrivals), [1, 0, 0, 0]);
        // A second of loss is a gap by the numbers.
        assert_eq!(cycles(&mut arrivals, [(1047, 1_007_000)].into_iter()), [1007]);
    }

    #[test]
    fn a_pause_and_another_publisher_divide_the_recording() {
        let mut arrivals = Arrivals::new(7);
        cycles(&mut arrivals, (0..100).map(|k| (k, 1000 * k)));
        // The publisher stood for 300 ms, then sent what it had; its numbers show none of it.
        let after = cycles(&mut arrivals, (100..400).map(|k| (k, (400_000 + k).max(1000 * k))));
        assert_eq!((after[0], after[299]), (99 + 301, 99 + 301 + 299));
        assert_eq!(counts(&arrivals)[1], 1);
        arrivals.restart();
        let next = cycles(&mut arrivals, (0..3).map(|k| (k, 405_000 + 1000 * k)));
        assert_eq!(next[0] - after[299], MAX_GAP + 1, "more than a run may lack, however soon it comes");
        assert_eq!(next[2] - next[0], 2);
        assert_eq!(counts(&arrivals)[2..], [0, 0]);
    }

    #[test]
    fn another_number_of_joints_and_another_rate_are_refused_by_name() {
        let mut arrivals = Arrivals::new(7);
        let six = GuestMessage { n: 6, ..sample(0, 0) };
        assert_eq!(arrivals.take(&six), None);
        assert_eq!(arrivals.unusable(), Some(Unusable::Joints { found: 6, expected: 7 }));
        assert_eq!(cycles(&mut arrivals, (1..3).map(|k| (k, 1000 * k))), [0, 1]);
        assert_eq!((arrivals.unusable(), counts(&arrivals)), (None, [0, 0, 1, 0]));
        // 500 Hz is found after a thousand states.
        for period_us in [2000, 100] {
            let mut arrivals = Arrivals::new(7);
            let used = cycles(&mut arrivals, (0..2000).map(|k| (k, period_us * k))).len();
            assert_eq!(used, 1000, "{period_us} us");
            let mean_ns = 1000 * period_us;
            assert_eq!(arrivals.unusable(), Some(Unusable::Rate { mean_ns }));
            assert_eq!(counts(&arrivals)[3], 1000);
            // At 1 kHz again, and the recording is divided.
            let end = period_us * 1999;
            let again = cycles(&mut arrivals, (0..1000).map(|k| (2000 + k, end + 1000 * (k + 1))));
            assert!((400..=501).contains(&again.len()) && again[0] > 1000 + MAX_GAP, "{}, {}", again.len(), again[0]);
            assert_eq!(arrivals.unusable(), None);
        }
        // Jitter and a drift of 200 parts per million are 1 kHz.
        let mut arrivals = Arrivals::new(7);
        let jitter = |k: u64| 1000 * k + k / 5 + (k * 7919) % 400;
        assert_eq!(cycles(&mut arrivals, (0..20_000).map(|k| (k, jitter(k)))), (0..20_000).collect::<Vec<_>>());
        assert_eq!((counts(&arrivals), arrivals.unusable()), ([0; 4], None));
    }
}
