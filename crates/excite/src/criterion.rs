//! Excitation criteria of a motion: condition numbers of the base regressor (paper eq. 11 and variants), and D-optimality.

use super::ExciteError;
use super::fourier::Fourier;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::singular_values;
use plumbline_model::term::Motion;
use plumbline_model::{Conditions, Structure, conditions, dependent_columns, friction_columns};
use serde::{Deserialize, Serialize};

/// Criterion that a search minimises.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Criterion {
    /// Condition number of the stacked base regressor `W`.
    #[default]
    Raw,
    /// Condition number of the rigid-body columns of `W`.
    RawRigid,
    /// Condition number of `W` with every column divided by its norm.
    Equilibrated,
    /// Condition number of `Sigma^-1/2 W`: every row divided by its joint's torque noise (paper eq. 11).
    Weighted,
    /// `-log det(W' Sigma^-1 W)`: the volume of the parameters' confidence ellipsoid (D-optimality).
    LogDet,
}

impl Criterion {
    /// All criteria.
    pub const ALL: [Criterion; 5] =
        [Criterion::Raw, Criterion::RawRigid, Criterion::Equilibrated, Criterion::Weighted, Criterion::LogDet];

    /// Whether rows are divided by their joint's torque noise.
    pub fn is_weighted(self) -> bool {
        matches!(self, Criterion::Weighted | Criterion::LogDet)
    }

    /// Value to minimise: natural logarithm of the condition number, or `-(1/2b) log det (W' Sigma^-1 W / N)` for b columns and N
    /// samples. Infinite when the motion does not excite a parameter.
    pub fn value(self, structure: &Structure, motion: &Motion, sigma: &[f64]) -> f64 {
        let w = structure.regressor(motion);
        let found = conditions(&w, &friction_columns(structure), sigma);
        match self {
            Criterion::Raw => found.raw.ln(),
            Criterion::RawRigid => found.raw_rigid.ln(),
            Criterion::Equilibrated => found.equilibrated.ln(),
            Criterion::Weighted => found.weighted.ln(),
            Criterion::LogDet => {
                let mut w = w;
                let samples = motion.samples();
                for (joint, sigma) in sigma.iter().enumerate() {
                    w.rows_mut(joint * samples, samples).scale_mut(1.0 / (sigma * (samples as f64).sqrt()));
                }
                let columns = w.ncols() as f64;
                let value = singular_values(w).map(|values| -values.map(f64::ln).sum() / columns);
                value.filter(|value| value.is_finite()).unwrap_or(f64::INFINITY)
            }
        }
    }
}

/// Maximum condition number of the column-equilibrated regressor of motions for identification. Torque noise of 1 % leaves an error of
/// 0.01 % after 10 000 samples (10 s at 1 kHz). At a condition number of 1e4 this error is as large as the least-determined combination of
/// parameters. Usual plans have 5 to 20.
pub const MAX_CONDITION: f64 = 1e4;

/// Checks that motions together determine every parameter ([`MAX_CONDITION`]).
///
/// # Errors
/// [`ExciteError::Unexcited`] with the names of undetermined parameters.
pub fn check_excitation(structure: &Structure, motion: &Motion) -> Result<(), ExciteError> {
    let (condition, columns) = dependent_columns(&structure.regressor(motion), MAX_CONDITION);
    // A condition number that is NaN is an error too.
    if condition <= MAX_CONDITION {
        return Ok(());
    }
    let parameters = columns.into_iter().map(|c| structure.columns()[c].name.clone()).collect();
    Err(ExciteError::Unexcited { condition, parameters })
}

/// Samples of one period of a Fourier motion on an even grid, under `gravity` in the base frame \[m/s2\].
pub fn sampled(fourier: &Fourier, gravity: &Vector3<f64>, samples: usize) -> Motion {
    let n = fourier.joints();
    let dt = fourier.period / samples as f64;
    let zeros = || DMatrix::zeros(samples, n);
    let mut motion =
        Motion { dt, q: zeros(), dq: zeros(), ddq: zeros(), gravity: *gravity, periodic: true, start: 0.0 };
    for j in 0..n {
        for k in 0..samples {
            let point = fourier.at(j, k as f64 * dt);
            (motion.q[(k, j)], motion.dq[(k, j)], motion.ddq[(k, j)]) = (point.q, point.dq, point.ddq);
        }
    }
    motion
}

/// Concatenates several motions of one arm in one mounting. Panics when there is none, or when they differ in joints.
pub fn stacked(motions: &[Motion]) -> Motion {
    let rows: usize = motions.iter().map(Motion::samples).sum();
    let join = |of: fn(&Motion) -> &DMatrix<f64>| {
        let mut all = DMatrix::zeros(rows, motions[0].joints());
        let mut first = 0;
        for motion in motions {
            all.rows_mut(first, motion.samples()).copy_from(of(motion));
            first += motion.samples();
        }
        all
    };
    let (q, dq, ddq) = (join(|m| &m.q), join(|m| &m.dq), join(|m| &m.ddq));
    Motion { dt: motions[0].dt, q, dq, ddq, gravity: motions[0].gravity, periodic: motions.len() == 1, start: 0.0 }
}

/// All condition numbers of a motion's stacked base regressor; `sigma` is each joint's torque noise, n \[Nm\].
pub fn evaluate(structure: &Structure, motion: &Motion, sigma: &[f64]) -> Conditions {
    conditions(&structure.regressor(motion), &friction_columns(structure), sigma)
}
