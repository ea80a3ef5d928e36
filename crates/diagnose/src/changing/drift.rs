//! What wanders through a recording: the zero of a torque sensor that warms up, friction that thins.
//!
//! A drift multiplies what the mean motion does by a course `g(t)`:
//!
//!   offset     `tau_j += a g(t)`
//!   friction   `tau_j += g(t) (b tanh(100 dq_j) + c dq_j)`, or in all joints `tau_j += s g(t) (fc_j tanh(100 dq_j) + fv_j dq_j)`
//!   course     `g = t` in minutes, or `g = 1 - exp(-t / T)`, or the warmth that a joint's own friction gives it,
//!              `T dg/dt = p / mean p - g` with the dissipated power `p = |(fc tanh(100 dq_j) + fv dq_j) dq_j|`, from `g = 0` on; between two runs
//!              `p = 0`. For a power that does not change that is `1 - exp(-t / T)`.

use super::record::Record;
use nalgebra::DMatrix;
use plumbline_identify::Experiment;
use plumbline_model::term::Motion;
use plumbline_model::term::effect::OperatingPoint;
use plumbline_model::term::friction::SHARPNESS;
use plumbline_model::term::{friction_drift, offset_drift};

/// How a drift goes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Course {
    /// In proportion to the time, in minutes.
    Linear,
    /// `1 - exp(-t / time)`.
    Saturating {
        /// Time constant \[s\].
        time: f64,
    },
    /// The warmth of a joint, of which the mean over all runs would be one in the end.
    Warming {
        /// The joint, from 0.
        joint: usize,
        /// Time constant \[s\].
        time: f64,
    },
}

impl Course {
    /// Its time constant \[s\].
    pub fn time(self) -> Option<f64> {
        match self {
            Course::Linear => None,
            Course::Saturating { time } | Course::Warming { time, .. } => Some(time),
        }
    }

    /// Another time constant.
    pub(super) fn with_time(self, time: f64) -> Course {
        match self {
            Course::Linear => self,
            Course::Saturating { .. } => Course::Saturating { time },
            Course::Warming { joint, .. } => Course::Warming { joint, time },
        }
    }

    pub(super) fn settings(self) -> usize {
        usize::from(self != Course::Linear)
    }

    /// Along each run, in the order of `records`.
    pub(super) fn along(self, shared: Shared, records: &[Record], operating_point: &OperatingPoint) -> Vec<Along> {
        let of_time = |function: &dyn Fn(f64) -> f64| {
            let of_run = |record: &Record| {
                let from = if shared == Shared::Course { record.start } else { 0.0 };
                Along::of(record, |row| function(from + record.since_begin(row)))
            };
            records.iter().map(of_run).collect()
        };
        match self {
            Course::Linear => of_time(&|t| t / 60.0),
            Course::Saturating { time } => of_time(&|t| -(-t / time).exp_m1()),
            Course::Warming { joint, time } => warmth(time, joint, shared, records, operating_point),
        }
    }
}

/// A course along one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Along {
    /// Name of the run.
    pub run: String,
    /// Its begin, since that of the first run \[s\].
    start: f64,
    /// Time of the first value since the first sample of the run, and between values \[s\].
    times: [f64; 2],
    values: Vec<f64>,
}

impl Along {
    /// From the first period of the run to the last that was kept, `value` by the row of the grid.
    fn of(record: &Record, value: impl FnMut(usize) -> f64) -> Along {
        let periods = record.repeats.periods.last().map_or(0, |last| last + 1);
        let values = (0..periods * record.samples).map(value).collect();
        let (run, times) = (record.experiment.name.clone(), [record.since_begin(0), record.dt]);
        Along { run, start: record.start, times, values }
    }

    /// At a row of the periods that were kept.
    pub(super) fn at_row(&self, record: &Record, row: usize) -> f64 {
        self.values[record.repeats.periods[row / record.samples] * record.samples + row % record.samples]
    }

