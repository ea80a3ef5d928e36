//! Courses over an event: `tau_j(t) = c_j(t)' w(t)` for known columns `c` and a course `w` that is continuous and piecewise linear (hat functions).

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

/// Largest number of rounds between course and direction.
const MAX_ROUNDS: usize = 30;
/// A round that takes off less than this share of the residual is the last one.
pub(super) const SETTLED_RATIO: f64 = 1e-5;
/// Ridge, as a share of the largest diagonal element: what few joints feel is as small as it can be.
const RIDGE_RATIO: f64 = 1e-9;
/// Weight of a mean of zero, as a share of the largest diagonal element.
const BALANCE_RATIO: f64 = 1e3;

/// Torques of an event.
pub(super) struct Torques {
    /// What acts from outside, the opposite of the torques: blocks x n \[Nm\].
    pub tau: DMatrix<f64>,
    /// Inverse covariance of each joint's noise, blocks x blocks; zero where the joint shows nothing.
    pub weights: Vec<DMatrix<f64>>,
    /// Weight of each knot at each block: first knot, its weight; the next one has the rest.
    pub hats: Vec<(usize, f64)>,
    /// Number of knots.
    pub knots: usize,
}

/// Normal equations `g x = b`.
pub(super) struct Normal {
    /// `D' W D`.
    pub g: DMatrix<f64>,
    /// `D' W y`.
    pub b: DVector<f64>,
}

/// A course that was fitted.
pub(super) struct Course {
    /// Values at the knots, `width` each.
    pub theta: DVector<f64>,
    /// Components per knot.
    pub width: usize,
    /// Sizes at the knots and the direction, of a course that keeps it.
    line: Option<(DVector<f64>, DVector<f64>)>,
    /// Sum of the squares that are left.
    pub rss: f64,
}

/// Errors of a course.
pub(super) struct Errors {
    /// Derivative of `theta` by the parameters.
    gradient: DMatrix<f64>,
    /// Of the information of the parameters.
    factor: Cholesky<f64, Dyn>,
}

impl Course {
    /// Value at a block.
    pub fn at(&self, torques: &Torques, block: usize) -> DVector<f64> {
        let (knot, weight) = torques.hats[block];
        let of = |knot: usize| self.theta.rows(knot * self.width, self.width);
        of(knot) * weight + of(knot + 1) * (1.0 - weight)
    }

    /// One that keeps its direction, from its sizes at the knots.
    pub fn along(sizes: DVector<f64>, direction: DVector<f64>, rss: f64) -> Self {
        let width = direction.len();
        let theta = DVector::from_fn(width * sizes.len(), |k, _| sizes[k / width] * direction[k % width]);
        Course { theta, width, line: Some((sizes, direction)), rss }
    }

    /// Sizes at the knots and the direction, of a course that keeps it.
    pub fn line(&self) -> Option<&(DVector<f64>, DVector<f64>)> {
        self.line.as_ref()
    }

    /// Derivative of `theta` by the parameters: itself, or the sizes at the knots and the direction.
    fn gradient(&self) -> DMatrix<f64> {
        let Some((sizes, direction)) = &self.line else {
            return DMatrix::identity(self.theta.len(), self.theta.len());
        };
        let mut gradient = DMatrix::zeros(self.theta.len(), sizes.len() + self.width);
        for (knot, size) in sizes.iter().enumerate() {
            gradient.view_mut((knot * self.width, knot), (self.width, 1)).copy_from(direction);
            gradient.view_mut((knot * self.width, sizes.len()), (self.width, self.width)).fill_diagonal(*size);
        }
        gradient
    }
}

impl Errors {
    /// Standard deviation of a weighted sum of `theta`.
    pub fn std(&self, weights: &DVector<f64>) -> f64 {
        let own = self.gradient.tr_mul(weights);
        self.factor.solve(&own).dot(&own).max(0.0).sqrt()
    }
}

impl Normal {
    /// Of so many unknowns, without any equation.
    pub fn of(size: usize) -> Self {
        Normal { g: DMatrix::zeros(size, size), b: DVector::zeros(size) }
    }

    /// Adds the equations `design x = target` of a joint with these weights.
    pub fn add(&mut self, design: &DMatrix<f64>, weights: &DMatrix<f64>, target: &DVector<f64>) {
        let weighed = design.tr_mul(weights);
        self.g += &weighed * design;
        self.b += weighed * target;
    }
}

impl Torques {
    /// Sum of the squares of a joint's torques over their noise.
    pub fn square(&self, joint: usize) -> f64 {
        let tau = self.tau.column(joint);
        tau.dot(&(&self.weights[joint] * tau))
    }

    /// The same of all joints.
    pub fn squares(&self) -> f64 {
        (0..self.tau.ncols()).map(|joint| self.square(joint)).sum()
    }

