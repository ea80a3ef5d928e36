//! How long things took, counted in memory that is allocated before the loop starts.

/// Distribution of one duration \[ns\]; all zero when nothing was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Distribution {
    /// Number of values.
    pub count: u64,
    /// Median.
    pub p50: u64,
    /// 99th percentile.
    pub p99: u64,
    /// 99.9th percentile.
    pub p999: u64,
    /// Largest value, exact.
    pub max: u64,
}

/// Longer durations count as this one in the percentiles.
const CLAMP_NS: u64 = 10_000_000_000;
/// Shorter durations have a place each; from there on an octave has half as many places, so that none is off by more than 0.1 %.
const EXACT: u64 = 2048;
const HALF: usize = EXACT as usize / 2;

/// A histogram of durations to 0.1 % up to [`CLAMP_NS`], and the exact maximum: the layout of HdrHistogram at three digits, whose crate can
/// grow while it records, and so allocate and panic.
pub(super) struct Durations {
    counts: Vec<u64>,
    count: u64,
    max: u64,
}

impl Durations {
    /// Allocates the counts.
    pub fn new() -> Durations {
        Durations { counts: vec![0; place(CLAMP_NS) + 1], count: 0, max: 0 }
    }

    /// Counts a duration \[ns\].
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn add(&mut self, ns: u64) {
        if let Some(count) = self.counts.get_mut(place(ns.min(CLAMP_NS))) {
            *count += 1;
            self.count += 1;
        }
        self.max = self.max.max(ns);
    }

    /// Count and percentiles so far; a percentile is the longest duration that shares the place of the value it names.
    pub fn distribution(&self) -> Distribution {
        if self.count == 0 {
            return Distribution::default();
        }
        let at = |share: f64| {
            let wanted = ((share * self.count as f64).ceil() as u64).max(1);
            let mut below = 0;
            let mut reached = self.counts.iter().map(|count| {
                below += count;
                below >= wanted
            });
            reached.position(|reached| reached).map_or(self.max, |place| end_of(place).min(self.max))
        };
        Distribution { count: self.count, p50: at(0.5), p99: at(0.99), p999: at(0.999), max: self.max }
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
    use hdrhistogram::Histogram;
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
            let mut durations = Durations::new();
            let mut reference = Histogram::<u64>::new_with_bounds(1, CLAMP_NS, 3).unwrap();
            let mut max = 0;
            for _ in 0..=case * case {
                // From nothing to past the end, every magnitude alike.
                let ns = rng.random_range(0..20_000_000_000) >> rng.random_range(0..34);
                durations.add(ns);
                reference.record(ns.min(CLAMP_NS)).unwrap();
                max = max.max(ns);
            }
            let at = |share| reference.value_at_quantile(share).min(max);
            let expected = Distribution { count: reference.len(), p50: at(0.5), p99: at(0.99), p999: at(0.999), max };
            assert_eq!(durations.distribution(), expected, "{case}");
        }
        assert_eq!(Durations::new().distribution(), Distribution::default());
    }
}
