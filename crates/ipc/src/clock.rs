//! Ages of values whose stamps are of another machine's clock.

use std::fs;
use std::path::Path;

/// Half of the window of the offset \[ns\]. Clocks of two machines drift by up to 100 ppm: by 1 ms in the whole window.
const HALF_WINDOW_NS: u64 = 5_000_000_000;
/// Maximum part of a pause between two values that counts for the window \[ns\]: values that were queued while a link was down are compared
/// with the offset from before, not with each other.
const MAX_PAUSE_NS: u64 = 1_000_000_000;

/// Identity of this process's `CLOCK_BOOTTIME`: FNV-1a (32 bit) of `boot_id` and the link of the time namespace, not 0. 0 where the kernel
/// does not show both.
pub(super) fn identity() -> u32 {
    let boot = fs::read_to_string("/proc/sys/kernel/random/boot_id");
    let namespace = fs::read_link("/proc/self/ns/time");
    boot.and_then(|boot| Ok(identity_of(boot.trim_end(), &namespace?))).unwrap_or(0)
}

fn identity_of(boot: &str, namespace: &Path) -> u32 {
    let bytes = boot.bytes().chain(namespace.to_string_lossy().bytes().collect::<Vec<_>>());
    bytes.fold(0x811c_9dc5_u32, |hash, byte| (hash ^ u32::from(byte)).wrapping_mul(0x0100_0193)).max(1)
}

/// The clock that stamps the values of one daemon, as seen by a client.
///
/// The offset between two machines' clocks is estimated by the smallest difference of arrival and stamp over the last 5 to 10 s in which values
/// arrived: an age is then the age beyond that of the fastest transit. The estimate is late by the window where the daemon's clock falls
/// behind (slewing, a paused virtual machine), and immediate where it gains.
#[derive(Clone, Copy, Debug)]
pub(super) struct StampClock {
    /// Identity of this process's clock, 0 where it is unknown.
    own: u32,
    /// Identity of the clock of the last value.
    of: u32,
    /// Whether a value has arrived after the first of another clock, which may be from before this client.
    estimated: bool,
    arrived_ns: u64,
    /// Time since this half of the window began \[ns\].
    half_ns: u64,
    /// Smallest arrival less stamp, of the half before and of this one \[ns\].
    smallest_ns: [i64; 2],
}

impl StampClock {
    /// For a process whose own clock has the [`identity()`] `own`.
    pub(super) fn new(own: u32) -> StampClock {
        StampClock { own, of: own, estimated: false, arrived_ns: 0, half_ns: 0, smallest_ns: [0; 2] }
    }

    /// Whether stamps of clock `clock` are not of this process's. A clock of unknown identity (0) is taken for the own one.
    pub(super) fn is_foreign(&self, clock: u32) -> bool {
        self.own != 0 && clock != 0 && clock != self.own
    }

    /// Takes a value with its stamp by clock `clock` and the time at which it arrived, by this process's clock.
    pub(super) fn take(&mut self, clock: u32, stamp_ns: u64, arrived_ns: u64) {
        let before = std::mem::replace(&mut self.of, clock);
        let since_last_ns = arrived_ns.saturating_sub(std::mem::replace(&mut self.arrived_ns, arrived_ns));
        if !self.is_foreign(clock) {
            return;
        }
        let difference = difference(arrived_ns, stamp_ns);
        if before != clock {
            (self.estimated, self.half_ns, self.smallest_ns) = (false, 0, [difference; 2]);
            return;
        }
        self.estimated = true;
        self.half_ns += since_last_ns.min(MAX_PAUSE_NS);
        if self.half_ns >= HALF_WINDOW_NS {
            self.half_ns = 0;
            self.smallest_ns = [self.smallest_ns[1], difference];
        }
        self.smallest_ns[1] = self.smallest_ns[1].min(difference);
    }

    /// Age of the last value, which has this stamp, at `now_ns` \[ns\]; `None` while the offset of another machine's clock is unknown.
    pub(super) fn age_ns(&self, stamp_ns: u64, now_ns: u64) -> Option<u64> {
        if !self.is_foreign(self.of) {
            return Some(now_ns.saturating_sub(stamp_ns));
        }
        let offset = self.smallest_ns[0].min(self.smallest_ns[1]);
        self.estimated.then(|| difference(now_ns, stamp_ns).saturating_sub(offset).max(0) as u64)
    }
}

