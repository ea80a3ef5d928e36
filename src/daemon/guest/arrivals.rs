//! Times and numbers of the states of an arm that another program controls.
//!
//! The publisher's numbers are the arm's cycles, one period each. Its stamps are checked against them: a state later than half a period is counted as
//! late, a publisher that was paused, or that publishes at another rate than the job's, is found. Time is an argument.

use crate::analysis::collector::{MAX_GAP_S, states};
use plumbline_core::State;
use plumbline_ipc::{GuestCounts, GuestMessage};

/// Longest delay of a state that is no pause \[ns\].
const MAX_DELAY_NS: u64 = (1e9 * MAX_GAP_S) as u64;
/// Share of a delay by which the schedule follows it: a publisher's clock may be slower than this machine's.
const FOLLOW: u64 = 64;
/// Time over which the rate is measured. It is another one after two such measurements in a row \[s\].
const RATE_S: f64 = 0.5;
/// Largest difference of the measured period from the job's, as a share.
const MAX_PERIOD_ERROR: f64 = 0.1;

/// Why the states of a publisher are not used.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unusable {
    #[error("the published states have {found} joints, the robot has {expected}: none of them is used")]
    Joints { found: u32, expected: usize },
    #[error(
        "states are published every {} us, expected is one per {} us (`backend.guest.rate`): none of them is used",
        mean_ns / 1000,
        period_ns / 1000
    )]
    Rate { mean_ns: u64, period_ns: u64 },
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
    /// Time between two states \[s\].
    period: f64,
    /// The state before; `None` after another publisher's start or states that are not used.
    last: Option<Last>,
    /// The last state that was used.
    used: Option<Used>,
    rate: Rate,
    unusable: Option<Unusable>,
    counts: GuestCounts,
}

impl Arrivals {
    /// For a robot with `joints` joints whose states come every `period` \[s\].
    pub fn new(joints: usize, period: f64) -> Arrivals {
        Arrivals { joints, period, ..Arrivals::default() }
    }

