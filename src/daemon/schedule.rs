//! Timing of the bridge thread: it sleeps until the loop's next record is due, and answers requests for a share of its time.

use plumbline_core::PERIOD_NS;

/// Delay of a poll after its record is due \[ns\]: a wake-up at the due time would often be too early, and cost another one.
const POLL_DELAY_NS: u64 = 20_000;
/// Pause between two polls for a late record \[ns\].
const RETRY_NS: u64 = 50_000;
/// Largest execution time of a cycle that the next poll allows for \[ns\]; longer ones are stalls.
const MAX_WORK_NS: u64 = 200_000;

/// The schedule of the records: one per period, each finished a little after its state was read.
#[derive(Clone, Copy, Debug, Default)]
pub struct RecordSchedule {
    /// When the state of the newest record was read \[ns\].
    stamp_ns: Option<u64>,
    work_ns: u64,
}

impl RecordSchedule {
    /// A record whose state was read at `stamp_ns`; the cycle before it took `work_ns`.
    pub fn record_read(&mut self, stamp_ns: u64, work_ns: u64) {
        *self = RecordSchedule { stamp_ns: Some(stamp_ns), work_ns: work_ns.min(MAX_WORK_NS) };
    }

    /// When to poll for the next record \[ns\]; `None` before the first.
    pub fn next_poll_ns(&self, now_ns: u64) -> Option<u64> {
        let due = self.stamp_ns?.saturating_add(PERIOD_NS + self.work_ns + POLL_DELAY_NS);
        Some(if due > now_ns { due } else { now_ns.saturating_add(RETRY_NS) })
    }
}

/// Ratio of the pause after answers to the time that they took: requests get a fifth of the time at most.
const PAUSE_RATIO: u64 = 4;
/// Longest such pause \[ns\].
const MAX_PAUSE_NS: u64 = 250_000_000;

/// The share of the bridge thread's time that requests get. It is a real-time thread: unlimited requests would use up the kernel's budget
/// for real-time threads (`kernel.sched_rt_runtime_us`), the loop's part included. Stops are not requests: they are not limited.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RequestShare {
    next_ns: u64,
}

impl RequestShare {
    pub fn is_due(&self, now_ns: u64) -> bool {
        now_ns >= self.next_ns
    }

    /// Answering took from `begin_ns` to `end_ns`.
    pub fn spent(&mut self, begin_ns: u64, end_ns: u64) {
        let rest = PAUSE_RATIO.saturating_mul(end_ns.saturating_sub(begin_ns)).min(MAX_PAUSE_NS);
        self.next_ns = end_ns.saturating_add(rest);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_get_a_fifth_of_the_time_however_many_there_are() {
        // Turns of 0.2 ms, each with a request.
        for answering in [30_000, 500_000, 3_000_000] {
            let (mut share, mut now, mut answered) = (RequestShare::default(), 1_000, 0_u64);
            while now < 10_000_000_000 {
                if share.is_due(now) {
                    share.spent(now, now + answering);
                    now += answering;
                    answered += answering;
                }
                now += 200_000;
            }
            let of_all = answered as f64 / now as f64;
            assert!((0.02..0.201).contains(&of_all), "{of_all} with {answering} ns each");
        }
        // One that took very long does not keep the next one waiting as much longer.
        let mut share = RequestShare::default();
        share.spent(0, 5_000_000_000);
        assert!(!share.is_due(5_200_000_000) && share.is_due(5_250_000_000));
    }

    #[test]
    fn looks_right_behind_the_loop_and_soon_again_when_it_is_late() {
        let mut schedule = RecordSchedule::default();
        assert_eq!(schedule.next_poll_ns(5), None);
        schedule.record_read(10_000_000, 4_000);
        assert_eq!(schedule.next_poll_ns(10_100_000), Some(11_024_000));
        // The record is late: a stall of the loop must not cost the clients another period.
        assert_eq!(schedule.next_poll_ns(11_030_000), Some(11_080_000));
        assert_eq!(schedule.next_poll_ns(25_000_000), Some(25_050_000));
        // One slow cycle does not make this thread late for the next.
        schedule.record_read(10_000_000, 900_000_000);
        assert_eq!(schedule.next_poll_ns(10_100_000), Some(11_220_000));
    }
}
