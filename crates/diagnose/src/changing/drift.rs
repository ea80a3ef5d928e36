//! What wanders through a recording: the zero of a torque sensor that warms up, friction that thins.
//!
//! A drift multiplies what the mean motion does by a course `g(t)`:
//!
//!   offset     `tau_j += a g(t)`
//!   friction   `tau_j += g(t) (b tanh(100 dq_j) + c dq_j)`, or in all joints `tau_j += s g(t) (fc_j tanh(100 dq_j) + fv_j dq_j)`
//!   course     `g = t` in minutes, or `g = 1 - exp(-t / T)`

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
}

impl Course {
    /// At a time since the first sample of the run \[s\].
    pub fn at(self, t: f64) -> f64 {
        match self {
            Course::Linear => t / 60.0,
            Course::Saturating { time } => 1.0 - (-t / time).exp(),
        }
    }

    pub(super) fn settings(self) -> usize {
        usize::from(self != Course::Linear)
    }
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

impl Shared {
    /// Time of a row of a run on the clock of a drift's course \[s\].
    pub(super) fn time(self, record: &Record, row: usize) -> f64 {
        record.time(row) + if self == Shared::Course { record.start } else { 0.0 }
    }
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
            Drifting::AllFriction => {
                let [fv, fc] = operating_point.friction[joint];
                vec![sign().zip(dq.iter()).map(|(sign, dq)| fc * sign + fv * dq).collect()]
            }
        }
    }

    /// What it does to a run with these parameters, P N x n \[Nm\]; the mean over the periods is not taken off.
    pub(super) fn torque(
        self,
        course: Course,
        shared: Shared,
        values: &[f64],
        record: &Record,
        operating_point: &OperatingPoint,
    ) -> DMatrix<f64> {
        let mut tau = DMatrix::zeros(record.tau.nrows(), record.joints());
        for joint in self.joints(record.joints()) {
            for (shape, value) in self.shapes(joint, &record.motion, operating_point).iter().zip(values) {
                for row in 0..tau.nrows() {
                    tau[(row, joint)] += value * shape[row % record.samples] * course.at(shared.time(record, row));
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
    /// What it does to the mean period of a run that begins at `start`, less what it does at `end`, N x n \[Nm\]. Times on the clock of its course.
    pub(super) fn until(
        &self,
        end: f64,
        experiment: &Experiment,
        start: f64,
        operating_point: &OperatingPoint,
    ) -> DMatrix<f64> {
        let motion = &experiment.motion;
        let course = experiment.timeline.mean_of(|t| self.course.at(start + t) - self.course.at(end));
        let mut tau = DMatrix::zeros(motion.samples(), motion.joints());
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
