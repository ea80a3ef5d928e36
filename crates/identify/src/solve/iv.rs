//! Instrumental variables: unbiased although the positions, and so the regressor, are noisy.
//!
//! Least squares correlates the torques with a regressor that carries the positions' noise; its square does not average out, and pulls
//! parameters towards zero. Instruments `Z` are like the regressor but do not share its noise. The inverse-dynamics method of Janot,
//! Vandanjon and Gautier (2014) takes them from a simulated, noise-free motion. Recorded data seldom says how the arm is controlled, but
//! periodic motions repeat: the regressor of the odd periods is an instrument for that of the even ones, and the other way round. Where
//! the desired motion was recorded it serves instead, noise-free as the simulated one.

use super::linear::{Fit, Inverse, Weights, equilibrated, scale_rows};
use super::stack::Stack;
use crate::EstimateError;
use nalgebra::DMatrix;

/// A regressor and an instrument for it, both like `Stack::w`.
pub struct Pair {
    /// `W`, n m x p.
    pub regressor: DMatrix<f64>,
    /// `Z`, n m x p.
    pub instrument: DMatrix<f64>,
}

/// `beta = (sum Z' S W)^-1 (sum Z' S tau)` over the pairs, `S` the weights.
///
/// # Errors
/// No singular value decomposition, which finite data does not cause.
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
        normal += z.tr_mul(&w);
        projection += z.transpose();
    }
    let inverse = Inverse::of_normal(normal, rows)?;
    let mut projection = inverse.matrix * projection;
    scale_rows(&mut projection, &scales);
    let projection = weights.carry_back(&projection);
    Ok(Fit { beta: &projection * &stack.tau, projection, rank: inverse.rank, null_share: inverse.null_share })
}
