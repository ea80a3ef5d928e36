//! Common parts of the estimators: weights, and least squares in the determined directions.

use super::gains::{Gains, filter};
use super::stack::Stack;
use crate::EstimateError;
use nalgebra::{Cholesky, DMatrix, DVector};
use plumbline_core::svd;
use plumbline_model::ZERO_COLUMN;

/// Ratio of a singular value (of equilibrated columns) to the largest below which its direction is undetermined.
const RANK_TOLERANCE: f64 = 1e-7;
/// The same ratio for a product of two regressors, limited by rounding.
const NORMAL_TOLERANCE: f64 = 1e-12;
/// Minimum ratio of a joint's noise to its torque, so that exact data has finite weights.
const MIN_NOISE_RATIO: f64 = 1e-7;
/// Minimum of the largest torque \[Nm\], so that the squared weights of zero torques are finite.
const MIN_TORQUE: f64 = 1e-60;

/// Linear estimate of the parameters.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The parameters, p.
    pub beta: DVector<f64>,
    /// `d beta / d tau`, p x rows: the map from torque noise to parameter errors.
    pub projection: DMatrix<f64>,
    /// Number of determined directions.
    pub rank: usize,
    /// Share of each parameter in undetermined directions.
    pub null_share: Vec<f64>,
}

/// Weights of the equations: `Sigma^-1` over the joints of one sample, times a factor of each row's own, or by frequency.
#[derive(Clone, Debug)]
pub struct Weights {
    /// `L^-1` with `Sigma = L L'`, n x n, lower triangular.
    whitening: DMatrix<f64>,
    /// Square root of each row's own factor.
    rows: Option<Vec<f64>>,
    /// Gains by frequency, per experiment.
    gains: Vec<Gains>,
}

impl Weights {
    /// Equal weights.
    pub fn none(joints: usize) -> Weights {
        Weights::by_frequency(joints, Vec::new())
    }

    /// Weights by frequency, the same for a frequency and its negative.
    pub fn by_frequency(joints: usize, gains: Vec<Gains>) -> Weights {
        Weights { whitening: DMatrix::identity(joints, joints), rows: None, gains }
    }

    /// Weights by the standard deviation of each joint, n.
    pub fn per_joint(sigma: &[f64]) -> Weights {
        let inverse = DVector::from_iterator(sigma.len(), sigma.iter().map(|sigma| 1.0 / sigma));
        Weights { whitening: DMatrix::from_diagonal(&inverse), ..Weights::none(sigma.len()) }
    }

    /// Weights by the covariance between the joints, n x n, positive definite.
    pub fn full(covariance: &DMatrix<f64>) -> Option<Weights> {
        let whitening = Cholesky::new(covariance.clone())?.l().try_inverse()?;
        Some(Weights { whitening, ..Weights::none(covariance.nrows()) })
    }

    /// Adds a factor for every row of the stacked equations, 0 or more.
    pub fn with_rows(mut self, factors: &[f64]) -> Weights {
        self.rows = Some(factors.iter().map(|factor| factor.sqrt()).collect());
        self
    }

    /// Whitened equations: `y` has n m rows, joint by joint.
    pub fn apply(&self, y: &DMatrix<f64>) -> DMatrix<f64> {
        let n = self.whitening.nrows();
        let m = y.nrows() / n;
        let mut out = DMatrix::zeros(y.nrows(), y.ncols());
        for i in 0..n {
            for j in (0..=i).filter(|&j| self.whitening[(i, j)] != 0.0) {
                let mut block = out.rows_mut(i * m, m);
                block += y.rows(j * m, m) * self.whitening[(i, j)];
            }
        }
        if let Some(rows) = &self.rows {
            for (mut row, factor) in out.row_iter_mut().zip(rows) {
                row *= *factor;
            }
        }
        out.column_iter_mut().for_each(|mut column| filter(column.as_mut_slice(), &self.gains));
        out
    }

