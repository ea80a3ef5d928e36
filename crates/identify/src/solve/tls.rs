//! Total least squares: noisy torques and regressor, with a joint covariance known up to one factor.

use super::linear::{Fit, Inverse, Weights, equilibrated, scale_rows};
use super::stack::Stack;
use crate::EstimateError;
use nalgebra::{DMatrix, DVector};
use plumbline_core::symmetric_eigen;

/// Solution of `(W - dW) beta = tau - dtau` with the smallest `[dW dtau]` in the metric of its covariance `C` (generalized total least
/// squares, Van Huffel and Vandewalle 1991).
///
/// `errors` is `sum over rows of [dW dtau]' [dW dtau]` as expected of the whitened rows, (p+1) x (p+1), in the parameters' units. Only
/// the ratios matter: the factor is estimated. With `R` the triangle of `[W tau]` and `C = S' S`, the solution is the right singular
/// vector of `S R^-1` with the largest singular value. Columns without noise have zeros in `C`.
///
/// Assumption: the regressor's noise is linear in the noise of the positions, with the ratio to the torques' noise given by `errors`.
/// Without noise of `W` in `errors` this is weighted least squares.
pub fn solve(stack: &Stack, errors: &DMatrix<f64>, weights: &Weights) -> Result<Fit, EstimateError> {
    let (rows, p) = stack.w.shape();
    assert_eq!(errors.shape(), (p + 1, p + 1), "one row and column per parameter, one for the torque");
    let (w, scales) = equilibrated(weights.apply(&stack.w));
    let tau = weights.apply(&DMatrix::from_column_slice(rows, 1, stack.tau.as_slice()));
    let tau_scale = 1.0 / tau.norm().max(f64::MIN_POSITIVE);
    let failed = EstimateError::Decomposition { rows, columns: p };

    // Restriction to the determined directions.
    let range = Inverse::of(w.clone().qr().r(), rows)?;
    let reduced = &w * &range.range;
    let r = range.rank;
    let mut all = DMatrix::zeros(rows, r + 1);
    all.columns_mut(0, r).copy_from(&reduced);
    all.column_mut(r).copy_from(&(tau.column(0) * tau_scale));
    let mut to_reduced = DMatrix::zeros(p + 1, r + 1);
    to_reduced.view_mut((0, 0), (p, r)).copy_from(&range.range);
    to_reduced[(p, r)] = 1.0;
    let mut scaled = errors.clone();
    for (c, scale) in scales.iter().chain([&tau_scale]).enumerate() {
        scaled.row_mut(c).scale_mut(*scale);
        scaled.column_mut(c).scale_mut(*scale);
    }
    let scaled = to_reduced.tr_mul(&(scaled * &to_reduced));

    let triangle = all.qr().r();
    let whitened = triangle
        .transpose()
        .solve_lower_triangular(&scaled)
        .and_then(|half| triangle.transpose().solve_lower_triangular(&half.transpose()))
        .ok_or(failed.clone())?;
    let eigen = symmetric_eigen((&whitened + whitened.transpose()) * 0.5).ok_or(failed.clone())?;
    let largest = eigen.eigenvalues.imax();
    let factor = 1.0 / eigen.eigenvalues[largest];
    let direction =
        triangle.solve_upper_triangular(&eigen.eigenvectors.column(largest).into_owned()).ok_or(failed.clone())?;
    if !(factor.is_finite() && direction[r] != 0.0) {
        return Err(failed);
    }
    let gamma = DVector::from_fn(r, |i, _| -direction[i] / (direction[r] * tau_scale));

    // The same solution as corrected least squares, (W'W - factor C)^-1 W' tau: its map from the torques gives the covariance.
    let corrected = reduced.tr_mul(&reduced) - scaled.view((0, 0), (r, r)) * factor;
    let inverse = corrected.try_inverse().ok_or(failed)?;
    let mut projection = &range.range * (inverse * reduced.transpose());
    scale_rows(&mut projection, &scales);
    let mut beta = &range.range * gamma;
    beta.iter_mut().zip(&scales).for_each(|(beta, scale)| *beta *= scale);
    Ok(Fit { beta, projection: weights.carry_back(&projection), rank: r, null_share: range.null_share })
}
