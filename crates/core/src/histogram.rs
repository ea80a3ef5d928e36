//! Durations, counted without a lock in memory that is allocated beforehand.

use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Distribution of one duration \[ns\]; all zero when nothing was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Distribution {
    /// Number of values.
    pub count: u64,
    /// Median.
    pub p50_ns: u64,
    /// 99th percentile.
    pub p99_ns: u64,
    /// 99.9th percentile.
    pub p999_ns: u64,
    /// Largest value, exact.
    pub max_ns: u64,
}

impl Distribution {
    /// Median, 99th and 99.9th percentile and largest value \[us\]; `None` when nothing was measured.
    pub fn in_us(&self) -> Option<[f64; 4]> {
        let all = [self.p50_ns, self.p99_ns, self.p999_ns, self.max_ns];
        (self.count > 0).then(|| all.map(|ns| ns as f64 / 1e3))
    }
}

/// Longer durations count as this one in the percentiles.
const CLAMP_NS: u64 = 10_000_000_000;
/// Shorter durations have a place each; from there on an octave has half as many places, so that none is off by more than 0.1 %.
const EXACT: u64 = 2048;
const HALF: usize = EXACT as usize / 2;

/// A histogram of durations: 0.1 % up to 10 s, and the exact maximum. One thread adds, any thread reads.
///
/// The layout is that of HdrHistogram at three digits, whose crate can grow while it records, and so allocate and panic.
#[derive(Debug)]
pub struct Histogram {
    counts: Vec<AtomicU64>,
    max: AtomicU64,
}

impl Default for Histogram {
    fn default() -> Histogram {
        Histogram { counts: (0..=place(CLAMP_NS)).map(|_| AtomicU64::new(0)).collect(), max: AtomicU64::new(0) }
    }
}

impl Histogram {
    /// Counts a duration \[ns\]. No allocation; real-time safe.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn add(&self, ns: u64) {
        if let Some(count) = self.counts.get(place(ns.min(CLAMP_NS))) {
            // One writer: no increment is lost.
            count.store(count.load(Relaxed) + 1, Relaxed);
        }
        if ns > self.max.load(Relaxed) {
            self.max.store(ns, Relaxed);
        }
    }

    /// Count and percentiles so far; a percentile is the longest duration that shares the place of the value it names.
    pub fn distribution(&self) -> Distribution {
        let counts: Vec<u64> = self.counts.iter().map(|count| count.load(Relaxed)).collect();
        let (count, max) = (counts.iter().sum::<u64>(), self.max.load(Relaxed));
        if count == 0 {
            return Distribution::default();
        }
        let at = |share: f64| {
            let wanted = ((share * count as f64).ceil() as u64).max(1);
            let mut below = 0;
            let mut reached = counts.iter().map(|count| {
                below += count;
                below >= wanted
            });
            reached.position(|reached| reached).map_or(max, |place| end_of(place).min(max))
        };
        Distribution { count, p50_ns: at(0.5), p99_ns: at(0.99), p999_ns: at(0.999), max_ns: max }
    }
}

/// Where a duration is counted.
fn place(ns: u64) -> usize {
    let octave = (ns | (EXACT - 1)).ilog2() - (EXACT - 1).ilog2();
    octave as usize * HALF + (ns >> octave) as usize
}

/// The longest duration of a place \[ns\].
fn end_of(place: usize) -> u64 {
    let octave = (place / HALF).saturating_sub(1);
    (((place - octave * HALF) as u64 + 1) << octave) - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use hdrhistogram::Histogram as Reference;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn places_follow_each_other_without_gaps() {
        let mut last = 0;
        for ns in (0..10_000).chain((14..34).flat_map(|power| (1u64 << power) - 2..(1 << power) + 2)) {
            let place = place(ns);
            assert!(ns <= end_of(place) && (place == 0 || ns > end_of(place - 1)), "{ns}");
            assert!(ns >= 10_000 || place == last || place == last + 1, "{ns}");
            assert!(end_of(place) - ns <= ns / 1000, "{ns}");
            last = place;
        }
    }

    #[test]
    fn percentiles_are_those_of_hdr_histogram() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for case in 0..40 {
            let histogram = Histogram::default();
            let mut reference = Reference::<u64>::new_with_bounds(1, CLAMP_NS, 3).unwrap();
            let mut max = 0;
            for _ in 0..=case * case {
                // From nothing to past the end, every magnitude alike.
                let ns = rng.random_range(0..20_000_000_000) >> rng.random_range(0..34);
                histogram.add(ns);
                reference.record(ns.min(CLAMP_NS)).unwrap();
                max = max.max(ns);
            }
            let at = |share| reference.value_at_quantile(share).min(max);
            let expected = Distribution {
                count: reference.len(),
                p50_ns: at(0.5),
                p99_ns: at(0.99),
                p999_ns: at(0.999),
                max_ns: max,
            };
            assert_eq!(histogram.distribution(), expected, "{case}");
        }
        assert_eq!(Histogram::default().distribution(), Distribution::default());
    }
}