    /// At a time since the first sample of the run \[s\].
    fn at(&self, t: f64) -> f64 {
        let place = ((t - self.times[0]) / self.times[1]).clamp(0.0, (self.values.len() - 1) as f64);
        let (left, share) = (place.floor(), place.fract());
        let value = |k: f64| self.values[(k as usize).min(self.values.len() - 1)];
        value(left) + share * (value(left + 1.0) - value(left))
    }

    fn last(&self) -> f64 {
        self.values.last().copied().unwrap_or(0.0)
    }
}

/// Friction of a joint over one period \[Nm\]; Coulomb friction of 1 Nm where it is not known.
pub(super) fn friction(joint: usize, motion: &Motion, operating_point: &OperatingPoint) -> Vec<f64> {
    let [fv, fc] = operating_point.friction.get(joint).copied().unwrap_or([0.0, 1.0]);
    motion.dq.column(joint).iter().map(|dq| fc * (SHARPNESS * dq).tanh() + fv * dq).collect()
}

fn warmth(time: f64, joint: usize, shared: Shared, records: &[Record], operating_point: &OperatingPoint) -> Vec<Along> {
    let power = |record: &Record| -> Vec<f64> {
        let friction = friction(joint, &record.motion, operating_point);
        friction.iter().zip(record.motion.dq.column(joint).iter()).map(|(tau, dq)| (tau * dq).abs()).collect()
    };
    let powers: Vec<Vec<f64>> = records.iter().map(power).collect();
    let seconds = |record: &Record| record.tau.nrows() as f64 * record.dt;
    let mean = |power: &Vec<f64>| power.iter().sum::<f64>() / power.len().max(1) as f64;
    let whole: f64 = records.iter().map(seconds).sum();
    let scale: f64 =
        powers.iter().zip(records).map(|(power, record)| mean(power) * seconds(record)).sum::<f64>() / whole;
    let mut order: Vec<usize> = (0..records.len()).collect();
    order.sort_by(|&a, &b| records[a].start.total_cmp(&records[b].start));
    let mut along: Vec<Option<Along>> = vec![None; records.len()];
    let (mut warmth, mut end) = (0.0, f64::NEG_INFINITY);
    for run in order {
        let (record, power) = (&records[run], &powers[run]);
        match shared {
            Shared::Course => warmth *= (-(record.start - end).max(0.0) / time).exp(),
            _ => warmth = 0.0,
        }
        let kept = (-record.dt / time).exp();
        let own = Along::of(record, |row| {
            warmth = kept * warmth + (1.0 - kept) * power[row % record.samples] / scale.max(f64::MIN_POSITIVE);
            warmth
        });
        end = record.start + own.values.len() as f64 * record.dt;
        along[run] = Some(own);
    }
    along.into_iter().flatten().collect()
}

/// What the runs of a recording share of a drift.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shared {
    /// Nothing: each run has its own parameters.
    Nothing,
    /// The parameters. The course begins anew with each run, as after a pause.
    Parameters,
    /// Parameters and course, which begins with the first run.
    Course,
}

/// What drifts. Joints count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drifting {
    /// The torque offset of a joint; parameters: `offset` \[Nm\].
    Offset(usize),
    /// The friction of a joint; parameters: `fc` \[Nm\], `fv` \[Nms/rad\].
    Friction(usize),
    /// The friction of all joints alike; parameters: `share` of the model's friction.
    AllFriction,
}

