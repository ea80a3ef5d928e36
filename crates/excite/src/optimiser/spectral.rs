//! Smooth surrogates of the criteria as functions of the information matrix `M = W' W`, with exact gradients.
//!
//! A condition number is not smooth where extreme eigenvalues coincide, as they do at its minimum. The surrogate
//! `L_p = (1/2p) (log tr M^p + log tr M^-p)` is smooth. It is above `log cond W = (1/2) log (lambda_max / lambda_min)` by at most
//! `log(b) / p` for `b` columns, and converges to it for large `p`.

use super::super::criterion::Criterion;
use nalgebra::DMatrix;
use plumbline_core::symmetric_eigen;

/// Value and gradient `dL/dM` (symmetric) at the information matrix `gram`; `None` when it is not numerically positive definite.
///
/// `rigid` is the number of leading columns that belong to the rigid body; [`Criterion::RawRigid`] uses only those.
pub fn surrogate(criterion: Criterion, gram: &DMatrix<f64>, rigid: usize, p: f64) -> Option<(f64, DMatrix<f64>)> {
    match criterion {
        Criterion::Raw | Criterion::Weighted => log_condition(gram.clone(), p),
        Criterion::RawRigid => {
            let (value, inner) = log_condition(gram.view((0, 0), (rigid, rigid)).into_owned(), p)?;
            let mut gradient = DMatrix::zeros(gram.nrows(), gram.ncols());
            gradient.view_mut((0, 0), (rigid, rigid)).copy_from(&inner);
            Some((value, gradient))
        }
        Criterion::Equilibrated => equilibrated(gram, p),
        Criterion::LogDet => log_det(gram),
    }
}

/// Ratio of smallest to largest eigenvalue below which the matrix counts as singular.
const SINGULAR_RATIO: f64 = 1e-14;

/// `L_p` of a matrix.
fn log_condition(gram: DMatrix<f64>, p: f64) -> Option<(f64, DMatrix<f64>)> {
    let eigen = symmetric_eigen(gram)?;
    let (least, largest) = (eigen.eigenvalues.min(), eigen.eigenvalues.max());
    if least <= SINGULAR_RATIO * largest {
        return None;
    }
    let up = eigen.eigenvalues.map(|l| (l / largest).powf(p));
    let down = eigen.eigenvalues.map(|l| (least / l).powf(p));
    let (above, below) = (up.sum(), down.sum());
    let value = 0.5 * ((above.ln() + below.ln()) / p + (largest / least).ln());
    let mut scaled = eigen.eigenvectors.clone();
    for (i, mut column) in scaled.column_iter_mut().enumerate() {
        column *= 0.5 * (up[i] / above - down[i] / below) / eigen.eigenvalues[i];
    }
    Some((value, scaled * eigen.eigenvectors.transpose()))
}

/// `L_p` of `D^-1/2 M D^-1/2` with `D` the diagonal of `M`: every column of `W` divided by its norm.
fn equilibrated(gram: &DMatrix<f64>, p: f64) -> Option<(f64, DMatrix<f64>)> {
    let n = gram.nrows();
    let largest = gram.diagonal().max();
    if gram.diagonal().iter().any(|d| d.is_nan() || *d <= SINGULAR_RATIO * largest) {
        return None;
    }
    let scale: Vec<f64> = gram.diagonal().iter().map(|d| 1.0 / d.sqrt()).collect();
    let unit = DMatrix::from_fn(n, n, |i, j| gram[(i, j)] * scale[i] * scale[j]);
    let (value, inner) = log_condition(unit.clone(), p)?;
    let mut gradient = DMatrix::from_fn(n, n, |i, j| inner[(i, j)] * scale[i] * scale[j]);
    for i in 0..n {
        let along: f64 = (0..n).map(|j| inner[(i, j)] * unit[(i, j)]).sum();
        gradient[(i, i)] -= along / gram[(i, i)];
    }
    Some((value, gradient))
}

/// `-(1/2b) log det M`: half the mean of the logarithms of the eigenvalues of `M^-1`.
fn log_det(gram: &DMatrix<f64>) -> Option<(f64, DMatrix<f64>)> {
    let b = gram.nrows() as f64;
    let factor = gram.clone().cholesky()?;
    let value = -factor.l_dirty().diagonal().map(f64::ln).sum() / b;
    value.is_finite().then(|| (value, factor.inverse() * (-0.5 / b)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_model::condition;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn tall(seed: u64) -> DMatrix<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        DMatrix::from_fn(40, 6, |_, c| rng.random_range(-1.0..1.0) * [1.0, 3.0, 0.2, 1.0, 0.7, 5.0][c])
    }

    const ALL: [Criterion; 5] =
        [Criterion::Raw, Criterion::RawRigid, Criterion::Equilibrated, Criterion::Weighted, Criterion::LogDet];

    #[test]
    fn the_surrogate_converges_to_the_condition_number() {
        let w = tall(2);
        let gram = w.tr_mul(&w);
        let mut unit = w.clone();
        for mut column in unit.column_iter_mut() {
            column /= column.norm();
        }
        let exact = [
            (Criterion::Raw, condition(&w)),
            (Criterion::RawRigid, condition(&w.columns(0, 4).into_owned())),
            (Criterion::Equilibrated, condition(&unit)),
        ];
        for (criterion, exact) in exact {
            let mut last = f64::INFINITY;
            for p in [1.0, 2.0, 8.0, 64.0] {
                let value = surrogate(criterion, &gram, 4, p).unwrap().0;
                assert!(value < last && value >= exact.ln() - 1e-12 && value < exact.ln() + 6.0_f64.ln() / p);
                last = value;
            }
        }
    }

    #[test]
    fn log_det_is_the_mean_of_the_log_singular_values() {
        let w = tall(3);
        let expected = -w.singular_values().map(f64::ln).sum() / 6.0;
        assert!((surrogate(Criterion::LogDet, &w.tr_mul(&w), 4, 1.0).unwrap().0 - expected).abs() < 1e-12);
    }

    #[test]
    fn an_unexcited_parameter_gives_no_value() {
        let mut w = tall(4);
        w.column_mut(2).fill(0.0);
        for criterion in ALL {
            assert!(surrogate(criterion, &w.tr_mul(&w), 4, 2.0).is_none(), "{criterion:?}");
        }
    }
}
