//! What a residual may depend on, and smooth functions of it.

use crate::evidence::Evidence;
use nalgebra::DMatrix;
use plumbline_model::term::Motion;
use plumbline_model::term::empirical::{Axis, Follows};
use std::fmt;

/// A quantity of a joint, or the time since the start of a period. Joints count from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Variable {
    /// `q_i` \[rad\].
    Position(usize),
    /// `dq_i` \[rad/s\].
    Velocity(usize),
    /// `ddq_i` \[rad/s2\].
    Acceleration(usize),
    /// Time in the period, or in a run that does not repeat \[s\].
    Time,
}

impl Variable {
    /// Its joint.
    pub fn joint(self) -> Option<usize> {
        match self {
            Variable::Position(joint) | Variable::Velocity(joint) | Variable::Acceleration(joint) => Some(joint),
            Variable::Time => None,
        }
    }

    /// Its unit.
    pub fn unit(self) -> &'static str {
        match self {
            Variable::Position(_) => "rad",
            Variable::Velocity(_) => "rad/s",
            Variable::Acceleration(_) => "rad/s2",
            Variable::Time => "s",
        }
    }

    /// Its values along a motion.
    pub fn values(self, motion: &Motion) -> Vec<f64> {
        let column = |of: &DMatrix<f64>, joint: usize| of.column(joint).iter().copied().collect();
        match self {
            Variable::Position(joint) => column(&motion.q, joint),
            Variable::Velocity(joint) => column(&motion.dq, joint),
            Variable::Acceleration(joint) => column(&motion.ddq, joint),
            Variable::Time => (0..motion.samples()).map(|k| motion.start + k as f64 * motion.dt).collect(),
        }
    }
}

impl fmt::Display for Variable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Variable::Position(joint) => write!(f, "q{}", joint + 1),
            Variable::Velocity(joint) => write!(f, "dq{}", joint + 1),
            Variable::Acceleration(joint) => write!(f, "ddq{}", joint + 1),
            Variable::Time => f.write_str("time"),
        }
    }
}

/// A variable along several motions.
#[derive(Clone, Debug)]
pub struct Course {
    /// Which one.
    pub variable: Variable,
    /// Its values, motion by motion.
    pub values: Vec<Vec<f64>>,
    /// Least and largest value.
    pub range: (f64, f64),
}

impl Course {
    /// Along these motions; `None` when it does not change.
    pub fn of<'a>(variable: Variable, motions: impl Iterator<Item = &'a Motion>) -> Option<Course> {
        let values: Vec<Vec<f64>> = motions.map(|motion| variable.values(motion)).collect();
        let all = || values.iter().flatten().copied();
        let range = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
        (range.1 - range.0 > 1e-6).then_some(Course { variable, values, range })
    }

    /// Every variable that changes in the motions of these runs.
    pub fn all(evidence: &Evidence) -> Vec<Course> {
        let joints = 0..evidence.joints();
        let of_joint = |joint| [Variable::Position(joint), Variable::Velocity(joint), Variable::Acceleration(joint)];
        let motions = || (0..evidence.experiments()).map(|experiment| evidence.motion(experiment));
        let each = joints.flat_map(of_joint).chain([Variable::Time]);
        each.filter_map(|variable| Course::of(variable, motions())).collect()
    }

    /// Smooth functions of it, N x functions in each motion: B-splines over its range, and for a velocity its sign.
    pub fn functions(&self) -> Vec<DMatrix<f64>> {
        let axis = self.axis();
        self.sampled(|value| axis.fine(value))
    }

    /// The same, fewer of them, for a product with those of another variable.
    pub fn coarse(&self) -> Vec<DMatrix<f64>> {
        let axis = self.axis();
        self.sampled(|value| axis.coarse(value))
    }

    /// The functions that a learned term of it has, over its range.
    pub fn axis(&self) -> Axis {
        let follows = match self.variable {
            Variable::Velocity(_) => Follows::Velocity,
            _ => Follows::Position,
        };
        let (low, high) = self.range;
        Axis { follows, middle: 0.5 * (low + high), reach: 0.5 * (high - low) }
    }

    fn sampled<const N: usize>(&self, functions: impl Fn(f64) -> [f64; N]) -> Vec<DMatrix<f64>> {
        let of_motion = |values: &Vec<f64>| {
            let rows = values.iter().flat_map(|&value| functions(value));
            DMatrix::from_row_iterator(values.len(), N, rows)
        };
        self.values.iter().map(of_motion).collect()
    }
}

/// Every product of a function of one and a function of the other variable.
pub fn products(a: &[DMatrix<f64>], b: &[DMatrix<f64>]) -> Vec<DMatrix<f64>> {
    let of_motion = |(a, b): (&DMatrix<f64>, &DMatrix<f64>)| {
        let mut both = DMatrix::zeros(a.nrows(), a.ncols() * b.ncols());
        for i in 0..a.ncols() {
            for k in 0..b.ncols() {
                both.column_mut(i * b.ncols() + k).copy_from(&a.column(i).component_mul(&b.column(k)));
            }
        }
        both
    };
    a.iter().zip(b).map(of_motion).collect()
}
