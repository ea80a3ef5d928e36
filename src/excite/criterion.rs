//! How well a motion excites the parameters of a model: paper eq. 11 and its other readings.

use super::fourier::Fourier;
use crate::model::conditioning::{Conditions, conditions, friction_columns};
use crate::model::structure::Structure;
use crate::model::term::Motion;
use nalgebra::{DMatrix, DVector, Vector3};

/// One period of a Fourier motion on an even grid of `samples`, in a mounting.
pub fn sampled(fourier: &Fourier, gravity: &Vector3<f64>, samples: usize) -> Motion {
    let n = fourier.joints();
    let dt = fourier.period / samples as f64;
    let zeros = || DMatrix::zeros(samples, n);
    let mut motion = Motion { dt, q: zeros(), dq: zeros(), ddq: zeros(), gravity: *gravity, periodic: true };
    for j in 0..n {
        for k in 0..samples {
            let point = fourier.at(j, k as f64 * dt);
            (motion.q[(k, j)], motion.dq[(k, j)], motion.ddq[(k, j)]) = (point.q, point.dq, point.ddq);
        }
    }
    motion
}

/// All condition numbers of a motion's stacked base regressor; `sigma` is each joint's torque noise, n \[Nm\].
pub fn evaluate(structure: &Structure, motion: &Motion, sigma: &[f64]) -> Conditions {
    conditions(&structure.regressor(motion), &friction_columns(structure), sigma)
}

/// Condition number of the raw stacked base regressor, for searching: from the eigenvalues of `W' W`, which is three times as fast
/// as [`evaluate`] and good to 1e-3 below a condition number of 1e6. Infinite above 1e7.
pub fn raw_condition(structure: &Structure, motion: &Motion) -> f64 {
    let w = structure.regressor(motion);
    let gram = w.tr_mul(&w);
    if gram.iter().any(|value| !value.is_finite()) {
        return f64::INFINITY;
    }
    let eigenvalues: DVector<f64> = gram.symmetric_eigenvalues();
    let (least, largest) = (eigenvalues.min(), eigenvalues.max());
    if least > 1e-14 * largest { (largest / least).sqrt() } else { f64::INFINITY }
}
