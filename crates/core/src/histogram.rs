//! Histogram of durations: preallocated and lock-free.

use serde::{Deserialize, Serialize};
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Percentiles of a duration \[ns\]; all zero when nothing was measured.
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

/// Upper bound of the percentiles \[ns\]: longer durations count as this one.
const CLAMP_NS: u64 = 10_000_000_000;
/// Durations below this have one bin each \[ns\]. Above it an octave has half as many bins, a resolution of 0.1 %.
const EXACT_BELOW_NS: u64 = 2048;
const BINS_PER_OCTAVE: usize = EXACT_BELOW_NS as usize / 2;

/// Histogram of durations with a resolution of 0.1 % up to 10 s, and the exact maximum. One thread adds, any thread reads.
///
/// The layout is that of HdrHistogram at three digits. That crate can grow while it records, so it can allocate and panic.
#[derive(Debug)]
pub struct Histogram {
    counts: Vec<AtomicU64>,
    max: AtomicU64,
}

impl Default for Histogram {
    fn default() -> Histogram {
        Histogram { counts: (0..=bin_of(CLAMP_NS)).map(|_| AtomicU64::new(0)).collect(), max: AtomicU64::new(0) }
    }
}

impl Histogram {
    /// Counts a duration \[ns\]. No allocation; real-time safe.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn add(&self, ns: u64) {
        if let Some(count) = self.counts.get(bin_of(ns.min(CLAMP_NS))) {
            // Single writer: no increment is lost.
            count.store(count.load(Relaxed) + 1, Relaxed);
        }
        if ns > self.max.load(Relaxed) {
            self.max.store(ns, Relaxed);
        }
    }

    /// Count and percentiles so far. A percentile is the upper bound of its bin, at most the maximum.
    pub fn distribution(&self) -> Distribution {
        let counts: Vec<u64> = self.counts.iter().map(|count| count.load(Relaxed)).collect();
        let (count, max) = (counts.iter().sum::<u64>(), self.max.load(Relaxed));
        if count == 0 {
            return Distribution::default();
        }
        let percentile = |share: f64| {
            let rank = ((share * count as f64).ceil() as u64).max(1);
            let mut below = 0;
            let mut reached = counts.iter().map(|count| {
                below += count;
                below >= rank
            });
            reached.position(|reached| reached).map_or(max, |bin| upper_bound_ns(bin).min(max))
        };
        Distribution {
            count,
            p50_ns: percentile(0.5),
            p99_ns: percentile(0.99),
            p999_ns: percentile(0.999),
            max_ns: max,
        }
    }
}

/// Bin that a duration is counted in.
fn bin_of(ns: u64) -> usize {
    let octave = (ns | (EXACT_BELOW_NS - 1)).ilog2() - (EXACT_BELOW_NS - 1).ilog2();
    octave as usize * BINS_PER_OCTAVE + (ns >> octave) as usize
}

/// Longest duration of a bin \[ns\].
fn upper_bound_ns(bin: usize) -> u64 {
    let octave = (bin / BINS_PER_OCTAVE).saturating_sub(1);
    (((bin - octave * BINS_PER_OCTAVE) as u64 + 1) << octave) - 1
}

#[cfg(test)]
mod tests {
    use super::*;
    use hdrhistogram::Histogram as Reference;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn bins_follow_each_other_without_gaps() {
        let mut last = 0;
        for ns in (0..10_000).chain((14..34).flat_map(|power| (1u64 << power) - 2..(1 << power) + 2)) {
            let bin = bin_of(ns);
            assert!(ns <= upper_bound_ns(bin) && (bin == 0 || ns > upper_bound_ns(bin - 1)), "{ns}");
            assert!(ns >= 10_000 || bin == last || bin == last + 1, "{ns}");
            assert!(upper_bound_ns(bin) - ns <= ns / 1000, "{ns}");
            last = bin;
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
                // From 0 to beyond the upper bound, evenly over all orders of magnitude.
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
