//! Huber's M-estimator by iteratively reweighted least squares: outliers get smaller weights.

use super::linear::{Fit, Weights, freedom, least_squares, min_noise};
use super::stack::Stack;
use super::wls::moved;
use crate::EstimateError;
use nalgebra::{DMatrix, DVector};

/// Threshold in standard deviations: smaller residuals have weight 1 (95 % efficiency for normal noise; Huber 1964).
const HUBER_THRESHOLD: f64 = 1.345;
const MAX_ROUNDS: usize = 50;
/// Convergence: no parameter changes by more than this ratio of its minimum standard deviation.
const CONVERGENCE_RATIO: f64 = 1e-3;
/// Ratio of the standard deviation of normal noise to the median of its absolute values.
const STD_TO_MEDIAN_RATIO: f64 = 1.482_602_218_505_602;

/// Robust estimate with its weights and the data for its covariance.
pub struct Robust {
    /// The parameters. Their map from torques uses the slope of Huber's function: zero for rows beyond the threshold.
    pub fit: Fit,
    /// Standard deviation of each joint's torque, from the median of its residuals, n \[Nm\].
    pub sigma: Vec<f64>,
    /// Weight of every row, 0 to 1.
    pub weights: Vec<f64>,
    /// Residuals clipped at the threshold \[Nm\]: the noise that affects the parameters.
    pub influence: DVector<f64>,
    /// Rounds of weights.
    pub rounds: usize,
    /// Whether the weights converged.
    pub converged: bool,
}

/// Minimises `sum rho(r / sigma)`, `rho` quadratic up to the threshold and linear beyond, `sigma` per joint.
pub fn solve(stack: &Stack) -> Result<Robust, EstimateError> {
    let mut fit = least_squares(stack, &Weights::none(stack.joints))?;
    let mut rounds = 0;
    let mut converged = false;
    let (mut sigma, mut factors) = (Vec::new(), Vec::new());
    while rounds < MAX_ROUNDS && !converged {
        rounds += 1;
        let residual = stack.residual(&fit.beta);
        sigma = spread(stack, &fit, &residual);
        factors =
            rows(stack, &sigma, &residual, |size| if size > HUBER_THRESHOLD { HUBER_THRESHOLD / size } else { 1.0 });
        let weights = Weights::per_joint(&sigma).with_rows(&factors);
        let next = least_squares(stack, &weights)?;
        converged = moved(&fit, &next, &weights, stack) < CONVERGENCE_RATIO;
        fit = next;
    }
    let residual = stack.residual(&fit.beta);
    let slopes = rows(stack, &sigma, &residual, |size| if size > HUBER_THRESHOLD { 0.0 } else { 1.0 });
    let bread = least_squares(stack, &Weights::per_joint(&sigma).with_rows(&slopes))?;
    // Where a direction is determined only by rows beyond the threshold, the slopes are zero: the weights are used instead.
    let projection =
        if bread.rank == fit.rank { widened(stack, &bread, &slopes, &sigma) } else { fit.projection.clone() };
    let influence = DVector::from_iterator(residual.len(), residual.iter().zip(&factors).map(|(r, w)| r * w));
    Ok(Robust { fit: Fit { projection, ..fit }, sigma, weights: factors, influence, rounds, converged })
}

/// `(W' S W)^-1 W' S0` with `S` the slopes and `S0` the same without them: the linearised map from influences to the estimate's error.
fn widened(stack: &Stack, bread: &Fit, slopes: &[f64], sigma: &[f64]) -> DMatrix<f64> {
    // bread.projection = (W' S W)^-1 W' S, so its product with its own transpose over S is the inverse.
    let m = stack.per_joint();
    let mut over = bread.projection.clone();
    for (row, mut column) in over.column_iter_mut().enumerate() {
        column *= if slopes[row] > 0.0 { sigma[row / m].powi(2) } else { 0.0 };
    }
    let inverse = over * bread.projection.transpose();
    let mut weighed = stack.w.transpose();
    for (row, mut column) in weighed.column_iter_mut().enumerate() {
        column /= sigma[row / m].powi(2);
    }
    inverse * weighed
}

/// Factor of each row by the absolute value of its residual in standard deviations.
fn rows(stack: &Stack, sigma: &[f64], residual: &DVector<f64>, factor: impl Fn(f64) -> f64) -> Vec<f64> {
    let m = stack.per_joint();
    residual.iter().enumerate().map(|(row, r)| factor((r / sigma[row / m]).abs())).collect()
}

/// Standard deviation of each joint's residuals by the median of their absolute values, which is robust to outliers.
fn spread(stack: &Stack, fit: &Fit, residual: &DVector<f64>) -> Vec<f64> {
    let m = stack.per_joint();
    let scale = STD_TO_MEDIAN_RATIO * freedom(residual.len(), fit.rank).sqrt();
    let least = min_noise(stack);
    (0..stack.joints)
        .map(|j| {
            let mut sizes: Vec<f64> = residual.rows(j * m, m).iter().map(|r| r.abs()).collect();
            let (_, median, _) = sizes.select_nth_unstable_by(m / 2, f64::total_cmp);
            (scale * *median).max(least[j])
        })
        .collect()
}