/// `a - b` for any two values of a message: wraps, as no clock does.
fn difference(a: u64, b: u64) -> i64 {
    a.wrapping_sub(b) as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;
    const S: u64 = 1_000_000_000;
    const OWN: u32 = 1;
    const OTHER: u32 = 2;

    /// Takes a value every millisecond, `transit_ns` after its stamp by a clock that is `offset_ns` ahead and gains `ppm`; the ages.
    fn stream(
        clock: &mut StampClock,
        seconds: std::ops::Range<u64>,
        offset_ns: i64,
        ppm: f64,
        transit_ns: impl Fn(u64) -> u64,
    ) -> Vec<u64> {
        let value = |k: u64| {
            let (sent_ns, transit_ns) = (k * MS, transit_ns(k));
            let stamp_ns = (sent_ns as i64 + offset_ns + (sent_ns as f64 * ppm * 1e-6) as i64) as u64;
            clock.take(OTHER, stamp_ns, sent_ns + transit_ns);
            clock.age_ns(stamp_ns, sent_ns + transit_ns)
        };
        (seconds.start * 1000..seconds.end * 1000).filter_map(value).collect()
    }

    #[test]
    fn the_identity_of_a_clock_is_that_of_boot_and_namespace() {
        let here = identity();
        assert_eq!(here, identity());
        // Published test vectors of FNV-1a.
        assert_eq!(identity_of("", Path::new("")), 0x811c_9dc5);
        assert_eq!(identity_of("foo", Path::new("bar")), 0xbf9c_f968);
    }

    #[test]
    fn ages_by_the_own_clock_and_by_an_unknown_one_are_differences() {
        for (own, of) in [(OWN, OWN), (0, OTHER), (OWN, 0)] {
            let mut clock = StampClock::new(own);
            clock.take(of, 5, 7);
            assert_eq!((clock.age_ns(5, 9), clock.age_ns(9, 5)), (Some(4), Some(0)));
        }
    }

    #[test]
    fn ages_by_another_clock_are_those_beyond_the_fastest_transit() {
        let transit = |k: u64| MS + if k.is_multiple_of(10) { 0 } else { k % 7 * 100_000 };
        for offset in [-3_600 * S as i64, 40 * S as i64, 100_000 * S as i64] {
            for ppm in [-100.0, 0.0, 100.0] {
                let mut clock = StampClock::new(OWN);
                let ages = stream(&mut clock, 4000..4060, offset, ppm, transit);
                // The first value gives the offset only.
                assert_eq!(ages.len(), 59_999);
                // From the first fast transit on; the drift of the window is 1 ms.
                for (k, age) in ages.iter().enumerate().skip(10) {
                    let error = *age as i64 - (transit(4_000_001 + k as u64) - MS) as i64;
                    assert!(error.abs() <= MS as i64 + 20_000, "value {k} at {ppm} ppm: {error} ns");
                }
            }
        }
    }

    #[test]
    fn values_that_were_queued_while_the_link_was_down_are_as_old_as_they_are() {
        let mut clock = StampClock::new(OWN);
        stream(&mut clock, 0..20, 7, 0.0, |_| MS);
        // Down for a minute; two seconds of values arrive at once afterwards, then new ones.
        let queued = stream(&mut clock, 20..22, 7, 0.0, |k| 80 * S - k * MS);
        assert!(queued.iter().all(|age| *age > 57 * S), "{queued:?}");
        assert!(stream(&mut clock, 80..81, 7, 0.0, |_| MS).iter().all(|age| *age == 0));
    }

    #[test]
    fn a_clock_that_falls_behind_makes_values_old_for_the_window_and_another_boot_starts_again() {
        let mut clock = StampClock::new(OWN);
        stream(&mut clock, 20..40, 0, 0.0, |_| MS);
        let after = stream(&mut clock, 40..60, -(50 * MS as i64), 0.0, |_| MS);
        assert!(after[..4000].iter().all(|age| *age == 50 * MS));
        assert!(after[10_001..].iter().all(|age| *age == 0));

        clock.take(3, 5 * S, 60 * S);
        assert_eq!(clock.age_ns(5 * S, 60 * S), None);
        clock.take(3, 6 * S, 61 * S);
        assert_eq!(clock.age_ns(6 * S, 62 * S), Some(S));
    }

    #[test]
    fn any_stamp_has_an_age() {
        let mut clock = StampClock::new(OWN);
        for stamp in [u64::MAX, 0, i64::MAX as u64, 1 << 63] {
            for now in [0, 1, u64::MAX] {
                clock.take(OTHER, stamp, now);
                let _ = clock.age_ns(stamp, now.wrapping_add(1));
            }
        }
    }
}