    fn period_ns(&self) -> u64 {
        (1e9 * self.period).round() as u64
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
    /// publisher's start or unused states more numbers are missing than [`MAX_GAP_S`] has.
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
        let period_ns = self.period_ns();
        let due_ns = last.map_or(stamp_ns, |last| last.due_ns.saturating_add(gap.saturating_mul(period_ns)));
        let delay_ns = stamp_ns.saturating_sub(due_ns);
        let paused = delay_ns > MAX_DELAY_NS;
        self.counts.late += u64::from(delay_ns > period_ns / 2);
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
                let away = stamp_ns.saturating_sub(used.stamp_ns) / period_ns;
                used.cycle + away.max(states(MAX_GAP_S, self.period) + 1)
            }
        };
        self.used = Some(Used { cycle, stamp_ns });
        let GuestMessage { q, dq, tau, q_d, .. } = *sample;
        Some(State { seq: cycle, time: cycle as f64 * self.period, q, dq, tau, q_d })
    }

    /// Whether states between the last one that was `used` and this one were not.
    fn skipped(&self, used: &Used, last: Option<Last>) -> bool {
        last.is_none_or(|last| last.stamp_ns != used.stamp_ns)
    }

    /// Adds the time between two states, `gap` numbers apart. A publisher that was paused may send what it had at once or not: the rate is another
    /// one where neither time is the job's.
    fn measure_rate(&mut self, interval_ns: u64, gap: u64) {
        let period_ns = self.period_ns();
        let longest = gap.saturating_mul(period_ns).saturating_add(MAX_DELAY_NS);
        let rate = &mut self.rate;
        rate.states = rate.states.saturating_add(gap);
        rate.span_ns = rate.span_ns.saturating_add(interval_ns);
        rate.unpaused_ns = rate.unpaused_ns.saturating_add(interval_ns.min(longest));
        if rate.states < states(RATE_S, self.period) {
            return;
        }
        let [mean_ns, unpaused_ns] = [rate.span_ns, rate.unpaused_ns].map(|span| span / rate.states);
        let is_period = |&mean: &u64| (mean as f64 - period_ns as f64).abs() <= MAX_PERIOD_ERROR * period_ns as f64;
        let other = ![mean_ns, unpaused_ns].iter().any(is_period);
        self.unusable = (other && rate.other_before).then_some(Unusable::Rate { mean_ns: unpaused_ns, period_ns });
        self.rate = Rate { other_before: other, ..Rate::default() };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_core::{PERIOD_NS, PERIOD_S};

    /// Longest gap inside a run at 1 kHz.
    const MAX_GAP_STATES: u64 = 20;

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
        let mut arrivals = Arrivals::new(7, PERIOD_S);
        let stamps = [(40, 0), (41, 1000), (44, 4000), (45, 5700), (46, 6100), (47, 7000)];
        assert_eq!(cycles(&mut arrivals, stamps.into_iter()), [0, 1, 4, 5, 6, 7]);
        assert_eq!(counts(&arrivals), [1, 0, 0, 0]);
        // A second of loss is a gap by the numbers.
        assert_eq!(cycles(&mut arrivals, [(1047, 1_007_000)].into_iter()), [1007]);
    }

    #[test]
    fn a_pause_and_another_publisher_divide_the_recording() {
        let mut arrivals = Arrivals::new(7, PERIOD_S);
        cycles(&mut arrivals, (0..100).map(|k| (k, 1000 * k)));
        // The publisher stood for 300 ms, then sent what it had; its numbers show none of it.
        let after = cycles(&mut arrivals, (100..400).map(|k| (k, (400_000 + k).max(1000 * k))));
        assert_eq!((after[0], after[299]), (99 + 301, 99 + 301 + 299));
        assert_eq!(counts(&arrivals)[1], 1);
        arrivals.restart();
        let next = cycles(&mut arrivals, (0..3).map(|k| (k, 405_000 + 1000 * k)));
        assert_eq!(next[0] - after[299], MAX_GAP_STATES + 1, "more than a run may lack, however soon it comes");
        assert_eq!(next[2] - next[0], 2);
        assert_eq!(counts(&arrivals)[2..], [0, 0]);
    }

    #[test]
    fn another_number_of_joints_and_another_rate_are_refused_by_name() {
        let mut arrivals = Arrivals::new(7, PERIOD_S);
        let six = GuestMessage { n: 6, ..sample(0, 0) };
        assert_eq!(arrivals.take(&six), None);
        assert_eq!(arrivals.unusable(), Some(Unusable::Joints { found: 6, expected: 7 }));
        assert_eq!(cycles(&mut arrivals, (1..3).map(|k| (k, 1000 * k))), [0, 1]);
        assert_eq!((arrivals.unusable(), counts(&arrivals)), (None, [0, 0, 1, 0]));
        // 500 Hz is found after a thousand states.
        for period_us in [2000, 100] {
            let mut arrivals = Arrivals::new(7, PERIOD_S);
            let used = cycles(&mut arrivals, (0..2000).map(|k| (k, period_us * k))).len();
            assert_eq!(used, 1000, "{period_us} us");
            let mean_ns = 1000 * period_us;
            assert_eq!(arrivals.unusable(), Some(Unusable::Rate { mean_ns, period_ns: PERIOD_NS }));
            assert_eq!(counts(&arrivals)[3], 1000);
            // At 1 kHz again, and the recording is divided.
            let end = period_us * 1999;
            let again = cycles(&mut arrivals, (0..1000).map(|k| (2000 + k, end + 1000 * (k + 1))));
            assert!(
                (400..=501).contains(&again.len()) && again[0] > 1000 + MAX_GAP_STATES,
                "{}, {}",
                again.len(),
                again[0]
            );
            assert_eq!(arrivals.unusable(), None);
        }
        // Jitter and a drift of 200 parts per million are 1 kHz.
        let mut arrivals = Arrivals::new(7, PERIOD_S);
        let jitter = |k: u64| 1000 * k + k / 5 + (k * 7919) % 400;
        assert_eq!(cycles(&mut arrivals, (0..20_000).map(|k| (k, jitter(k)))), (0..20_000).collect::<Vec<_>>());
        assert_eq!((counts(&arrivals), arrivals.unusable()), ([0; 4], None));
    }

    #[test]
    fn another_period_of_the_job_is_counted_by_its_own_numbers() {
        for (period_us, missing) in [(2000, 10), (4000, 5), (8000, 3)] {
            let mut arrivals = Arrivals::new(7, 1e-6 * period_us as f64);
            let states: Vec<State> = (0..3000).filter_map(|k| arrivals.take(&sample(k, period_us * k))).collect();
            assert_eq!((counts(&arrivals), arrivals.unusable()), ([0; 4], None), "{period_us} us");
            assert!((states[2999].time - 2999e-6 * period_us as f64).abs() < 1e-9 && states[2999].seq == 2999);
            // Half a period late; paused, so that the run is divided.
            let stamp = period_us * 3000 + period_us / 2 + 100;
            assert_eq!(arrivals.take(&sample(3000, stamp)).unwrap().seq, 3000);
            let after = arrivals.take(&sample(3001, stamp + 30_000)).unwrap();
            assert!(
                after.seq > 3000 + missing && counts(&arrivals)[..2] == [2, 1],
                "{}, {:?}",
                after.seq,
                counts(&arrivals)
            );
            // 1 kHz is another rate here.
            let end = stamp + 30_000;
            for k in 1..2000 {
                arrivals.take(&sample(3001 + k, end + 1000 * k));
            }
            let (mean_ns, period_ns) = (1_000_000, 1000 * period_us);
            assert_eq!(arrivals.unusable(), Some(Unusable::Rate { mean_ns, period_ns }));
        }
    }
}
