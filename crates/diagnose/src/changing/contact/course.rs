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

/// Torques of an event, over their noise.
pub(super) struct Torques {
    /// What acts from outside, the opposite of the torques: blocks x n.
    pub tau: DMatrix<f64>,
    /// Weight of each knot at each block: first knot, its weight; the next one has the rest.
    pub hats: Vec<(usize, f64)>,
    /// Number of knots.
    pub knots: usize,
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

impl Torques {
    /// Least squares of a course; `columns` of each joint, blocks x width. One that is `balanced` has a mean of zero.
    pub fn fit(&self, columns: &[DMatrix<f64>], balanced: bool) -> Option<Course> {
        let width = columns.first()?.ncols();
        let size = width * self.knots;
        let (mut g, mut b) = (DMatrix::zeros(size, size), DVector::zeros(size));
        let mut row = DVector::zeros(2 * width);
        for (block, &(knot, weight)) in self.hats.iter().enumerate() {
            let at = knot * width;
            for (joint, columns) in columns.iter().enumerate() {
                for c in 0..width {
                    let value = columns[(block, c)];
                    (row[c], row[width + c]) = (weight * value, (1.0 - weight) * value);
                }
                g.view_mut((at, at), (2 * width, 2 * width)).ger(1.0, &row, &row, 1.0);
                b.rows_mut(at, 2 * width).axpy(self.tau[(block, joint)], &row, 1.0);
            }
        }
        if balanced {
            let weight = BALANCE_RATIO * g.diagonal().max();
            for (one, other) in (0..self.knots).flat_map(|one| (0..self.knots).map(move |other| (one, other))) {
                (0..width).for_each(|c| g[(one * width + c, other * width + c)] += weight);
            }
        }
        let theta = ridged(g)?.solve(&b);
        let rss = (self.tau.norm_squared() - b.dot(&theta)).max(0.0);
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
            let (mut g, mut b) = (DMatrix::zeros(width, width), DVector::zeros(width));
            for block in 0..self.hats.len() {
                let size = course.at(self, block)[0];
                for (joint, columns) in columns.iter().enumerate() {
                    let row = columns.row(block).transpose() * size;
                    b.axpy(self.tau[(block, joint)], &row, 1.0);
                    g.ger(1.0, &row, &row, 1.0);
                }
            }
            let Course { theta: sizes, rss, .. } = course;
            if rss < before {
                let theta = DVector::from_fn(width * self.knots, |k, _| sizes[k / width] * direction[k % width]);
                best = Some(Course { theta, width, line: Some((sizes, direction)), rss });
            }
            if before - rss < SETTLED_RATIO * rss {
                break;
            }
            direction = ridged(g)?.solve(&b).normalize();
        }
        best
    }

    /// Errors of a course that was fitted to these columns.
    pub fn errors(&self, columns: &[DMatrix<f64>], course: &Course) -> Option<Errors> {
        let gradient = course.gradient();
        let mut g = DMatrix::zeros(gradient.ncols(), gradient.ncols());
        for (block, &(knot, weight)) in self.hats.iter().enumerate() {
            let of = |knot: usize| gradient.rows(knot * course.width, course.width);
            let derivative = of(knot) * weight + of(knot + 1) * (1.0 - weight);
            for columns in columns {
                let row = (columns.row(block) * &derivative).transpose();
                g.ger(1.0, &row, &row, 1.0);
            }
        }
        Some(Errors { gradient, factor: ridged(g)? })
    }
}

fn ridged(mut g: DMatrix<f64>) -> Option<Cholesky<f64, Dyn>> {
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
        let torques = Torques { tau: DMatrix::from_fn(40, 1, |block, _| wave(block)), hats, knots: 5 };
        let columns = [DMatrix::from_element(40, 1, 1.0)];
        let fit = |balanced| torques.fit(&columns, balanced).unwrap();
        let (free, balanced) = (fit(false), fit(true));
        assert!(free.rss < 1.0 && free.theta.mean() > 0.9, "{} {}", free.rss, free.theta);
        assert!(balanced.rss > 20.0 && balanced.theta.mean().abs() < 1e-3, "{} {}", balanced.rss, balanced.theta);
    }
}
