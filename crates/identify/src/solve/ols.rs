//! Ordinary least squares: every equation counts alike, whatever its joint.

use super::linear::{Fit, Weights, least_squares};
use super::stack::Stack;
use crate::EstimateError;

/// `beta = (W' W)^-1 W' tau`. Unbiased where positions are exact; less precise than weights by joint where joints differ in noise.
pub fn solve(stack: &Stack) -> Result<Fit, EstimateError> {
    least_squares(stack, &Weights::none(stack.joints))
}
