//! Wake-up latency of a thread with the loop's rights, measured for a few seconds.

use super::{Finding, Requirements, Verdict};
use plumbline_core::{Distribution, Histogram, PERIOD_NS};
use plumbline_rt::become_realtime;
use plumbline_rt::os::{now_ns, sleep_until};
use serde::Serialize;

/// Classes of the largest delay, after the usual reading of LinuxCNC's latency test
/// (<https://linuxcnc.org/docs/html/install/latency-test.html>).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Class {
    /// Below 20 us.
    Excellent,
    /// 20 us to 50 us.
    Good,
    /// 50 us to 500 us: half of a period is left.
    Usable,
    /// More than 500 us.
    Unfit,
}

impl Class {
    /// Class of a largest delay \[ns\].
    pub fn of(max_ns: u64) -> Class {
        match max_ns {
            0..20_000 => Class::Excellent,
            20_000..50_000 => Class::Good,
            50_000..=500_000 => Class::Usable,
            _ => Class::Unfit,
        }
    }

    fn words(self) -> &'static str {
        match self {
            Class::Excellent => "excellent (below 20 us)",
            Class::Good => "good (20 to 50 us)",
            Class::Usable => "usable (50 to 500 us)",
            Class::Unfit => "unfit (more than 500 us)",
        }
    }
}

/// Measures the wake-up latency of a 1 ms period for `seconds`, with the granted rights.
pub fn wake_ups(requirements: &Requirements, seconds: u64) -> Finding {
    let rights = requirements.rights.clone();
    let measured = std::thread::Builder::new().spawn(move || {
        become_realtime(&rights);
        measure(seconds.saturating_mul(1000))
    });
    match measured.map(|thread| thread.join()) {
        Ok(Ok(Some(delays))) => finding(&delays, seconds),
        _ => Finding::unknown("wake-up", "no thread could be started to measure with"),
    }
}

fn measure(wake_ups: u64) -> Option<Distribution> {
    let delays = Histogram::default();
    let mut deadline = now_ns().saturating_add(PERIOD_NS);
    for _ in 0..wake_ups {
        sleep_until(deadline);
        let now = now_ns();
        delays.add(now.saturating_sub(deadline));
        // As in the loop, missed periods are skipped.
        let slept = now.saturating_sub(deadline) / PERIOD_NS;
        deadline = deadline.saturating_add((slept + 1).saturating_mul(PERIOD_NS));
    }
    Some(delays.distribution())
}

fn finding(delays: &Distribution, seconds: u64) -> Finding {
    let us = |ns: u64| ns as f64 / 1e3;
    let class = Class::of(delays.max_ns);
    let found = format!(
        "{}: p50 {:.1}, p99 {:.1}, p99.9 {:.1}, max {:.1} us over {seconds} s",
        class.words(),
        us(delays.p50_ns),
        us(delays.p99_ns),
        us(delays.p999_ns),
        us(delays.max_ns)
    );
    let (verdict, change) = match class {
        Class::Excellent | Class::Good => (Verdict::Fit, None),
        Class::Usable => (Verdict::Fit, Some("follow the advice above")),
        Class::Unfit => {
            (Verdict::Unfit, Some("the changes above, then firmware: power saving, system management, updates"))
        }
    };
    Finding { name: "wake-up", verdict, found, change: change.map(str::to_string) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn classes_are_those_of_the_largest_delay() {
        let of = |us: u64| Class::of(us * 1000);
        assert_eq!([of(0), of(19), of(20), of(49)], [Class::Excellent, Class::Excellent, Class::Good, Class::Good]);
        assert_eq!([of(50), of(500), of(501), of(9000)], [Class::Usable, Class::Usable, Class::Unfit, Class::Unfit]);
        let delays = Histogram::default();
        for ns in [5_000_u64, 6_000, 700_000] {
            delays.add(ns);
        }
        let unfit = finding(&delays.distribution(), 3);
        assert_eq!(unfit.verdict, Verdict::Unfit);
        assert!(unfit.found.contains("p50 6.0") && unfit.change.is_some(), "{unfit:?}");
    }
}
