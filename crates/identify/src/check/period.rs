//! Whether a motion repeats with the period that the dataset declares.

use super::samples::step;
use super::{Finding, State, deviation};
use crate::Run;

/// Ratio of the distance between periods to that of the best period, from which on the declared one is wrong.
const MAX_DISTANCE_RATIO: f64 = 3.0;
/// Distance between periods, as a share of the motion's deviation, below which nothing is averaged away: a thousandth of the motion.
const MIN_DISTANCE: f64 = 1e-3;
/// Distance from which on two periods are two motions: half of what two unrelated motions have.
const MAX_DISTANCE: f64 = 0.7;
/// Samples at which two periods are compared.
const PROBES: usize = 500;
/// Steps of the search over all periods, and about the best of them.
const STEPS: usize = 800;
/// Ratio of a joint's deviation to the largest from which on it counts: the noise of a joint at rest repeats with no period.
const MIN_MOTION_RATIO: f64 = 0.1;

/// Compares `q(t)` with `q(t + period)`; nothing for a run without a period.
///
/// Distance: the RMS of `q(t + period) - q(t)` over all joints in units of each joint's deviation; sqrt(2) for unrelated motions.
/// The first fifth of the run is left out: there an arm may start from rest.
pub(super) fn repeats(run: &Run) -> Option<Finding> {
    let period = run.period?;
    let length = run.t[run.samples() - 1] - run.t[0];
    let finding = Finding::new("period", &run.name, "key `period`");
    let joints = moving(run);
    let distance = |lag: f64| distance(run, &joints, lag);
    let declared = distance(period)?;
    // Periods of at least eight samples; half a run is compared with the other half.
    let (least, most) = ((8.0 * step(run)).max(0.05 * period), 0.6 * length);
    let scan = |from: f64, to: f64| {
        let at = move |k: usize| from + (to - from) * k as f64 / STEPS as f64;
        let each = (0..=STEPS).filter_map(|k| Some((at(k), distance(at(k))?)));
        each.min_by(|a, b| a.1.total_cmp(&b.1))
    };
    let spacing = (most - least) / STEPS as f64;
    // Small lags are near because any motion is smooth.
    let coarse = (most > least).then(|| scan(least.max(0.3 * period), most)).flatten();
    let best = coarse.and_then(|(at, _)| scan(at - spacing, at + spacing));
    let nearby = scan(period * 0.97, (period * 1.03).min(length * 0.95));
    let best = [best, nearby].into_iter().flatten().min_by(|a, b| a.1.total_cmp(&b.1));
    let finding = finding.measured(declared, MAX_DISTANCE, "");
    let found = |words: String| {
        format!("{period} s: one period later the joints are {:.1} % of their motion away{words}", 100.0 * declared)
    };
    match best {
        Some((at, least)) if declared > MIN_DISTANCE && declared > MAX_DISTANCE_RATIO * least => {
            let words = format!(" ({:.1} % after {at:.4} s)", 100.0 * least);
            let limit = MAX_DISTANCE_RATIO * least.max(MIN_DISTANCE / MAX_DISTANCE_RATIO);
            Some(
                finding
                    .measured(declared, limit, "")
                    .state(State::Fail)
                    .says(found(words), format!("the period of the motion, about {at:.4} s")),
            )
        }
        _ if declared > MAX_DISTANCE => {
            let expected = "a motion that repeats with this period, or no key `period`";
            Some(finding.state(State::Fail).says(found(String::new()), expected))
        }
        _ => Some(finding),
    }
}

/// The joints that move, with their deviations.
fn moving(run: &Run) -> Vec<(usize, f64)> {
    let deviations: Vec<f64> = (0..run.joints()).map(|j| deviation(run.q.column(j).as_slice())).collect();
    let least = MIN_MOTION_RATIO * deviations.iter().copied().fold(0.0, f64::max);
    deviations.into_iter().enumerate().filter(|(_, deviation)| *deviation > least).collect()
}

/// Distance of the motion to itself `lag` later; `None` where the run is shorter.
fn distance(run: &Run, joints: &[(usize, f64)], lag: f64) -> Option<f64> {
    let (first, last) = (run.t[0], run.t[run.samples() - 1] - lag);
    if last <= first {
        return None;
    }
    let stride = (run.samples() / PROBES).max(1);
    let mut squares = Vec::with_capacity(PROBES + stride);
    for k in (0..run.samples()).step_by(stride).take_while(|&k| run.t[k] <= last) {
        let at = run.t[k] + lag;
        let next = run.t.partition_point(|t| *t < at).min(run.samples() - 1);
        let before = next.saturating_sub(1);
        let span = run.t[next] - run.t[before];
        let share = if span > 0.0 { ((at - run.t[before]) / span).clamp(0.0, 1.0) } else { 0.0 };
        let square = |&(j, deviation): &(usize, f64)| {
            let later = run.q[(before, j)] + share * (run.q[(next, j)] - run.q[(before, j)]);
            ((later - run.q[(k, j)]) / deviation).powi(2)
        };
        squares.push(joints.iter().map(square).sum::<f64>() / joints.len().max(1) as f64);
    }
    // Without the start, from which an arm may have to accelerate.
    let kept = &squares[squares.len() / 5..];
    (!kept.is_empty()).then(|| (kept.iter().sum::<f64>() / kept.len() as f64).sqrt())
}
