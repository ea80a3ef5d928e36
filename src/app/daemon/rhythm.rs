//! When the loop's next record is due, so that the bridge thread can sleep until then.

use crate::rt::PERIOD_NS;

/// How long after the moment at which a record is due this thread looks for it \[ns\]: a wake-up at that very moment would often come too
/// early, and cost another one.
const BEHIND_NS: u64 = 20_000;
/// Pause between two looks for a record that is late \[ns\].
const AGAIN_NS: u64 = 50_000;
/// Work of a cycle that is believed \[ns\]; a stall is not the rule.
const MOST_WORK_NS: u64 = 200_000;

/// The rhythm of the records: one per period, each finished a little after its state was read.
#[derive(Clone, Copy, Debug, Default)]
pub struct Rhythm {
    /// When the state of the newest record was read \[ns\].
    stamp_ns: Option<u64>,
    work_ns: u64,
}

impl Rhythm {
    /// A record whose state was read at `stamp_ns`; the cycle before it took `work_ns`.
    pub fn saw(&mut self, stamp_ns: u64, work_ns: u64) {
        *self = Rhythm { stamp_ns: Some(stamp_ns), work_ns: work_ns.min(MOST_WORK_NS) };
    }

    /// When to look for the next record \[ns\]; `None` before the first.
    pub fn next_look(&self, now_ns: u64) -> Option<u64> {
        let due = self.stamp_ns?.saturating_add(PERIOD_NS + self.work_ns + BEHIND_NS);
        Some(if due > now_ns { due } else { now_ns.saturating_add(AGAIN_NS) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn looks_right_behind_the_loop_and_soon_again_when_it_is_late() {
        let mut rhythm = Rhythm::default();
        assert_eq!(rhythm.next_look(5), None);
        rhythm.saw(10_000_000, 4_000);
        assert_eq!(rhythm.next_look(10_100_000), Some(11_024_000));
        // The record is late: a stall of the loop must not cost the clients another period.
        assert_eq!(rhythm.next_look(11_030_000), Some(11_080_000));
        assert_eq!(rhythm.next_look(25_000_000), Some(25_050_000));
        // One slow cycle does not make this thread late for the next.
        rhythm.saw(10_000_000, 900_000_000);
        assert_eq!(rhythm.next_look(10_100_000), Some(11_220_000));
    }
}
