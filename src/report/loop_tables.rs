//! Tables of the real-time loop: connections to the arm, links over a network, durations.

use super::Report;
use super::summary::digits;
use minijinja::{Value, context};
use plumbline_ipc::Session;

fn sessions_of(report: &Report) -> &[Session] {
    report.control_loop.as_ref().map_or(&[], |of| &of.sessions)
}

pub(super) fn sessions(report: &Report) -> Vec<Value> {
    let known = |count: Option<u64>| count.map_or("-".to_string(), |count| count.to_string());
    let row = |s: &Session| {
        let of = &s.statistics;
        context! {
            name => &s.name, cycles => of.cycles, elapsed => of.elapsed, lost => of.lost, longest => of.longest_lost,
            late => known(of.late), records => of.dropped_records, allocations => known(s.allocations.map(u64::from)), end => &s.end,
        }
    };
    sessions_of(report).iter().map(row).collect()
}

pub(super) fn refusals(report: &Report) -> Vec<String> {
    let of = report.control_loop.as_ref();
    of.map_or(Vec::new(), |of| of.refusals().into_iter().map(str::to_string).collect())
}

/// Connections over a network, one row each.
pub(super) fn links(report: &Report) -> Vec<Value> {
    let row = |s: &Session| {
        let link = s.link.as_ref()?;
        let percent = |share: f64| format!("{:.2} %", 100.0 * share);
        let success =
            link.success.map_or("-".to_string(), |[least, mean]| format!("{} / {}", percent(least), percent(mean)));
        let vector = |of: Option<[f64; 3]>| of.map_or("-".to_string(), |[x, y, z]| format!("[{x:.2}, {y:.2}, {z:.2}]"));
        let (gravity, compensates) = (vector(link.gravity), vector(link.compensates));
        Some(context! {
            name => &s.name, robot => &link.robot, states => link.states, lost => link.lost, passed => link.passed_over, odd => link.odd, late => link.late,
            limited => link.limited, success, gravity, compensates, fault => &link.fault,
        })
    };
    sessions_of(report).iter().filter_map(row).collect()
}

/// Every duration that was measured, with its name: median, 99th and 99.9th percentile and largest value \[us\].
pub(super) fn durations_of(report: &Report) -> Vec<(String, [f64; 4])> {
    let mut rows = Vec::new();
    for s in sessions_of(report) {
        let of = &s.statistics;
        let mut times =
            vec![("wake-up", of.wake_up), ("execution", of.execution), ("period", of.period), ("bridge", s.bridge)];
        if let Some(link) = &s.link {
            times.extend([
                ("turnaround", link.turnaround),
                ("wait in the socket", link.wake),
                ("round trip", link.round_trip),
                ("state to state", link.interval),
            ]);
        }
        rows.extend(
            times.into_iter().filter_map(|(what, times)| Some((format!("{what}, {}", s.name), times.in_us()?))),
        );
    }
    rows
}

pub(super) fn durations(report: &Report) -> Vec<Value> {
    let row = |(what, times): (String, [f64; 4])| {
        let [p50, p99, p999, max] = times.map(digits);
        context! { what, p50, p99, p999, max }
    };
    durations_of(report).into_iter().map(row).collect()
}