    /// `b` times the whitening: converts a map from whitened torques into one from torques (`b` is p x n m).
    pub fn carry_back(&self, b: &DMatrix<f64>) -> DMatrix<f64> {
        let n = self.whitening.nrows();
        let m = b.ncols() / n;
        // A gain without phase is its own transpose.
        let mut turned = b.transpose();
        turned.column_iter_mut().for_each(|mut row| filter(row.as_mut_slice(), &self.gains));
        let mut b = turned.transpose();
        if let Some(rows) = &self.rows {
            for (mut column, factor) in b.column_iter_mut().zip(rows) {
                column *= *factor;
            }
        }
        let mut out = DMatrix::zeros(b.nrows(), b.ncols());
        for i in 0..n {
            for j in (0..=i).filter(|&j| self.whitening[(i, j)] != 0.0) {
                let mut block = out.columns_mut(j * m, m);
                block += b.columns(i * m, m) * self.whitening[(i, j)];
            }
        }
        out
    }
}

/// Weighted least squares with given weights: `(W' S W)^-1 W' S tau` (paper eq. 10) by QR of the whitened, column-equilibrated
/// regressor and the singular values of its triangle.
///
/// # Errors
/// Equations that are not finite.
pub fn least_squares(stack: &Stack, weights: &Weights) -> Result<Fit, EstimateError> {
    let (w, scales) = equilibrated(weights.apply(&stack.w));
    let (rows, p) = w.shape();
    let qr = w.qr();
    let inverse = Inverse::of(qr.r(), rows)?;
    let mut projection = inverse.matrix * qr.q().transpose();
    scale_rows(&mut projection, &scales);
    let projection = weights.carry_back(&projection);
    debug_assert_eq!(projection.shape(), (p, rows));
    Ok(Fit { beta: &projection * &stack.tau, projection, rank: inverse.rank, null_share: inverse.null_share })
}

/// Divides every column by its norm, so that the rank does not depend on the parameters' units. Returns the factors, 0 for a numerically
/// zero column.
pub fn equilibrated(mut w: DMatrix<f64>) -> (DMatrix<f64>, Vec<f64>) {
    let norms: Vec<f64> = w.column_iter().map(|column| column.norm()).collect();
    let largest = norms.iter().copied().fold(0.0, f64::max);
    let scales: Vec<f64> =
        norms.iter().map(|&norm| if norm > ZERO_COLUMN * largest { 1.0 / norm } else { 0.0 }).collect();
    for (mut column, scale) in w.column_iter_mut().zip(&scales) {
        column *= *scale;
    }
    (w, scales)
}

/// Multiplies row `c` by `scales[c]`.
pub fn scale_rows(b: &mut DMatrix<f64>, scales: &[f64]) {
    for (mut row, scale) in b.row_iter_mut().zip(scales) {
        row *= *scale;
    }
}

/// Pseudo-inverse of a square matrix in its determined directions.
pub struct Inverse {
    /// The pseudo-inverse, p x p.
    pub matrix: DMatrix<f64>,
    /// Orthonormal basis of the determined directions, p x rank.
    pub range: DMatrix<f64>,
    /// Number of determined directions.
    pub rank: usize,
    /// Share of each coordinate in undetermined directions.
    pub null_share: Vec<f64>,
}

impl Inverse {
    /// Pseudo-inverse of the triangle of equilibrated equations, p x p; `rows` appears in the error only.
    pub fn of(r: DMatrix<f64>, rows: usize) -> Result<Inverse, EstimateError> {
        Inverse::within(r, rows, RANK_TOLERANCE)
    }

    /// Pseudo-inverse of a product of two sets of equilibrated equations, with squared singular values.
    pub fn of_normal(m: DMatrix<f64>, rows: usize) -> Result<Inverse, EstimateError> {
        Inverse::within(m, rows, NORMAL_TOLERANCE)
    }

    fn within(r: DMatrix<f64>, rows: usize, tolerance: f64) -> Result<Inverse, EstimateError> {
        let p = r.ncols();
        let failed = EstimateError::Decomposition { rows, columns: p };
        let svd = svd(r).ok_or(failed.clone())?;
        let (Some(u), Some(v_t)) = (&svd.u, &svd.v_t) else { return Err(failed) };
        let s_max = svd.singular_values.max();
        if !s_max.is_finite() {
            return Err(failed);
        }
        let mut matrix = DMatrix::zeros(p, p);
        let mut null_share = vec![0.0; p];
        let mut determined = Vec::new();
        for (i, &s) in svd.singular_values.iter().enumerate() {
            if s > tolerance * s_max && s > 0.0 {
                matrix += v_t.row(i).transpose() * u.column(i).transpose() / s;
                determined.push(v_t.row(i).transpose());
            } else {
                for (c, share) in null_share.iter_mut().enumerate() {
                    *share += v_t[(i, c)].powi(2);
                }
            }
        }
        let rank = determined.len();
        let range = if rank == 0 { DMatrix::zeros(p, 0) } else { DMatrix::from_columns(&determined) };
        Ok(Inverse { matrix, range, rank, null_share })
    }
}

