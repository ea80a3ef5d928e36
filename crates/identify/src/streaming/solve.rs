//! Solution of normal equations in the determined directions.

use nalgebra::{DMatrix, DVector};
use plumbline_core::symmetric_eigen;
use plumbline_model::ZERO_COLUMN;

/// Maximum condition number of the equilibrated normal matrix for a Cholesky factorisation. It is the square of the regressor's:
/// five of its digits are lost at this limit, ten of them remain.
pub const CHOLESKY_LIMIT: f64 = 1e10;
/// Directions whose eigenvalue is below this share of the largest are left undetermined: rounding of the products reaches 1e-15 of
/// the largest.
const RANK_TOLERANCE: f64 = 1e-12;

/// `beta` of `M beta = b`, and `M`'s inverse in the determined directions.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The parameters; in undetermined directions the smallest ones (of equilibrated columns).
    pub beta: DVector<f64>,
    /// Inverse of `M`, p x p.
    pub inverse: DMatrix<f64>,
    /// Share of each parameter that lies in undetermined directions.
    pub null_share: Vec<f64>,
    /// Number of determined directions.
    pub rank: usize,
    /// Condition number of the equilibrated `M`, the square of the equilibrated regressor's: in the 1-norm (at most p times that of
    /// the singular values) when Cholesky was enough, else by eigenvalues.
    pub condition: f64,
}

/// Solves `M beta = b` for a symmetric `M` without negative eigenvalues: by Cholesky after equilibration, and by eigenvalues when the
/// condition is beyond [`CHOLESKY_LIMIT`]. `None` when an entry is not finite.
pub fn solve(m: &DMatrix<f64>, b: &DVector<f64>) -> Option<Solution> {
    let p = m.ncols();
    assert!(m.nrows() == p && b.len() == p, "a square matrix and a right side of its size");
    if m.iter().chain(b.iter()).any(|value| !value.is_finite()) {
        return None;
    }
    // Equilibrate: the rank must not depend on the parameters' units.
    let largest = m.diagonal().iter().copied().fold(0.0, f64::max);
    let scale: DVector<f64> = m
        .diagonal()
        .map(|square| if square > ZERO_COLUMN * ZERO_COLUMN * largest { square.sqrt().recip() } else { 0.0 });
    let even = DMatrix::from_fn(p, p, |i, k| scale[i] * m[(i, k)] * scale[k]);
    let right = scale.component_mul(b);

    let exact = even.clone().cholesky().and_then(|factors| {
        let inverse = factors.inverse();
        let condition = one_norm(&even) * one_norm(&inverse);
        (condition <= CHOLESKY_LIMIT).then(|| (factors.solve(&right), inverse, condition))
    });
    let (beta, inverse, null_share, rank, condition) = match exact {
        Some((beta, inverse, condition)) => (beta, inverse, vec![0.0; p], p, condition),
        None => {
            let eigen = symmetric_eigen(even)?;
            let top = eigen.eigenvalues.max();
            let (mut inverse, mut null_share, mut rank) = (DMatrix::zeros(p, p), vec![0.0; p], 0);
            for (k, &value) in eigen.eigenvalues.iter().enumerate() {
                let direction = eigen.eigenvectors.column(k);
                if value > RANK_TOLERANCE * top {
                    inverse.ger(1.0 / value, &direction, &direction, 1.0);
                    rank += 1;
                } else {
                    null_share.iter_mut().zip(direction.iter()).for_each(|(share, part)| *share += part * part);
                }
            }
            let least = eigen.eigenvalues.min();
            let condition = if least > 0.0 { top / least } else { f64::INFINITY };
            (&inverse * &right, inverse, null_share, rank, condition)
        }
    };
    Some(Solution {
        beta: beta.component_mul(&scale),
        inverse: DMatrix::from_fn(p, p, |i, k| scale[i] * inverse[(i, k)] * scale[k]),
        null_share,
        rank,
        condition,
    })
}

/// Largest sum of sizes of a column.
fn one_norm(m: &DMatrix<f64>) -> f64 {
    m.column_iter().map(|column| column.lp_norm(1)).fold(0.0, f64::max)
}
