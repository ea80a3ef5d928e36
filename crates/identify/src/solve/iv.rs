//! Instrumental variables: unbiased with noisy positions and hence a noisy regressor.
//!
//! In least squares the square of the regressor's noise does not average out and biases parameters towards zero. Instruments `Z` are
//! correlated with the regressor but not with its noise. Janot, Vandanjon and Gautier (2014) use a simulated, noise-free motion. Here the
//! regressor of the odd periods of a periodic motion is the instrument for that of the even ones, and vice versa. A recorded desired motion is
//! used instead where given.

use super::linear::{Fit, Inverse, Weights, equilibrated, scale_rows};
use super::stack::Stack;
use crate::EstimateError;
use nalgebra::DMatrix;
use plumbline_core::transposed_product;

/// A regressor and its instrument, both shaped as `Stack::w`.
pub struct Pair {
    /// `W`, n m x p.
    pub regressor: DMatrix<f64>,
    /// `Z`, n m x p.
    pub instrument: DMatrix<f64>,
}

/// `beta = (sum Z' S W)^-1 (sum Z' S tau)` over the pairs, `S` the weights.
///
/// # Errors
/// No singular value decomposition; does not occur with finite data.
pub fn solve(stack: &Stack, pairs: &[Pair], weights: &Weights) -> Result<Fit, EstimateError> {
    let (rows, p) = stack.w.shape();
    // Equilibrated by one scale per column, so that the rank does not depend on the parameters' units.
    let (_, scales) = equilibrated(weights.apply(&stack.w));
    let mut normal = DMatrix::zeros(p, p);
    let mut projection = DMatrix::zeros(p, rows);
    for pair in pairs {
        let (mut z, mut w) = (weights.apply(&pair.instrument), weights.apply(&pair.regressor));
        for (c, scale) in scales.iter().enumerate() {
            z.column_mut(c).scale_mut(*scale);
            w.column_mut(c).scale_mut(*scale);
        }
        normal += transposed_product(&z, &w);
        projection += z.transpose();
    }
    let inverse = Inverse::of_normal(normal, rows)?;
    let mut projection = inverse.matrix * projection;
    scale_rows(&mut projection, &scales);
    let projection = weights.carry_back(&projection);
    Ok(Fit { beta: &projection * &stack.tau, projection, rank: inverse.rank, null_share: inverse.null_share })
}
