//! Least squares over a whole motion without its stacked regressor.

use super::gram::Gram;
use super::solve::{CHOLESKY_LIMIT, solve};
use super::{StreamingError, active};
use nalgebra::{DMatrix, DVector};
use plumbline_core::{JointVec, MAX_JOINTS, svd};
use plumbline_model::term::{Motion, Sample};
use plumbline_model::{SampleRegressor, Structure};

/// How the equations were solved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Solver {
    /// By their normal equations, and a second time for the residual of the first.
    Normal,
    /// By orthogonal triangularisation of the whole regressor: the normal equations would have lost too many digits.
    Orthogonal,
}

/// Parameters of a whole motion.
#[derive(Clone, Debug)]
pub struct LeastSquares {
    /// The parameters.
    pub beta: DVector<f64>,
    /// `(W' Sigma^-1 W)^-1` (p x p), their covariance when the noise has the standard deviations given and no correlation; `None` when
    /// the equations do not determine every parameter.
    pub covariance: Option<DMatrix<f64>>,
    /// How they were found.
    pub solver: Solver,
}

/// `beta = (W' Sigma^-1 W)^-1 W' Sigma^-1 tau` (paper eq. 10) for torques `tau` (N x n \[Nm\]) along a motion, `sigma` the standard deviation of
/// each joint's torque (n \[Nm\]).
///
/// The rule: with a condition number of the equilibrated `W' Sigma^-1 W` up to [`CHOLESKY_LIMIT`] (1e5 of `W`) its rows are computed twice,
/// once for the normal equations and once for the residual of their solution, whose own solution corrects it; nothing of the size of the
/// motion is kept. Beyond that limit the whole regressor is made and solved by QR and singular values (the smallest solution).
/// Errors: a term that depends on more than one sample, fewer equations than parameters, numbers that are not finite.
pub fn least_squares(
    structure: &Structure,
    motion: &Motion,
    tau: &DMatrix<f64>,
    sigma: &[f64],
) -> Result<LeastSquares, StreamingError> {
    let (samples, n, p) = (motion.samples(), motion.joints(), structure.columns().len());
    assert_eq!(tau.shape(), (samples, n), "one torque per position");
    assert_eq!((structure.chain().len(), sigma.len()), (n, n), "joints of the arm, the motion and the noise");
    if samples * n < p {
        return Err(StreamingError::TooFewRows { rows: samples * n, columns: p });
    }
    let term = |id| StreamingError::Term { id };
    let mut regressor = SampleRegressor::new(structure, &motion.gravity).map_err(term)?;
    let mut gram = Gram::new(p, active(structure), 1.0);
    for k in 0..samples {
        let (sample, tau) = row(motion, tau, k);
        gram.add(regressor.at(&sample), &tau);
    }
    let (m, b) = gram.normal_equations(sigma);
    let failed = StreamingError::Decomposition { columns: p };
    let first = solve(&m, &b).ok_or(failed.clone())?;
    if first.condition > CHOLESKY_LIMIT {
        return orthogonal(structure, motion, tau, sigma).ok_or(failed);
    }

    // What is left, weighed and multiplied by the transposed rows: the gradient that rounding of the products has left.
    let mut beta = first.beta;
    let weights: Vec<f64> = sigma.iter().map(|sigma| 1.0 / (sigma * sigma)).collect();
    let mut gradient = DVector::<f64>::zeros(p);
    for k in 0..samples {
        let (sample, mut residual) = row(motion, tau, k);
        let columns = regressor.at(&sample);
        for (column, beta) in columns.iter().zip(beta.iter()) {
            residual.iter_mut().zip(column).for_each(|(residual, entry)| *residual -= entry * beta);
        }
        residual.iter_mut().zip(&weights).for_each(|(residual, weight)| *residual *= weight);
        for (sum, column) in gradient.iter_mut().zip(columns) {
            *sum += column.iter().zip(&residual).map(|(entry, residual)| entry * residual).sum::<f64>();
        }
    }
    beta += &first.inverse * gradient;
    Ok(LeastSquares { beta, covariance: Some(first.inverse), solver: Solver::Normal })
}

fn row(motion: &Motion, tau: &DMatrix<f64>, k: usize) -> (Sample, JointVec) {
    let (mut sample, mut torque) = (Sample::default(), [0.0; MAX_JOINTS]);
    for j in 0..motion.joints() {
        (sample.q[j], sample.dq[j], sample.ddq[j]) = (motion.q[(k, j)], motion.dq[(k, j)], motion.ddq[(k, j)]);
        torque[j] = tau[(k, j)];
    }
    (sample, torque)
}

/// The same by QR of the equilibrated regressor and singular values of its triangle.
fn orthogonal(structure: &Structure, motion: &Motion, tau: &DMatrix<f64>, sigma: &[f64]) -> Option<LeastSquares> {
    let samples = motion.samples();
    let mut w = structure.regressor(motion);
    let mut right = DVector::from_column_slice(tau.as_slice());
    for (j, sigma) in sigma.iter().enumerate() {
        w.rows_mut(j * samples, samples).scale_mut(1.0 / sigma);
        right.rows_mut(j * samples, samples).scale_mut(1.0 / sigma);
    }
    let scale: Vec<f64> =
        w.column_iter().map(|column| column.norm()).map(|norm| if norm > 0.0 { 1.0 / norm } else { 0.0 }).collect();
    w.column_iter_mut().zip(&scale).for_each(|(mut column, scale)| column *= *scale);
    let qr = w.qr();
    let mut projected = right;
    qr.q_tr_mul(&mut projected);
    let p = scale.len();
    let svd = svd(qr.unpack_r())?;
    let least = f64::EPSILON * samples as f64 * svd.singular_values.max();
    let mut beta = svd.solve(&projected.rows(0, p).into_owned(), least).ok()?;
    beta.iter_mut().zip(&scale).for_each(|(beta, scale)| *beta *= scale);
    let v_t = svd.v_t.as_ref()?;
    let covariance = (svd.singular_values.min() > least).then(|| {
        let inverse = DMatrix::from_diagonal(&svd.singular_values.map(|s| 1.0 / (s * s)));
        let even = v_t.transpose() * inverse * v_t;
        DMatrix::from_fn(p, p, |i, k| scale[i] * even[(i, k)] * scale[k])
    });
    Some(LeastSquares { beta, covariance, solver: Solver::Orthogonal })
}
