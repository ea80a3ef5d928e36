//! Huber's M-estimator by iteratively reweighted least squares: torques that are far off count less.

use super::linear::{Fit, Weights, freedom, least_noise, least_squares};
use super::stack::Stack;
use super::wls::moved;
use crate::EstimateError;
use nalgebra::{DMatrix, DVector};

/// Residuals up to so many standard deviations count fully (95 % efficient for normal noise; Huber 1964).
const BEND: f64 = 1.345;
/// Most rounds of weights.
const ROUNDS: usize = 50;
/// Weights have settled when no parameter moves by more than this share of its least standard deviation.
const SETTLED: f64 = 1e-3;
/// Standard deviation of normal noise over the median of its absolute values.
const NORMAL_OVER_MEDIAN: f64 = 1.482_602_218_505_602;

/// Parameters, the weights that they came from, and what their covariance needs.
pub struct Robust {
    /// The parameters. Their map from torques has the slope of Huber's function in it: zero for rows beyond the bend.
    pub fit: Fit,
    /// Standard deviation of each joint's torque, from the median of its residuals, n \[Nm\].
    pub sigma: Vec<f64>,
    /// Weight of every row, 0 to 1.
    pub weights: Vec<f64>,
    /// Residuals with those beyond the bend cut down to it \[Nm\]: the noise that reaches the parameters.
    pub influence: DVector<f64>,
    /// Rounds of weights.
    pub rounds: usize,
    /// Whether the weights settled.
    pub settled: bool,
}

/// Minimises `sum rho(r / sigma)`, `rho` quadratic up to the bend and linear beyond, `sigma` per joint.
pub fn solve(stack: &Stack) -> Result<Robust, EstimateError> {
    let mut fit = least_squares(stack, &Weights::none(stack.joints))?;
    let mut rounds = 0;
    let mut settled = false;
    let (mut sigma, mut factors) = (Vec::new(), Vec::new());
    while rounds < ROUNDS && !settled {
        rounds += 1;
        let residual = stack.residual(&fit.beta);
        sigma = spread(stack, &fit, &residual);
        factors = rows(stack, &sigma, &residual, |size| if size > BEND { BEND / size } else { 1.0 });
        let weights = Weights::per_joint(&sigma).with_rows(&factors);
        let next = least_squares(stack, &weights)?;
        settled = moved(&fit, &next, &weights, stack) < SETTLED;
        fit = next;
    }
    let residual = stack.residual(&fit.beta);
    let slopes = rows(stack, &sigma, &residual, |size| if size > BEND { 0.0 } else { 1.0 });
    let bread = least_squares(stack, &Weights::per_joint(&sigma).with_rows(&slopes))?;
    // Where rows beyond the bend carry a whole direction, the slopes know nothing of it: there the weights speak for it.
    let projection =
        if bread.rank == fit.rank { widened(stack, &bread, &slopes, &sigma) } else { fit.projection.clone() };
    let influence = DVector::from_iterator(residual.len(), residual.iter().zip(&factors).map(|(r, w)| r * w));
    Ok(Robust { fit: Fit { projection, ..fit }, sigma, weights: factors, influence, rounds, settled })
}

/// `(W' S W)^-1 W' S0` with `S` the slopes and `S0` the same without them: the linear part of the estimate's error in the influences.
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

/// One factor per row of the size of its residual in standard deviations.
fn rows(stack: &Stack, sigma: &[f64], residual: &DVector<f64>, factor: impl Fn(f64) -> f64) -> Vec<f64> {
    let m = stack.per_joint();
    residual.iter().enumerate().map(|(row, r)| factor((r / sigma[row / m]).abs())).collect()
}

/// Standard deviation of each joint's residuals by the median of their absolute values, which outliers hardly move.
fn spread(stack: &Stack, fit: &Fit, residual: &DVector<f64>) -> Vec<f64> {
    let m = stack.per_joint();
    let scale = NORMAL_OVER_MEDIAN * freedom(residual.len(), fit.rank).sqrt();
    let least = least_noise(stack);
    (0..stack.joints)
        .map(|j| {
            let mut sizes: Vec<f64> = residual.rows(j * m, m).iter().map(|r| r.abs()).collect();
            let (_, median, _) = sizes.select_nth_unstable_by(m / 2, f64::total_cmp);
            (scale * *median).max(least[j])
        })
        .collect()
}
