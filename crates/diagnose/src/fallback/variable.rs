//! What a residual may depend on, and smooth functions of it.

use nalgebra::DMatrix;
use plumbline_model::term::Motion;
use plumbline_model::term::friction::SHARPNESS;
use std::fmt;

/// Functions of a single variable.
const SINGLE_FUNCTIONS: usize = 10;
/// Functions of each of two variables.
const PAIR_FUNCTIONS: usize = 5;

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
pub(super) struct Course {
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

    /// Smooth functions of it, N x functions in each motion: B-splines over its range, and for a velocity its sign.
    pub fn functions(&self) -> Vec<DMatrix<f64>> {
        let splines = if self.is_velocity() { SINGLE_FUNCTIONS - 1 } else { SINGLE_FUNCTIONS };
        self.basis(splines, 3)
    }

    /// The same, fewer of them, for a product with those of another variable.
    pub fn coarse(&self) -> Vec<DMatrix<f64>> {
        let splines = if self.is_velocity() { PAIR_FUNCTIONS - 1 } else { PAIR_FUNCTIONS };
        self.basis(splines, 2)
    }

    fn is_velocity(&self) -> bool {
        matches!(self.variable, Variable::Velocity(_))
    }

    fn basis(&self, splines: usize, degree: usize) -> Vec<DMatrix<f64>> {
        let width = splines + usize::from(self.is_velocity());
        let of_motion = |values: &Vec<f64>| {
            let mut basis = DMatrix::zeros(values.len(), width);
            for (k, &value) in values.iter().enumerate() {
                let share = (value - self.range.0) / (self.range.1 - self.range.0);
                let place = share * (splines - degree) as f64;
                for s in 0..splines {
                    basis[(k, s)] = b_spline(degree, place - s as f64 + degree as f64);
                }
                if self.is_velocity() {
                    basis[(k, splines)] = (SHARPNESS * value).tanh();
                }
            }
            basis
        };
        self.values.iter().map(of_motion).collect()
    }
}

/// Every product of a function of one and a function of the other variable.
pub(super) fn products(a: &[DMatrix<f64>], b: &[DMatrix<f64>]) -> Vec<DMatrix<f64>> {
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

/// The cardinal B-spline of a degree, which is not zero between 0 and `degree + 1` (Cox and de Boor's recursion for whole knots).
fn b_spline(degree: usize, x: f64) -> f64 {
    let d = degree as f64;
    if !(0.0..=d + 1.0).contains(&x) {
        return 0.0;
    }
    if degree == 0 {
        return if x < 1.0 { 1.0 } else { 0.0 };
    }
    (x * b_spline(degree - 1, x) + (d + 1.0 - x) * b_spline(degree - 1, x - 1.0)) / d
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splines_sum_to_one_over_the_range() {
        for (splines, degree) in [(10, 3), (5, 2)] {
            for step in 0..=200 {
                let place = step as f64 / 200.0 * (splines - degree) as f64;
                let sum: f64 = (0..splines).map(|s| b_spline(degree, place - s as f64 + degree as f64)).sum();
                assert!((sum - 1.0).abs() < 1e-12, "degree {degree}, {place}: {sum}");
            }
        }
    }
}