    /// Least squares of a course; `columns` of each joint, blocks x width. One that is `balanced` has a mean of zero.
    pub fn fit(&self, columns: &[DMatrix<f64>], balanced: bool) -> Option<Course> {
        let width = columns.first()?.ncols();
        let size = width * self.knots;
        let Normal { mut g, mut b } = Normal::of(size);
        let nonzero = |(_, columns): &(usize, &DMatrix<f64>)| columns.iter().any(|value| *value != 0.0);
        for (joint, columns) in columns.iter().enumerate().filter(nonzero) {
            let weights = &self.weights[joint];
            // The design has entries at two knots of each block only.
            let entries = |block: usize| {
                let (knot, weight) = self.hats[block];
                let of = move |c: usize| if c < width { (c, weight) } else { (c - width, 1.0 - weight) };
                (0..2 * width).map(move |c| (knot * width + c, of(c).1 * columns[(block, of(c).0)]))
            };
            let mut weighed = DMatrix::zeros(self.hats.len(), size);
            for block in 0..self.hats.len() {
                entries(block).for_each(|(at, value)| weighed.column_mut(at).axpy(value, &weights.column(block), 1.0));
            }
            b += weighed.tr_mul(&self.tau.column(joint));
            for block in 0..self.hats.len() {
                for (at, value) in entries(block) {
                    (0..size).for_each(|other| g[(other, at)] += value * weighed[(block, other)]);
                }
            }
        }
        if balanced {
            let weight = BALANCE_RATIO * g.diagonal().max();
            for (one, other) in (0..self.knots).flat_map(|one| (0..self.knots).map(move |other| (one, other))) {
                (0..width).for_each(|c| g[(one * width + c, other * width + c)] += weight);
            }
        }
        let theta = ridged(g)?.solve(&b);
        let rss = (self.squares() - b.dot(&theta)).max(0.0);
        Some(Course { theta, width, line: None, rss })
    }

    /// The same of a course `w(t) = s(t) d` that keeps its direction, from one that need not.
    pub fn fit_direction(&self, columns: &[DMatrix<f64>], free: &Course, balanced: bool) -> Option<Course> {
        let width = free.width;
        // The direction that most of the free course has.
        let knots = DMatrix::from_column_slice(width, self.knots, free.theta.as_slice());
        let eigen = plumbline_core::symmetric_eigen(&knots * knots.transpose())?;
        let mut direction = eigen.eigenvectors.column(eigen.eigenvalues.imax()).into_owned();
        let mut best: Option<Course> = None;
        for _ in 0..MAX_ROUNDS {
            let along = |columns: &DMatrix<f64>| DMatrix::from_columns(&[columns * &direction]);
            let course = self.fit(&columns.iter().map(along).collect::<Vec<_>>(), balanced)?;
            let before = best.as_ref().map_or(f64::INFINITY, |best| best.rss);
            let sizes: Vec<f64> = (0..self.hats.len()).map(|block| course.at(self, block)[0]).collect();
            let mut normal = Normal::of(width);
            for (joint, columns) in columns.iter().enumerate() {
                let sized = DMatrix::from_fn(sizes.len(), width, |block, c| columns[(block, c)] * sizes[block]);
                normal.add(&sized, &self.weights[joint], &self.tau.column(joint).into_owned());
            }
            let Course { theta: sizes, rss, .. } = course;
            if rss < before {
                best = Some(Course::along(sizes, direction.clone(), rss));
            }
            if before - rss < SETTLED_RATIO * rss {
                break;
            }
            direction = ridged(normal.g)?.solve(&normal.b).normalize();
        }
        best
    }

    /// Errors of a course that was fitted to these columns.
    pub fn errors(&self, columns: &[DMatrix<f64>], course: &Course) -> Option<Errors> {
        let gradient = course.gradient();
        let mut normal = Normal::of(gradient.ncols());
        for (joint, columns) in columns.iter().enumerate() {
            let mut design = DMatrix::zeros(self.hats.len(), gradient.ncols());
            for (block, &(knot, weight)) in self.hats.iter().enumerate() {
                let of = |knot: usize| gradient.rows(knot * course.width, course.width);
                let derivative = of(knot) * weight + of(knot + 1) * (1.0 - weight);
                design.row_mut(block).copy_from(&(columns.row(block) * derivative));
            }
            normal.add(&design, &self.weights[joint], &self.tau.column(joint).into_owned());
        }
        Some(Errors { gradient, factor: ridged(normal.g)? })
    }
}

/// Factor of a matrix with [`RIDGE_RATIO`] on its diagonal.
pub(super) fn ridged(mut g: DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
    let ridge = RIDGE_RATIO * g.diagonal().max();
    (0..g.nrows()).for_each(|k| g[(k, k)] += ridge);
    g.cholesky()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_course_that_is_balanced_has_a_mean_of_zero() {
        let hats = (0..40).map(|block| (block / 10, 1.0 - 0.1 * (block % 10) as f64)).collect();
        let wave = |block: usize| 1.0 + (block as f64 * std::f64::consts::TAU / 40.0).sin();
        let weights = vec![DMatrix::identity(40, 40)];
        let torques = Torques { tau: DMatrix::from_fn(40, 1, |block, _| wave(block)), weights, hats, knots: 5 };
        let columns = [DMatrix::from_element(40, 1, 1.0)];
        let fit = |balanced| torques.fit(&columns, balanced).unwrap();
        let (free, balanced) = (fit(false), fit(true));
        assert!(free.rss < 1.0 && free.theta.mean() > 0.9, "{} {}", free.rss, free.theta);
        assert!(balanced.rss > 20.0 && balanced.theta.mean().abs() < 1e-3, "{} {}", balanced.rss, balanced.theta);
    }
}
