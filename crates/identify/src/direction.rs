//! Direction of gravity from the torques of an arm at rest.
//!
//! At rest the torque is `tau(q, g) = tau_0 + T(q) g`, linear in the gravity vector. With a model that is valid in any mounting, weighted least
//! squares on the torques of one or several poses gives
//!
//! ```text
//! g = (sum T' S^-1 T)^-1 sum T' S^-1 (tau - tau_0),    covariance (sum T' S^-1 T)^-1,    S = diag(sigma_j^2)
//! ```
//!
//! `T(q)` are the model's torques under gravity of 1 m/s2 along the base axes. The result detects a wrong sign of a torque sensor, a wrongly
//! declared mounting and an undeclared payload without a motion.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use plumbline_core::{JointVec, symmetric_eigen};
use plumbline_model::term::Sample;
use plumbline_model::{G, Mounting, TorqueModel};

/// An arm at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Joint position \[rad\].
    pub q: JointVec,
    /// Mean of the measured joint torque \[Nm\].
    pub tau: JointVec,
}

/// Gravity estimated from torques at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct Direction {
    /// Gravitational acceleration in the base frame \[m/s2\].
    pub gravity: Vector3<f64>,
    /// Its covariance \[m2/s4\].
    pub covariance: Matrix3<f64>,
    /// Measured minus modelled torque with that gravity, pose by pose \[Nm\].
    pub residual: Vec<JointVec>,
}

/// Why the torques do not determine the direction.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum DirectionError {
    #[error("there is no pose to read the direction of gravity from")]
    NoPose,
    #[error("in these poses the torques do not determine the direction of gravity: along [{:.2}, {:.2}, {:.2}] its standard deviation is {std:.1} m/s2", .along.x, .along.y, .along.z)]
    NotIdentifiable { along: Vector3<f64>, std: f64 },
}

/// Maximum standard deviation of gravity along its least determined direction \[m/s2\].
const MAX_GRAVITY_STD: f64 = 5.0;

impl Direction {
    /// The direction as a mounting; the strength is ignored.
    pub fn mounting(&self) -> Mounting {
        Mounting::along(&self.gravity)
    }

    /// Angle to the gravity of a mounting \[rad\].
    pub fn angle_to(&self, mounting: &Mounting) -> f64 {
        self.mounting().angle_to(mounting)
    }

    /// Standard deviation of the direction \[rad\]: the larger one of the two perpendicular to it.
    pub fn std(&self) -> f64 {
        let strength = self.gravity.norm().max(1e-9);
        let along = self.gravity / strength;
        let across = Matrix3::identity() - along * along.transpose();
        let spread = across * self.covariance * across;
        let eigen = symmetric_eigen(spread);
        eigen.map_or(f64::INFINITY, |eigen| eigen.eigenvalues.max().max(0.0).sqrt() / strength)
    }

    /// Sum of squared residuals divided by the joints' variances; expected value `n poses - 3` for a valid model.
    pub fn misfit(&self, sigma: &[f64]) -> f64 {
        let square = |(rest, sigma): (&f64, &f64)| (rest / sigma).powi(2);
        self.residual.iter().map(|pose| pose.iter().zip(sigma).map(square).sum::<f64>()).sum()
    }

    /// Ratio of the strength to standard gravity; far from 1 for an invalid model or an undeclared payload.
    pub fn strength(&self) -> f64 {
        self.gravity.norm() / G
    }
}

/// Joint (from 0) whose torque sensor has the wrong sign. Inverting its sign must reduce the misfit by a factor of 4, from a value above that
/// of the noise.
///
/// # Errors
/// As [`direction`].
pub fn wrong_sign(model: &TorqueModel, poses: &[Pose], sigma: &[f64]) -> Result<Option<usize>, DirectionError> {
    let n = sigma.len();
    let misfit_with = |inverted: Option<usize>| {
        let turned = |pose: &Pose| {
            let mut pose = *pose;
            inverted.iter().for_each(|&j| pose.tau[j] = -pose.tau[j]);
            pose
        };
        let poses: Vec<Pose> = poses.iter().map(turned).collect();
        direction(model, &poses, sigma).map(|found| found.misfit(sigma))
    };
    let right = misfit_with(None)?;
    let each = (0..n).map(|j| Ok((j, misfit_with(Some(j))?))).collect::<Result<Vec<_>, DirectionError>>()?;
    let best = each.into_iter().min_by(|a, b| a.1.total_cmp(&b.1));
    let enough = (n * poses.len()) as f64;
    Ok(best.filter(|&(_, misfit)| right > enough && 4.0 * misfit < right).map(|(j, _)| j))
}

/// Estimates gravity from the torques of an arm at rest. `sigma` is the standard deviation of each joint's torque at rest, static friction
/// included, n \[Nm\].
///
/// # Errors
/// No pose; poses in which gravity is not identifiable.
pub fn direction(model: &TorqueModel, poses: &[Pose], sigma: &[f64]) -> Result<Direction, DirectionError> {
    let n = model.structure().chain().len();
    if poses.is_empty() {
        return Err(DirectionError::NoPose);
    }
    assert_eq!(sigma.len(), n, "one standard deviation per joint");
    let torque = |gravity: &Vector3<f64>, pose: &Pose| {
        model.evaluator(gravity).torque(&Sample { q: pose.q, ..Sample::default() }).0
    };
    let rows = n * poses.len();
    let (mut a, mut b) = (DMatrix::zeros(rows, 3), DVector::zeros(rows));
    for (index, pose) in poses.iter().enumerate() {
        let none = torque(&Vector3::zeros(), pose);
        for axis in 0..3 {
            let one = torque(&Vector3::ith(axis, 1.0), pose);
            for j in 0..n {
                a[(index * n + j, axis)] = (one[j] - none[j]) / sigma[j];
            }
        }
        for j in 0..n {
            b[index * n + j] = (pose.tau[j] - none[j]) / sigma[j];
        }
    }
    let information: Matrix3<f64> = (a.transpose() * &a).fixed_view::<3, 3>(0, 0).into_owned();
    let Some(eigen) = symmetric_eigen(information) else {
        return Err(DirectionError::NotIdentifiable { along: Vector3::zeros(), std: f64::INFINITY });
    };
    let (weakest, least) = eigen.eigenvalues.argmin();
    let std = if least > 0.0 { least.sqrt().recip() } else { f64::INFINITY };
    if std > MAX_GRAVITY_STD {
        return Err(DirectionError::NotIdentifiable { along: eigen.eigenvectors.column(weakest).into_owned(), std });
    }
    let inverse = eigen.eigenvalues.map(f64::recip);
    let covariance = eigen.eigenvectors * Matrix3::from_diagonal(&inverse) * eigen.eigenvectors.transpose();
    let right: Vector3<f64> = (a.transpose() * b).fixed_rows::<3>(0).into_owned();
    let gravity = covariance * right;
    let residual = poses.iter().map(|pose| {
        let modelled = torque(&gravity, pose);
        std::array::from_fn(|j| if j < n { pose.tau[j] - modelled[j] } else { 0.0 })
    });
    Ok(Direction { gravity, covariance, residual: residual.collect() })
}
