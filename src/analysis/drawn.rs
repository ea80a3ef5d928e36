//! Figures of a report that need a model and recorded runs: friction, correlation, poses of the arm, durations of the loop.

use crate::analysis::pipeline;
use crate::dataset::Run;
use crate::failure::Failure;
use crate::report::figures::{Bin, DurationFigure, FrictionFigure, PlanFigure};
use plumbline_core::{Record, Workspace};
use plumbline_excite::Fourier;
use plumbline_identify::Settings;
use plumbline_identify::solve::Identification;
use plumbline_model::{Chain, Robot, TorqueModel};

/// The term of friction.
const FRICTION: &str = "friction";
/// Bins over a velocity or displacement.
const BINS: usize = 48;
/// Fewest samples of a bin that is drawn.
const MIN_SAMPLES: usize = 5;
/// Bins over the displacement since a reversal: from here \[rad\],
const FIRST_DISPLACEMENT: f64 = 1e-4;
/// to here \[rad\].
const LAST_DISPLACEMENT: f64 = 1.0;
/// A joint that is slower has no direction \[rad/s\].
const MIN_SPEED: f64 = 1e-3;

/// Friction of every joint along a run: measured and modelled torque less that of rigid bodies, rotors and offsets.
///
/// # Errors
/// As [`pipeline::experiment`].
pub fn friction(model: &TorqueModel, run: &Run, settings: &Settings) -> Result<Vec<FrictionFigure>, Failure> {
    let rest = model.part(|term| term.spec().is_none() && term.id() != FRICTION).map_err(Failure::job)?;
    if rest.parameters().len() == model.parameters().len() {
        return Ok(Vec::new());
    }
    let experiment = pipeline::experiment(&run.data, settings)?;
    let motion = &experiment.motion;
    let (all, rest) = (model.predict(motion), rest.predict(motion));
    let joint = |j: usize| {
        let moved = since_reversal(motion.q.column(j).iter().copied(), motion.dq.column(j).iter().copied());
        let samples = || (0..motion.samples()).map(|k| (k, motion.dq[(k, j)]));
        let beyond = |k: usize| [experiment.tau[(k, j)] - rest[(k, j)], all[(k, j)] - rest[(k, j)]];
        let fastest = samples().fold(MIN_SPEED, |fastest, (_, speed)| fastest.max(speed.abs()));
        let place = |speed: f64| (speed / fastest + 1.0) / 2.0;
        let velocity = binned(samples().map(|(k, speed)| (place(speed), speed, beyond(k))));
        let scale = (LAST_DISPLACEMENT / FIRST_DISPLACEMENT).ln();
        let along = samples().zip(&moved).filter_map(|((k, speed), moved)| {
            let moved = moved.filter(|_| speed.abs() > MIN_SPEED)?;
            let place = (moved / FIRST_DISPLACEMENT).ln() / scale;
            (0.0..=1.0).contains(&place).then(|| (place, moved, beyond(k).map(|torque| torque * speed.signum())))
        });
        FrictionFigure { joint: j + 1, velocity, displacement: binned(along) }
    };
    Ok((0..run.joints()).map(joint).collect())
}

/// Means in bins of samples with place (0 to 1), value, measured and modelled torque.
fn binned(samples: impl Iterator<Item = (f64, f64, [f64; 2])>) -> Vec<Bin> {
    let mut sums = vec![(0usize, [0.0; 4]); BINS];
    for (place, x, [measured, modelled]) in samples {
        let (count, [sum_x, sum, squares, model]) = &mut sums[((place * BINS as f64) as usize).min(BINS - 1)];
        *count += 1;
        *sum_x += x;
        *sum += measured;
        *squares += measured * measured;
        *model += modelled;
    }
    let bin = |(count, [x, sum, squares, model]): (usize, [f64; 4])| {
        let count = count as f64;
        let measured = sum / count;
        let deviation = (squares / count - measured * measured).max(0.0).sqrt();
        Bin { x: x / count, measured, deviation, modelled: model / count }
    };
    sums.into_iter().filter(|(count, _)| *count >= MIN_SAMPLES).map(bin).collect()
}

/// Displacement since the joint's last reversal \[rad\]; `None` before the first.
fn since_reversal(q: impl Iterator<Item = f64>, dq: impl Iterator<Item = f64>) -> Vec<Option<f64>> {
    let (mut direction, mut begin) = (0.0, None);
    let mut moved = Vec::new();
    for (q, dq) in q.zip(dq) {
        if dq != 0.0 && dq.signum() != direction {
            // The direction at the begin of the recording is no reversal.
            begin = (direction != 0.0).then_some(q);
            direction = dq.signum();
        }
        moved.push(begin.map(|begin: f64| (q - begin).abs()));
    }
    moved
}

/// Correlation of the parameters' errors, p x p: 1 on the diagonal, 0 beside parameters that are not determined.
pub fn correlation(of: &Identification) -> Vec<Vec<f64>> {
    let covariance = &of.covariance;
    let std: Vec<f64> = covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect();
    let cell = |c: usize, d: usize| match std[c] * std[d] {
        both if both > 0.0 => covariance[(c, d)] / both,
        _ => f64::from(u8::from(c == d)),
    };
    (0..std.len()).map(|c| (0..std.len()).map(|d| cell(c, d)).collect()).collect()
}

