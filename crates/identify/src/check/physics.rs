//! What any arm has, whatever its masses: inertia that is positive, friction that takes energy.

use super::equations::Fit;
use nalgebra::{DMatrix, DVector, Vector3};
use plumbline_model::Structure;
use plumbline_model::term::Motion;

/// Poses at which the inertia is evaluated.
const POSES: usize = 40;
/// Residuals of neighbouring blocks are alike: factor of the variance of the parameters, for a correlation over 0.4 s.
const CORRELATED: f64 = 10.0;

/// A figure with its standard deviation.
#[derive(Clone, Copy, Debug)]
pub(super) struct Figure {
    pub value: f64,
    pub std: f64,
}

impl Figure {
    fn of(fit: &Fit, gradient: &DVector<f64>) -> Figure {
        let variance = gradient.dot(&(&fit.covariance * gradient));
        Figure { value: gradient.dot(&fit.beta), std: (CORRELATED * variance.max(0.0)).sqrt() }
    }

    /// Value in standard deviations.
    pub fn deviations(&self) -> f64 {
        self.value / self.std.max(f64::MIN_POSITIVE)
    }
}

/// Mean inertia about each joint's axis, `M_jj(q)` with the other joints held, n \[kg m2 or kg\]. It is positive for every arm; torques with the
/// wrong sign make it negative.
pub(super) fn inertias(structure: &Structure, fit: &Fit, motion: &Motion) -> Vec<Figure> {
    let stride = (motion.samples() / POSES).max(1);
    let rows: Vec<usize> = (0..motion.samples()).step_by(stride).collect();
    let (m, n) = (rows.len(), motion.joints());
    let q = motion.q.select_rows(&rows);
    let along = |joint: Option<usize>| {
        let ddq = DMatrix::from_fn(m, n, |_, j| if Some(j) == joint { 1.0 } else { 0.0 });
        let still = DMatrix::zeros(m, n);
        structure.regressor(&Motion { q: q.clone(), dq: still, ddq, gravity: Vector3::zeros(), ..motion.clone() })
    };
    let still = along(None);
    let of = |j: usize| {
        let row = along(Some(j)).rows(j * m, m) - still.rows(j * m, m);
        Figure::of(fit, &(row.row_sum().transpose() / m as f64))
    };
    (0..n).map(of).collect()
}

/// Mean power that each joint's friction takes, n \[W\]. It is positive for every arm.
pub(super) fn dissipated(structure: &Structure, fit: &Fit, motion: &Motion) -> Vec<Figure> {
    let p = structure.columns().len();
    let of = |j: usize| {
        let mut gradient = DVector::zeros(p);
        for (c, column) in structure.columns().iter().enumerate() {
            let power = |k: usize| {
                let dq = motion.dq[(k, j)];
                match column.name.as_str() {
                    name if name == format!("fv{}", j + 1) => dq * dq,
                    name if name == format!("fc{}", j + 1) => dq * (100.0 * dq).tanh(),
                    _ => 0.0,
                }
            };
            if column.name.starts_with('f') {
                gradient[c] = (0..motion.samples()).map(power).sum::<f64>() / motion.samples() as f64;
            }
        }
        Figure::of(fit, &gradient)
    };
    (0..motion.joints()).map(of).collect()
}
