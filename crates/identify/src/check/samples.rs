//! Checks of the channels as recorded: no model is fitted.

use super::{Finding, State, deviation, quantile, root_mean_square, torque_unit, unit, worst};
use crate::Run;
use nalgebra::DMatrix;
use plumbline_model::Robot;

/// Share of a joint's range by which a position may exceed its limits: robot files hold a controller's soft limits, which lie inside the
/// mechanical stops.
const MAX_BEYOND_RATIO: f64 = 0.05;
/// Least of that \[rad or m\].
const MIN_BEYOND: f64 = 0.01;
/// Ratio of a speed to the joint's limit: limits are of the command, which a joint may overshoot.
const WARN_SPEED_RATIO: f64 = 1.1;
const MAX_SPEED_RATIO: f64 = 2.0;
/// Time over which a speed is measured \[s\]: longer than the noise and shorter than a motion of 1 Hz.
const SPEED_WINDOW_S: f64 = 0.1;
/// Longest step in time \[s\]: at 10 Hz a motion of up to 2 Hz has five samples per period.
const MAX_STEP_S: f64 = 0.1;
/// Ratio of integrated velocities to differences of positions: a calibration may be off by a tenth, a unit or a sign is not.
const VELOCITY_RATIO: std::ops::RangeInclusive<f64> = 0.8..=1.25;
/// Least correlation of the two. A half is a signal as large as all else in the channel.
const MIN_VELOCITY_CORRELATION: f64 = 0.5;
/// Least excursion of a joint that moves \[rad or m\].
const MIN_MOVED: f64 = 0.02;
/// Ratio of the torque's RMS to the joint's limit. A limit holds for peaks, so that an RMS beyond is another unit or another robot.
const MAX_TORQUE_RATIO: f64 = 1.5;
/// Ratio of the torques' highest percentile to the limit.
const WARN_TORQUE_RATIO: f64 = 1.3;
/// Ratio of the largest joint's torque to its limit below which an arm would hardly carry its own links.
const MIN_TORQUE_RATIO: f64 = 0.005;
/// Longest share of a run in which a torque may hold one value while its joint moves.
const MAX_FROZEN_RATIO: f64 = 0.2;

/// Checks every channel of a run against the robot's limits and against the other channels. `run.tau` may have no columns.
///
/// | check | compares |
/// |---|---|
/// | `time` | the median step with what a motion needs |
/// | `position` | q with the joints' ranges |
/// | `speed` | d(q)/dt over 0.1 s with the joints' speed limits |
/// | `velocity` | dq, integrated, with the differences of q |
/// | `torque` | RMS and 99.9th percentile of tau with the joints' torque limits |
/// | `channel` | channels with themselves and each other: constant, frozen, copied |
/// | `period` | q with itself one `period` later |
pub fn samples(robot: &Robot, run: &Run) -> Vec<Finding> {
    let mut findings = vec![time(run)];
    findings.extend(worst(positions(robot, run)));
    findings.extend(worst(speeds(robot, run)));
    findings.extend(worst(velocities(run)));
    findings.extend(torques(robot, run));
    findings.extend(worst(channels(robot, run)));
    findings.extend(super::period::repeats(run));
    findings
}

/// Median of the steps that are not zero \[s\].
pub(super) fn step(run: &Run) -> f64 {
    quantile(run.t.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 0.0).collect(), 0.5)
}

fn time(run: &Run) -> Finding {
    let step = step(run);
    let finding = Finding::new("time", &run.name, "column t").measured(step, MAX_STEP_S, "s");
    if step <= MAX_STEP_S {
        return finding;
    }
    let unit = match step {
        step if step >= 1e5 => "nanoseconds",
        step if step >= 100.0 => "microseconds",
        _ => "milliseconds",
    };
    let found = format!("{step:.4} s from one sample to the next");
    finding.state(State::Fail).says(found, format!("at most {MAX_STEP_S} s (is t in {unit}?)"))
}

fn positions(robot: &Robot, run: &Run) -> Vec<Finding> {
    let of = |j: usize| {
        let (low, high) = (robot.limits.q_min[j], robot.limits.q_max[j]);
        let (least, most) = run.q.column(j).iter().fold((f64::MAX, f64::MIN), |(a, b), &q| (a.min(q), b.max(q)));
        let beyond = (low - least).max(most - high).max(0.0);
        let allowed = (MAX_BEYOND_RATIO * (high - low)).max(MIN_BEYOND);
        let unit = unit(robot, j);
        let state = match beyond {
            beyond if beyond > allowed => State::Fail,
            beyond if beyond > MIN_BEYOND => State::Warn,
            _ => State::Pass,
        };
        let furthest = if most - high > low - least { most } else { least };
        let hint = match unit {
            "m" if beyond > 100.0 * (high - low) => "are the positions in mm?",
            "m" => "is it the data of another robot?",
            // Ten degrees, read as radians, are more than a turn and a half.
            _ if furthest.abs() > 8.0 => "are the positions in degrees?",
            _ if state == State::Fail => {
                "is it the data of another robot, or is a sign or a zero different? If not, extend the range in the robot file"
            }
            _ => "its zero may be off",
        };
        Finding::new("position", &run.name, format!("column q{}", j + 1))
            .of_joint(j)
            .measured(beyond, allowed, unit)
            .state(state)
            .says(
                format!("{furthest:.4} {unit}"),
                format!("{low} to {high} {unit}, the range of joint {} of {} ({hint})", j + 1, robot.name),
            )
    };
    (0..run.joints()).map(of).collect()
}