/// The arm in a pose: base, origin of each link frame, end effector, in the base frame \[m\].
pub fn pose(chain: &Chain, q: &[f64]) -> Vec<[f64; 3]> {
    let mut at = plumbline_model::Placement::identity();
    let mut points = vec![at.origin.into()];
    for (joint, q) in chain.joints().iter().zip(q) {
        at = at.then(&joint.placement(*q));
        points.push(at.origin.into());
    }
    points.push(chain.end_effector(q).into());
    points
}

/// Points of a period that is drawn.
const POINTS: usize = 500;
/// Poses of the arm that are drawn along a motion.
const POSES: usize = 100;

/// One period of a planned motion of `robot` in a workspace.
pub fn plan(robot: &Robot, workspace: Workspace, motion: &Fourier) -> PlanFigure {
    let n = motion.joints();
    let t: Vec<f64> = (0..POINTS).map(|k| k as f64 * motion.period / (POINTS - 1) as f64).collect();
    let q: Vec<Vec<f64>> = (0..n).map(|j| t.iter().map(|&t| motion.at(j, t).q).collect()).collect();
    let at = |k: usize| q.iter().map(|q| q[k]).collect::<Vec<_>>();
    PlanFigure {
        end_effector: (0..POINTS).map(|k| robot.chain.end_effector(&at(k)).into()).collect(),
        poses: (0..POINTS).step_by(POINTS.div_ceil(POSES)).map(|k| pose(&robot.chain, &at(k))).collect(),
        limits: (0..n).map(|j| [robot.limits.q_min[j], robot.limits.q_max[j]]).collect(),
        workspace: Some(workspace),
        t,
        q,
    }
}

/// Bins per decade of a duration.
const PER_DECADE: usize = 10;
/// Decades from a tenth of a microsecond on.
const DECADES: usize = 7;
const FIRST_NS: f64 = 100.0;

/// Wake-up latencies and execution times of the loop, counted from its records.
#[derive(Clone, Debug)]
pub struct Durations {
    wake: Vec<u64>,
    work: Vec<u64>,
}

impl Default for Durations {
    fn default() -> Durations {
        let empty = vec![0; PER_DECADE * DECADES];
        Durations { wake: empty.clone(), work: empty }
    }
}

impl Durations {
    pub fn add(&mut self, record: &Record) {
        let bin = |ns: u64| ((ns as f64 / FIRST_NS).max(1.0).log10() * PER_DECADE as f64) as usize;
        for (counts, ns) in [(&mut self.wake, record.wake_ns), (&mut self.work, record.work_ns)] {
            // A loop without a deadline has no wake-up latency.
            if ns > 0 {
                let last = counts.len() - 1;
                counts[bin(ns).min(last)] += 1;
            }
        }
    }

    /// The bins between the shortest and the longest duration; nothing of what was not measured.
    pub fn figures(&self) -> Vec<DurationFigure> {
        let figure = |(title, counts): (&str, &Vec<u64>)| {
            let first = counts.iter().position(|count| *count > 0)?;
            let last = counts.iter().rposition(|count| *count > 0)?;
            let edge = |bin: usize| FIRST_NS * 1e-3 * 10f64.powf(bin as f64 / PER_DECADE as f64);
            let edges = (first..=last + 1).map(edge).collect();
            Some(DurationFigure { title: title.into(), edges, counts: counts[first..=last].to_vec() })
        };
        [("wake-up latency", &self.wake), ("execution time", &self.work)].into_iter().filter_map(figure).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn displacement_begins_anew_at_every_reversal() {
        let (q, dq) = ([0.0, 1.0, 2.0, 1.5, 1.0, 1.2], [1.0, 1.0, 1.0, -1.0, -1.0, 1.0]);
        let moved = since_reversal(q.into_iter(), dq.into_iter());
        assert_eq!(moved, [None, None, None, Some(0.0), Some(0.5), Some(0.0)]);
    }

    #[test]
    fn bins_hold_means_and_leave_out_what_is_rare() {
        let samples = (0..10).map(|k| (0.5, 2.0, [f64::from(k % 2), 0.25])).chain([(0.9, 1.0, [9.0, 9.0])]);
        let bins = binned(samples);
        assert_eq!(bins, [Bin { x: 2.0, measured: 0.5, deviation: 0.5, modelled: 0.25 }]);
    }

    #[test]
    fn durations_are_counted_on_a_logarithmic_scale() {
        let mut durations = Durations::default();
        for (wake_ns, work_ns) in [(0, 1_000), (0, 1_050), (0, 90_000)] {
            durations.add(&Record { wake_ns, work_ns, ..Record::default() });
        }
        let [work] = &durations.figures()[..] else { panic!("{:?}", durations.figures()) };
        assert_eq!((work.counts.iter().sum::<u64>(), work.counts[0]), (3, 2));
        assert_eq!(work.edges.len(), work.counts.len() + 1);
        assert!((work.edges[0] - 1.0).abs() < 1e-9 && *work.edges.last().unwrap() > 90.0, "{work:?}");
    }
}