impl Drifting {
    /// Identity of the family.
    pub fn family(self) -> &'static str {
        match self {
            Drifting::Offset(_) => offset_drift::ID,
            Drifting::Friction(_) | Drifting::AllFriction => friction_drift::ID,
        }
    }

    /// Names and units of the parameters of a linear course, which are per minute; of the other as they would end.
    pub fn parameters(self) -> &'static [(&'static str, &'static str)] {
        match self {
            Drifting::Offset(_) => &[("offset", "Nm")],
            Drifting::Friction(_) => &[("fc", "Nm"), ("fv", "Nms/rad")],
            Drifting::AllFriction => &[("share", "1")],
        }
    }

    pub(super) fn joints(self, n: usize) -> Vec<usize> {
        match self {
            Drifting::Offset(joint) | Drifting::Friction(joint) => vec![joint],
            Drifting::AllFriction => (0..n).collect(),
        }
    }

    /// Whether both can't stand side by side.
    pub(super) fn excludes(self, other: Drifting) -> bool {
        self.family() == other.family()
            && (self == other || self == Drifting::AllFriction || other == Drifting::AllFriction)
    }

    /// What its course multiplies in a joint, over one period.
    pub(super) fn shapes(self, joint: usize, motion: &Motion, operating_point: &OperatingPoint) -> Vec<Vec<f64>> {
        let dq = motion.dq.column(joint);
        let sign = || dq.iter().map(|dq| (SHARPNESS * dq).tanh());
        match self {
            Drifting::Offset(_) => vec![vec![1.0; motion.samples()]],
            Drifting::Friction(_) => vec![sign().collect(), dq.iter().copied().collect()],
            Drifting::AllFriction => vec![friction(joint, motion, operating_point)],
        }
    }

    /// What it does to a run with these parameters, P N x n \[Nm\]; the mean over the periods is not taken off.
    pub(super) fn torque(
        self,
        along: &Along,
        values: &[f64],
        record: &Record,
        operating_point: &OperatingPoint,
    ) -> DMatrix<f64> {
        let mut tau = DMatrix::zeros(record.tau.nrows(), record.joints());
        for joint in self.joints(record.joints()) {
            for (shape, value) in self.shapes(joint, &record.motion, operating_point).iter().zip(values) {
                for row in 0..tau.nrows() {
                    tau[(row, joint)] += value * shape[row % record.samples] * along.at_row(record, row);
                }
            }
        }
        tau
    }
}

/// A drift that was found.
#[derive(Clone, Debug, PartialEq)]
pub struct Drift {
    /// What drifts.
    pub what: Drifting,
    /// How.
    pub course: Course,
    /// How along each run.
    pub along: Vec<Along>,
    /// What the runs share of it.
    pub shared: Shared,
    /// Parameters, one set for all runs or, where they share nothing, one per run.
    pub values: Vec<Vec<f64>>,
    /// Their standard deviations, alike.
    pub std: Vec<Vec<f64>>,
    /// Twice the gain in log likelihood.
    pub evidence: f64,
    /// Score.
    pub score: f64,
    /// Share of the deviations' mean square in the band that it explains, in its joints.
    pub explained: f64,
    /// RMS of what it does about the mean of the periods, per joint, over all runs \[Nm\].
    pub rms: Vec<f64>,
}

impl Drift {
    /// What it does to the mean period of a run, less what it does at the end of the last run, N x n \[Nm\]. Nothing in a run without repeats.
    pub(super) fn until_the_end(&self, experiment: &Experiment, operating_point: &OperatingPoint) -> DMatrix<f64> {
        let motion = &experiment.motion;
        let mut tau = DMatrix::zeros(motion.samples(), motion.joints());
        let Some(along) = self.along.iter().find(|along| along.run == experiment.name) else { return tau };
        let last = self.along.iter().max_by(|a, b| a.start.total_cmp(&b.start));
        let end = last.map_or(0.0, Along::last);
        let course = experiment.timeline.mean_of(|t| along.at(t) - end);
        for joint in self.what.joints(motion.joints()) {
            for (shape, value) in self.what.shapes(joint, motion, operating_point).iter().zip(&self.values[0]) {
                for (k, (shape, course)) in shape.iter().zip(&course).enumerate() {
                    tau[(k, joint)] += value * shape * course;
                }
            }
        }
        tau
    }
}