/// Factor that corrects the mean squared residual for the degrees of freedom of a fit of this rank.
pub fn freedom(rows: usize, rank: usize) -> f64 {
    rows as f64 / rows.saturating_sub(rank).max(1) as f64
}

/// Minimum standard deviation of each joint for weights, n \[Nm\].
pub fn min_noise(stack: &Stack) -> Vec<f64> {
    let m = stack.per_joint();
    let rms = |j: usize| (stack.tau.rows(j * m, m).norm_squared() / m as f64).sqrt();
    let largest = (0..stack.joints).map(rms).fold(MIN_TORQUE, f64::max);
    (0..stack.joints).map(|j| MIN_NOISE_RATIO * rms(j).max(MIN_NOISE_RATIO * largest)).collect()
}

/// Covariance of the residual between the joints, corrected for degrees of freedom, n x n \[Nm2\].
pub fn residual_covariance(stack: &Stack, fit: &Fit) -> DMatrix<f64> {
    let (n, m) = (stack.joints, stack.per_joint());
    let residual = stack.residual(&fit.beta);
    let per_joint = DMatrix::from_column_slice(m, n, residual.as_slice());
    let mut covariance = per_joint.tr_mul(&per_joint) * (freedom(n * m, fit.rank) / m as f64);
    for (j, least) in min_noise(stack).iter().enumerate() {
        covariance[(j, j)] = covariance[(j, j)].max(least * least);
    }
    covariance
}

/// Standard deviations of a covariance.
pub fn deviations(covariance: &DMatrix<f64>) -> Vec<f64> {
    covariance.diagonal().iter().map(|variance| variance.sqrt()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stack() -> Stack {
        let w = DMatrix::from_fn(60, 3, |k, c| ((k * (c + 2)) as f64 * 0.7).sin() + 0.1 * c as f64);
        let tau = DVector::from_fn(60, |k, _| (k as f64 * 0.9).cos());
        Stack { w, tau, joints: 3, spans: vec![12, 8] }
    }

    fn covariance() -> DMatrix<f64> {
        DMatrix::from_row_slice(3, 3, &[2.0, 0.5, -0.3, 0.5, 1.0, 0.1, -0.3, 0.1, 0.5])
    }

    /// The textbook formula with the whole covariance of all rows.
    fn textbook(stack: &Stack, inverse_noise: &DMatrix<f64>) -> DVector<f64> {
        let normal = stack.w.transpose() * inverse_noise * &stack.w;
        normal.try_inverse().unwrap() * stack.w.transpose() * inverse_noise * &stack.tau
    }

    #[test]
    fn weighted_least_squares_agrees_with_the_textbook_formula() {
        let stack = stack();
        let inverse_noise = covariance().try_inverse().unwrap().kronecker(&DMatrix::identity(20, 20));
        let fit = least_squares(&stack, &Weights::full(&covariance()).unwrap()).unwrap();
        assert!((&fit.beta - textbook(&stack, &inverse_noise)).abs().max() < 1e-12);
        assert!((&fit.projection * &stack.w - DMatrix::identity(3, 3)).abs().max() < 1e-12);
        assert_eq!(fit.rank, 3);
    }

    #[test]
    fn row_factors_are_weights() {
        let stack = stack();
        let factors: Vec<f64> = (0..60).map(|k| 0.2 + (k % 7) as f64).collect();
        let noise = DMatrix::from_diagonal(&DVector::from_column_slice(&factors));
        let fit = least_squares(&stack, &Weights::none(3).with_rows(&factors)).unwrap();
        assert!((&fit.beta - textbook(&stack, &noise)).abs().max() < 1e-12);
    }

    #[test]
    fn an_unexcited_parameter_has_null_share_one() {
        let mut stack = stack();
        stack.w.column_mut(1).fill(0.0);
        let fit = least_squares(&stack, &Weights::none(3)).unwrap();
        assert_eq!((fit.rank, fit.beta[1]), (2, 0.0));
        assert!((fit.null_share[1] - 1.0).abs() < 1e-12 && fit.null_share[0] < 1e-12);
    }
}
