//! Ordinary least squares: equal weights for all equations.

use super::linear::{Fit, Weights, least_squares};
use super::stack::Stack;
use crate::EstimateError;

/// `beta = (W' W)^-1 W' tau`. Unbiased for exact positions; less precise than weighted least squares where joints differ in noise.
pub fn solve(stack: &Stack) -> Result<Fit, EstimateError> {
    least_squares(stack, &Weights::none(stack.joints))
}