/// Pairs of rows about [`SPEED_WINDOW_S`] apart, at most some thousands.
fn windows(run: &Run) -> Vec<(usize, usize)> {
    let stride = (run.samples() / 5000).max(1);
    let mut end = 0;
    let mut pairs = Vec::new();
    for first in (0..run.samples()).step_by(stride) {
        while end < run.samples() && run.t[end] - run.t[first] < SPEED_WINDOW_S {
            end += 1;
        }
        if end == run.samples() {
            break;
        }
        // Not across a gap, in which anything may happen.
        if run.t[end] - run.t[first] < 2.0 * SPEED_WINDOW_S + 2.0 * step_before(run, end) {
            pairs.push((first, end));
        }
    }
    pairs
}

fn step_before(run: &Run, k: usize) -> f64 {
    run.t[k] - run.t[k.saturating_sub(1)]
}

fn speeds(robot: &Robot, run: &Run) -> Vec<Finding> {
    let pairs = windows(run);
    let of = |j: usize| {
        let speed = |&(a, b): &(usize, usize)| ((run.q[(b, j)] - run.q[(a, j)]) / (run.t[b] - run.t[a])).abs();
        let (top, limit) = (quantile(pairs.iter().map(speed).collect(), 0.999), robot.limits.dq[j]);
        let ratio = top / limit;
        let state = match ratio {
            ratio if ratio > MAX_SPEED_RATIO => State::Fail,
            ratio if ratio > WARN_SPEED_RATIO => State::Warn,
            _ => State::Pass,
        };
        let unit = unit(robot, j);
        let hint = match ratio {
            ratio if ratio > 100.0 => "are the times or the positions in another unit?",
            ratio if ratio > 20.0 => "are the positions in degrees?",
            _ => "are the times right, and is it the data of this robot?",
        };
        Finding::new("speed", &run.name, format!("columns t and q{}", j + 1))
            .of_joint(j)
            .measured(top, WARN_SPEED_RATIO * limit, &format!("{unit}/s"))
            .state(state)
            .says(
                format!("positions that move at {top:.3} {unit}/s"),
                format!("at most {limit} {unit}/s, the limit of joint {} of {} ({hint})", j + 1, robot.name),
            )
    };
    (0..run.joints()).map(of).collect()
}

/// Differences of the positions over the windows, and integrals of the velocities over the same.
fn travelled(run: &Run, dq: &DMatrix<f64>, pairs: &[(usize, usize)], j: usize) -> (Vec<f64>, Vec<f64>) {
    let mut integral = vec![0.0; run.samples()];
    for k in 1..run.samples() {
        integral[k] = integral[k - 1] + 0.5 * (dq[(k, j)] + dq[(k - 1, j)]) * (run.t[k] - run.t[k - 1]);
    }
    pairs.iter().map(|&(a, b)| (run.q[(b, j)] - run.q[(a, j)], integral[b] - integral[a])).unzip()
}

fn velocities(run: &Run) -> Vec<Finding> {
    let Some(dq) = &run.dq else { return Vec::new() };
    let pairs = windows(run);
    let of = |j: usize| {
        let (moved, integrated) = travelled(run, dq, &pairs, j);
        let (of_q, of_dq) = (root_mean_square(moved.iter().copied()), root_mean_square(integrated.iter().copied()));
        let both = moved.iter().zip(&integrated).map(|(a, b)| a * b).sum::<f64>() / moved.len().max(1) as f64;
        let correlation = if of_q * of_dq > 0.0 { both / (of_q * of_dq) } else { 0.0 };
        let ratio = if of_q > 0.0 { both / (of_q * of_q) } else { 0.0 };
        let right = VELOCITY_RATIO.contains(&ratio) && correlation >= MIN_VELOCITY_CORRELATION;
        let hint: &str = match ratio {
            _ if of_dq == 0.0 => "is the column empty?",
            _ if correlation.abs() < MIN_VELOCITY_CORRELATION => "is it the column of another joint?",
            ratio if (50.0..65.0).contains(&ratio) => "are the velocities in degrees per second?",
            ratio if (0.015..0.02).contains(&ratio) => "are the positions in degrees?",
            ratio if (-1.25..=-0.8).contains(&ratio) => "does one of them have the wrong sign?",
            ratio if (800.0..1250.0).contains(&ratio) => "is t in milliseconds, or dq in mrad/s?",
            ratio if (0.0008..0.00125).contains(&ratio) => "is dq per millisecond?",
            _ => "is one of them in another unit, or the time step wrong?",
        };
        Finding::new("velocity", &run.name, format!("columns q{0} and dq{0}", j + 1))
            .of_joint(j)
            .measured(ratio, *VELOCITY_RATIO.end(), "")
            .state(if right { State::Pass } else { State::Fail })
            .says(
                format!("velocities of {ratio:.4} times the change of the positions, correlation {correlation:.2}"),
                format!("velocities that are the change of the positions ({hint})"),
            )
    };
    let (pairs, n) = (&pairs, run.joints());
    let moves = |&j: &usize| {
        let excursion = |&(a, b): &(usize, usize)| (run.q[(b, j)] - run.q[(a, j)]).abs();
        quantile(pairs.iter().map(excursion).collect(), 0.9) > 0.1 * MIN_MOVED
    };
    (0..n).filter(moves).map(of).collect()
}

