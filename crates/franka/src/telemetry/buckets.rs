//! Durations counted in fixed logarithmic buckets, without a lock.

use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Buckets per doubling: a percentile is at most 1/16 too high.
const PER_OCTAVE: u64 = 16;
/// Doublings above the first bucket, whose end is 16 ns: up to 17 s.
const OCTAVES: usize = 30;
const BUCKETS: usize = PER_OCTAVE as usize * (OCTAVES + 1);

/// What a set of durations was like \[us\].
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct Spread {
    /// How many.
    pub count: u64,
    /// Half are no longer.
    pub p50: f64,
    /// 99 in 100 are no longer.
    pub p99: f64,
    /// 999 in 1000 are no longer.
    pub p999: f64,
    /// The longest, exactly.
    pub max: f64,
}

/// One thread adds, any thread looks.
#[derive(Debug)]
pub(super) struct Buckets {
    counts: [AtomicU64; BUCKETS],
    max_ns: AtomicU64,
}

impl Default for Buckets {
    fn default() -> Buckets {
        Buckets { counts: std::array::from_fn(|_| AtomicU64::new(0)), max_ns: AtomicU64::new(0) }
    }
}

impl Buckets {
    /// Counts one duration.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn add(&self, ns: u64) {
        if let Some(count) = self.counts.get(bucket(ns)) {
            count.store(count.load(Relaxed) + 1, Relaxed);
        }
        if ns > self.max_ns.load(Relaxed) {
            self.max_ns.store(ns, Relaxed);
        }
    }

    /// What was added so far.
    pub fn spread(&self) -> Spread {
        let counts: Vec<u64> = self.counts.iter().map(|count| count.load(Relaxed)).collect();
        let count: u64 = counts.iter().sum();
        let max_ns = self.max_ns.load(Relaxed);
        let percentile = |share: f64| {
            let rank = (share * count as f64).ceil().max(1.0) as u64;
            let mut seen = 0;
            for (index, count) in counts.iter().enumerate() {
                seen += count;
                if seen >= rank {
                    return end_of(index).min(max_ns) as f64 * 1e-3;
                }
            }
            0.0
        };
        let max = max_ns as f64 * 1e-3;
        Spread { count, p50: percentile(0.5), p99: percentile(0.99), p999: percentile(0.999), max }
    }
}

/// The first 16 buckets hold one nanosecond each; from there on a bucket is a sixteenth of its power of two.
fn bucket(ns: u64) -> usize {
    if ns < PER_OCTAVE {
        return ns as usize;
    }
    let octave = ns.ilog2() - PER_OCTAVE.ilog2();
    let index = (u64::from(octave) + 1) * PER_OCTAVE + ((ns >> octave) - PER_OCTAVE);
    (index as usize).min(BUCKETS - 1)
}

/// The longest duration of a bucket \[ns\].
fn end_of(index: usize) -> u64 {
    let index = index as u64;
    if index < PER_OCTAVE {
        return index;
    }
    let (octave, place) = (index / PER_OCTAVE - 1, index % PER_OCTAVE);
    ((PER_OCTAVE + place + 1) << octave) - 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn buckets_follow_each_other_without_gaps() {
        let mut last = 0;
        for ns in (0..5000).chain((13..34).flat_map(|power| (1u64 << power) - 2..(1 << power) + 2)) {
            let index = bucket(ns);
            assert!(ns <= end_of(index) || index == BUCKETS - 1, "{ns}");
            assert!(index == 0 || ns > end_of(index - 1), "{ns}");
            if ns < 5000 {
                assert!(index == last || index == last + 1);
                last = index;
            }
        }
        assert_eq!(bucket(u64::MAX), BUCKETS - 1);
    }

    #[test]
    fn percentiles_are_at_most_a_sixteenth_too_high() {
        let buckets = Buckets::default();
        assert_eq!(buckets.spread(), Spread::default());
        for ns in 1..=100_000 {
            buckets.add(ns);
        }
        let spread = buckets.spread();
        assert_eq!((spread.count, spread.max), (100_000, 100.0));
        for (found, exact) in [(spread.p50, 50.0), (spread.p99, 99.0), (spread.p999, 99.9)] {
            assert!(found >= exact && found <= exact * (1.0 + 1.0 / 16.0), "{found} for {exact}");
        }
    }
}
