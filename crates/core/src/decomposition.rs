//! Eigenvalues and singular values with a bound on the iterations, and the product that normal equations are made of.
//!
//! nalgebra's own `svd`, `singular_values` and `symmetric_eigen` iterate until convergence, which never
//! comes for a matrix with an entry that is not finite. Every decomposition in plumbline calls these functions (tested by `tests/walls.rs`).

use nalgebra::allocator::Allocator;
use nalgebra::{
    DMatrix, DVector, DefaultAllocator, Dim, DimDiff, DimSub, Dyn, Matrix, OMatrix, SVD, Storage, SymmetricEigen, U1,
};

/// Maximum iterations per row or column. Two or three are usual; LAPACK allows 30.
const MAX_ITERATIONS_PER_ROW: usize = 100;

/// Eigenvalues (not sorted) and eigenvectors of a symmetric matrix; only its lower triangle is read. `None` for an entry that is not
/// finite, or when the iterations do not converge.
pub fn symmetric_eigen<D>(m: OMatrix<f64, D, D>) -> Option<SymmetricEigen<f64, D>>
where
    D: Dim + DimSub<U1>,
    DefaultAllocator: Allocator<D, D> + Allocator<D> + Allocator<DimDiff<D, U1>>,
{
    let bound = MAX_ITERATIONS_PER_ROW * (m.nrows() + 1);
    let finite = m.iter().all(|value| value.is_finite());
    finite.then(|| SymmetricEigen::try_new(m, f64::EPSILON, bound)).flatten()
}

/// Singular value decomposition `m = U S V'`, the largest singular value first, with both sets of singular vectors. `None` as in [`symmetric_eigen`].
pub fn svd(m: DMatrix<f64>) -> Option<SVD<f64, Dyn, Dyn>> {
    bounded(m, true)
}

/// Singular values alone, the largest first. `None` as in [`symmetric_eigen`].
pub fn singular_values(m: DMatrix<f64>) -> Option<DVector<f64>> {
    Some(bounded(m, false)?.singular_values)
}

/// nalgebra multiplies by blocks only where each dimension exceeds this.
const LARGEST_UNBLOCKED_DIMENSION: usize = 5;

/// `A'B`: in blocks, or for a few columns by dot products (`tr_mul`), which need no transposed copy.
pub fn transposed_product(
    a: &Matrix<f64, Dyn, Dyn, impl Storage<f64, Dyn, Dyn>>,
    b: &Matrix<f64, Dyn, Dyn, impl Storage<f64, Dyn, Dyn>>,
) -> DMatrix<f64> {
    if a.ncols().min(b.ncols()) <= LARGEST_UNBLOCKED_DIMENSION { a.tr_mul(b) } else { a.transpose() * b }
}

fn bounded(m: DMatrix<f64>, vectors: bool) -> Option<SVD<f64, Dyn, Dyn>> {
    let bound = MAX_ITERATIONS_PER_ROW * (m.nrows().min(m.ncols()) + 1);
    let finite = !m.is_empty() && m.iter().all(|value| value.is_finite());
    finite.then(|| SVD::try_new(m, vectors, vectors, f64::EPSILON, bound)).flatten()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    #[test]
    fn finite_matrices_give_the_results_of_nalgebra() {
        let m = DMatrix::from_fn(9, 5, |i, k| ((3 * i + 7 * k) as f64).sin());
        let found = svd(m.clone()).unwrap();
        assert!((&found.singular_values - m.singular_values()).amax() < 1e-12);
        assert!((found.recompose().unwrap() - &m).amax() < 1e-12);
        assert_eq!(singular_values(m.clone()).unwrap().len(), 5);
        let gram = transposed_product(&m, &m);
        assert!((&gram - m.transpose() * &m).amax() < 1e-12);
        // As many columns as are multiplied in blocks.
        let wide = DMatrix::from_fn(9, LARGEST_UNBLOCKED_DIMENSION + 2, |i, k| ((5 * i + 2 * k) as f64).cos());
        for other in [&wide, &m] {
            assert!((transposed_product(&wide, other) - wide.tr_mul(other)).amax() < 1e-12);
            assert!((transposed_product(other, &wide) - other.transpose() * &wide).amax() < 1e-12);
        }
        let eigen = symmetric_eigen(gram.clone()).unwrap();
        assert!((eigen.recompose() - gram).amax() < 1e-12);
        assert_eq!(singular_values(DMatrix::zeros(4, 3)).unwrap(), DVector::zeros(3));
    }

    #[test]
    fn a_matrix_with_a_non_finite_entry_gives_none() {
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
            for index in 0..9 {
                let mut m = Matrix3::new(2.0, 1.0, 0.5, 1.0, 3.0, 0.2, 0.5, 0.2, 1.0);
                m[index] = value;
                let dynamic = DMatrix::from_fn(3, 3, |i, k| m[(i, k)]);
                assert!(symmetric_eigen(m).is_none());
                assert!(svd(dynamic.clone()).is_none() && singular_values(dynamic).is_none());
            }
        }
    }
}
