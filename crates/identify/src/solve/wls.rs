//! Weighted least squares, paper eqs. 9 and 10, with weights from the residual of the previous round.

use super::coloured::Noise;
use super::linear::{Fit, Weights, deviations, least_squares, min_noise, residual_covariance};
use super::stack::Stack;
use crate::EstimateError;
use nalgebra::DMatrix;

const MAX_ROUNDS: usize = 30;
/// Convergence: no parameter changes by more than this ratio of its standard deviation. Noise of the weights themselves
/// causes larger changes.
const CONVERGENCE_RATIO: f64 = 1e-2;
/// Ratio of a change to a parameter that is rounding.
const ROUNDING_RATIO: f64 = 1e-9;
/// Ratio that shrinks correlations between joints, so that their matrix stays positive definite.
const SHRINKAGE_RATIO: f64 = 0.98;

/// Weighted estimate with the covariance between joints.
pub struct Weighed {
    /// The parameters.
    pub fit: Fit,
    /// `Sigma`, n x n \[Nm2\].
    pub sigma: DMatrix<f64>,
    /// Rounds of weights.
    pub rounds: usize,
    /// Whether the weights converged.
    pub converged: bool,
}

/// `beta = (W' Sigma^-1 W)^-1 W' Sigma^-1 tau` with `Sigma` the covariance of the torques' errors between the joints of one sample:
/// its diagonal as in the paper, or (`full`) all of it.
///
/// With the `noise` by frequency, its weights: [`Noise::weights`].
pub fn solve(stack: &Stack, full: bool, noise: Option<&Noise>) -> Result<Weighed, EstimateError> {
    let mut fit = least_squares(stack, &Weights::none(stack.joints))?;
    for round in 1.. {
        let sigma = covariance(stack, &fit, full);
        let weights = match noise {
            Some(noise) => noise.weights(stack, &deviations(&sigma), &min_noise(stack)),
            None => Weights::full(&sigma).unwrap_or_else(|| Weights::per_joint(&deviations(&sigma))),
        };
        let next = least_squares(stack, &weights)?;
        let moved = moved(&fit, &next, &weights, stack);
        fit = next;
        if moved < CONVERGENCE_RATIO || round == MAX_ROUNDS {
            return Ok(Weighed { fit, sigma, rounds: round, converged: moved < CONVERGENCE_RATIO });
        }
    }
    unreachable!("the last round returns")
}

/// `Sigma` from the residual.
fn covariance(stack: &Stack, fit: &Fit, full: bool) -> DMatrix<f64> {
    let mut sigma = residual_covariance(stack, fit);
    let share = if full { SHRINKAGE_RATIO } else { 0.0 };
    for i in 0..stack.joints {
        for j in (0..stack.joints).filter(|&j| j != i) {
            sigma[(i, j)] *= share;
        }
    }
    sigma
}

/// Largest change of a parameter between two rounds, in standard deviations for white noise.
pub fn moved(before: &Fit, after: &Fit, weights: &Weights, stack: &Stack) -> f64 {
    // Whitened noise has unit variance, so one over a whitened column's norm is the least standard deviation its parameter can have.
    let whitened = weights.apply(&stack.w);
    let steps = before.beta.iter().zip(after.beta.iter()).zip(whitened.column_iter());
    let step = |((before, after), column): ((&f64, &f64), nalgebra::DVectorView<f64>)| {
        let step = (after - before).abs();
        // With exact data the weights are very large: rounding is ignored.
        if step < ROUNDING_RATIO * after.abs() { 0.0 } else { step * column.norm() }
    };
    steps.map(step).fold(0.0, f64::max)
}