fn torques(robot: &Robot, run: &Run) -> Vec<Finding> {
    if run.tau.ncols() == 0 {
        return Vec::new();
    }
    let limit = |j: usize| robot.limits.tau[j];
    let of = |j: usize| {
        let column = run.tau.column(j);
        let (rms, top) =
            (root_mean_square(column.iter().copied()), quantile(column.iter().map(|tau| tau.abs()).collect(), 0.999));
        let state = match () {
            () if rms > MAX_TORQUE_RATIO * limit(j) => State::Fail,
            () if top > WARN_TORQUE_RATIO * limit(j) => State::Warn,
            () => State::Pass,
        };
        let hint = match rms / limit(j) {
            ratio if ratio > 20.0 => "are the torques in mNm?",
            _ => "is `torque.unit` or `torque.gain` right, and is it the data of this robot?",
        };
        let unit = torque_unit(robot, j);
        Finding::new("torque", &run.name, format!("column tau{}", j + 1))
            .of_joint(j)
            .measured(top, WARN_TORQUE_RATIO * limit(j), unit)
            .state(state)
            .says(
                format!("{rms:.1} {unit} RMS, up to {top:.1} {unit}"),
                format!("at most {} {unit}, the limit of joint {} of {} ({hint})", limit(j), j + 1, robot.name),
            )
    };
    let mut findings = worst((0..run.tau.ncols()).map(of).collect());
    let share = |j: usize| quantile(run.tau.column(j).iter().map(|tau| tau.abs()).collect(), 0.999) / limit(j);
    let largest = (0..run.tau.ncols()).map(share).fold(0.0, f64::max);
    if largest < MIN_TORQUE_RATIO {
        let (found, expected) = (
            format!("no torque above {:.3} % of its joint's limit", 100.0 * largest),
            "torques in Nm of an arm that carries its links (are they in kNm, or in A without a gain?)",
        );
        findings.push(
            Finding::new("torque", &run.name, "columns tau")
                .measured(largest, MIN_TORQUE_RATIO, "")
                .state(State::Warn)
                .says(found, expected),
        );
    }
    findings
}

fn channels(robot: &Robot, run: &Run) -> Vec<Finding> {
    let mut findings = Vec::new();
    for (stem, values) in [("q", &run.q), ("tau", &run.tau)] {
        for j in 0..values.ncols() {
            let finding = Finding::new("channel", &run.name, format!("column {stem}{}", j + 1)).of_joint(j);
            let copied =
                (0..j).find(|&i| values.column(i) == values.column(j) && deviation(values.column(j).as_slice()) > 0.0);
            if let Some(i) = copied {
                let found = format!("the same values as {stem}{} in every row", i + 1);
                findings.push(
                    finding
                        .clone()
                        .measured(1.0, MAX_FROZEN_RATIO, "")
                        .state(State::Fail)
                        .says(found, format!("values of joint {} of {}", j + 1, robot.name)),
                );
                continue;
            }
            if stem == "tau" {
                findings.push(frozen(run, j, finding));
            }
        }
    }
    findings
}

/// The longest stretch in which a torque holds one value while its joint moves.
fn frozen(run: &Run, j: usize, finding: Finding) -> Finding {
    let (mut longest, mut first, mut moved) = (0, 0, (f64::MAX, f64::MIN));
    for k in 0..run.samples() {
        if run.tau[(k, j)] != run.tau[(first, j)] {
            (first, moved) = (k, (f64::MAX, f64::MIN));
        }
        moved = (moved.0.min(run.q[(k, j)]), moved.1.max(run.q[(k, j)]));
        if moved.1 - moved.0 > MIN_MOVED {
            longest = longest.max(k + 1 - first);
        }
    }
    let share = longest as f64 / run.samples() as f64;
    let finding = finding.measured(share, MAX_FROZEN_RATIO, "");
    if share <= MAX_FROZEN_RATIO {
        return finding;
    }
    let found = format!("one value for {:.0} % of the run while the joint moves", 100.0 * share);
    finding.state(State::Fail).says(found, format!("a torque that varies (check the torque sensor of joint {})", j + 1))
}
