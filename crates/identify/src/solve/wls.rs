//! Weighted least squares, paper eqs. 9 and 10, with weights from the residual of the round before.

use super::linear::{Fit, Weights, deviations, least_squares, residual_covariance};
use super::stack::Stack;
use crate::EstimateError;
use nalgebra::DMatrix;

/// Most rounds of weights.
const ROUNDS: usize = 30;
/// Weights have settled when no parameter moves by more than this share of its standard deviation. Noise in the weights themselves
/// moves parameters by more.
const SETTLED: f64 = 1e-2;
/// Share of a parameter that is rounding.
const ROUNDING: f64 = 1e-9;
/// What correlations between joints are multiplied by, so that their matrix stays well inside the positive definite ones.
const SHRINKAGE: f64 = 0.98;

/// Parameters, and the covariance between joints that weighed them.
pub struct Weighed {
    /// The parameters.
    pub fit: Fit,
    /// `Sigma`, n x n \[Nm2\].
    pub sigma: DMatrix<f64>,
    /// Rounds of weights.
    pub rounds: usize,
    /// Whether the weights settled.
    pub settled: bool,
}

/// `beta = (W' Sigma^-1 W)^-1 W' Sigma^-1 tau` with `Sigma` the covariance of the torques' errors between the joints of one sample:
/// its diagonal as in the paper, or (`full`) all of it.
pub fn solve(stack: &Stack, full: bool) -> Result<Weighed, EstimateError> {
    let mut fit = least_squares(stack, &Weights::none(stack.joints))?;
    for round in 1.. {
        let sigma = covariance(stack, &fit, full);
        let weights = Weights::full(&sigma).unwrap_or_else(|| Weights::per_joint(&deviations(&sigma)));
        let next = least_squares(stack, &weights)?;
        let moved = moved(&fit, &next, &weights, stack);
        fit = next;
        if moved < SETTLED || round == ROUNDS {
            return Ok(Weighed { fit, sigma, rounds: round, settled: moved < SETTLED });
        }
    }
    unreachable!("the last round returns")
}

/// `Sigma` from the residual.
fn covariance(stack: &Stack, fit: &Fit, full: bool) -> DMatrix<f64> {
    let mut sigma = residual_covariance(stack, fit);
    let share = if full { SHRINKAGE } else { 0.0 };
    for i in 0..stack.joints {
        for j in (0..stack.joints).filter(|&j| j != i) {
            sigma[(i, j)] *= share;
        }
    }
    sigma
}

/// Largest step of a parameter from one round to the next, in standard deviations for white noise.
pub fn moved(before: &Fit, after: &Fit, weights: &Weights, stack: &Stack) -> f64 {
    // Whitened noise has unit variance, so one over a whitened column's norm is the least standard deviation its parameter can have.
    let whitened = weights.apply(&stack.w);
    let steps = before.beta.iter().zip(after.beta.iter()).zip(whitened.column_iter());
    let step = |((before, after), column): ((&f64, &f64), nalgebra::DVectorView<f64>)| {
        let step = (after - before).abs();
        // Exact data has weights without end: there rounding is no step.
        if step < ROUNDING * after.abs() { 0.0 } else { step * column.norm() }
    };
    steps.map(step).fold(0.0, f64::max)
}
