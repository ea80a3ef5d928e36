//! The body on the last link, from a short motion against a stored model.
//!
//!   tau = Y_m (beta + L z) + Y_p pi,   z ~ N(0, 1),   L L' = C
//!
//! `beta` and `C` are the stored parameters and their covariance, `pi` the ten standard parameters of the body about the last link's frame. Errors of the
//! stored model are estimated with the body, so that its standard deviations contain them. Rows are weighted by the noise of their joint. The
//! covariance is that of coloured noise (Newey and West 1987).

use crate::covariance::newey_west;
use crate::experiment::Experiment;
use crate::prediction::TorqueUncertainty;
use crate::solve::stack::Stack;
use crate::{EstimateError, Spread};
use nalgebra::{DMatrix, DVector};
use plumbline_core::{singular_values, symmetric_eigen};
use plumbline_model::term::Motion;
use plumbline_model::term::effect::{Site, Spec};
use plumbline_model::{LINK_COLUMNS, ModelError, Structure, TorqueModel};

/// Directions of the stored covariance below this ratio of the largest are exact.
const EXACT_RATIO: f64 = 1e-14;
/// Smallest ratio of the singular values of the body's equilibrated columns at which a motion determines the body.
const MIN_DETERMINED_RATIO: f64 = 1e-4;
/// Estimates with weights of the one before.
const ITERATIONS: usize = 3;
/// Smallest ratio of a joint's noise to its torque.
const MIN_NOISE_RATIO: f64 = 1e-6;

/// A body on the last link.
#[derive(Clone, Debug)]
pub struct Found {
    /// `Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m` about the last link's frame.
    pub values: [f64; LINK_COLUMNS],
    /// Their covariance.
    pub spread: Spread,
    /// RMS of measured less modelled torque behind the low-pass, without and with the body, per joint \[Nm\].
    pub rms: [Vec<f64>; 2],
    /// The stored model with the body as a term.
    pub model: TorqueModel,
}

/// Why no body was found.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum PayloadError {
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Estimate(#[from] EstimateError),
    #[error(
        "the motion does not determine the body: of its ten parameters' directions the weakest has {ratio:.1e} of the largest; turn the wrist further"
    )]
    Undetermined { ratio: f64 },
    #[error("the model has a body on its last link already; use the model without it")]
    HasBody,
    #[error("the equations have no solution (are all samples finite?)")]
    Singular,
}

/// The structure of a model with a body on its last link, whose ten columns are the last.
///
/// # Errors
/// A model that has one already.
pub fn with_body(model: &TorqueModel) -> Result<Structure, PayloadError> {
    let has_one = |spec: Spec| spec.is_on_last_link();
    if model.structure().terms().iter().filter_map(|term| term.spec()).any(has_one) {
        return Err(PayloadError::HasBody);
    }
    let spec = Spec { family: "payload", form: "", site: Site::Arm, settings: Vec::new() };
    let unknown = |_| ModelError::UnknownTerm { id: spec.family.into() };
    let term = spec.build(&model.structure().operating_point(&model.beta())).map_err(unknown)?;
    Ok(model.structure().clone().with(vec![term])?)
}

/// Smallest over largest singular value of the body's columns along a motion, each divided by its norm, joints weighted by `sigma` \[Nm\].
pub fn determined(structure: &Structure, motion: &Motion, sigma: &[f64]) -> f64 {
    let y = structure.regressor(motion);
    let (samples, first) = (motion.samples(), y.ncols() - LINK_COLUMNS);
    let mut y = y.columns(first, LINK_COLUMNS).into_owned();
    for (j, sigma) in sigma.iter().enumerate() {
        y.rows_mut(j * samples, samples).scale_mut(1.0 / sigma);
    }
    ratio(y)
}

fn ratio(mut y: DMatrix<f64>) -> f64 {
    for mut column in y.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column.scale_mut(1.0 / norm);
        }
    }
    singular_values(y.tr_mul(&y)).map_or(0.0, |values| (values.min().max(0.0) / values.max()).sqrt())
}

/// Finds the body. Without `uncertainty` the stored parameters are taken as exact.
///
/// # Errors
/// A model with a body already, a motion that does not determine one, experiments of another arm.
pub fn find(
    model: &TorqueModel,
    uncertainty: Option<&TorqueUncertainty>,
    experiments: &[Experiment],
) -> Result<Found, PayloadError> {
    let structure = with_body(model)?;
    let stack = Stack::of(&structure, experiments)?;
    let (n, m) = (stack.joints, stack.per_joint());
    let stored = model.beta();
    let p = stored.len();
    let residual = &stack.tau - stack.w.columns(0, p) * DVector::from_vec(stored);
    let roots = uncertainty.map_or(Some(DMatrix::zeros(p, 0)), |known| root(&known.parameters.covariance));
    let roots = roots.ok_or(PayloadError::Singular)?;
    let free = roots.ncols();
    let mut a = DMatrix::zeros(n * m, free + LINK_COLUMNS);
    a.columns_mut(0, free).copy_from(&(stack.w.columns(0, p) * &roots));
    a.columns_mut(free, LINK_COLUMNS).copy_from(&stack.w.columns(p, LINK_COLUMNS));

    let largest = residual.amax();
    let noise = |rest: &DVector<f64>| -> Vec<f64> {
        (0..n)
            .map(|j| (rest.rows(j * m, m).norm() / (m as f64).sqrt()).max(MIN_NOISE_RATIO * largest).max(1e-12))
            .collect()
    };
    let mut sigma = noise(&residual);
    let (mut x, mut map) = (DVector::zeros(free + LINK_COLUMNS), DMatrix::zeros(0, 0));
    let mut prior = DMatrix::zeros(free + LINK_COLUMNS, free + LINK_COLUMNS);
    (0..free).for_each(|c| prior[(c, c)] = 1.0);
    let mut inverse = DMatrix::zeros(0, 0);
    for iteration in 0..ITERATIONS {
        let mut weighed = a.clone();
        for (j, sigma) in sigma.iter().enumerate() {
            weighed.rows_mut(j * m, m).scale_mut(1.0 / sigma);
        }
        let ratio = ratio(weighed.columns(free, LINK_COLUMNS).into_owned());
        if iteration == 0 && (ratio.is_nan() || ratio <= MIN_DETERMINED_RATIO) {
            return Err(PayloadError::Undetermined { ratio });
        }
        // Columns of one size: moments of inertia are small numbers.
        let scale: Vec<f64> = weighed.column_iter().map(|column| column.norm().max(1e-300)).collect();
        let unit = DMatrix::from_fn(scale.len(), scale.len(), |c, d| if c == d { 1.0 / scale[c] } else { 0.0 });
        let information = weighed.tr_mul(&weighed) + &prior;
        let solved = (&unit * information * &unit).cholesky().ok_or(PayloadError::Singular)?.inverse();
        inverse = &unit * solved * &unit;
        // x = inverse A' S^-1 residual.
        map = &inverse * weighed.transpose();
        for (j, sigma) in sigma.iter().enumerate() {
            map.columns_mut(j * m, m).scale_mut(1.0 / sigma);
        }
        x = &map * &residual;
        sigma = noise(&(&residual - &a * &x));
    }
    let rest = &residual - &a * &x;
    let spread = newey_west(&map, rest.as_slice(), m);
    // What the prior contributes: the error of the stored parameters.
    let covariance = spread.covariance + &inverse * prior * &inverse;
    let block = |of: &DMatrix<f64>| of.view((free, free), (LINK_COLUMNS, LINK_COLUMNS)).into_owned();
    let freedom = spread.freedom[free..].to_vec();
    let body: Vec<f64> = x.rows(free, LINK_COLUMNS).iter().copied().collect();
    let spread = Spread { covariance: block(&covariance), freedom };
    let values: [f64; LINK_COLUMNS] = std::array::from_fn(|k| body[k]);
    let known = model.parameters().iter().map(|parameter| (parameter.value, parameter.std));
    let own = (0..LINK_COLUMNS).map(|k| (values[k], Some(spread.covariance[(k, k)].max(0.0).sqrt())));
    let of_model =
        TorqueModel::new(model.robot(), structure, model.mountings().to_vec(), &known.chain(own).collect::<Vec<_>>())?;
    let rms = |of: &DVector<f64>| (0..n).map(|j| of.rows(j * m, m).norm() / (m as f64).sqrt()).collect();
    // Without the correction of the stored parameters, which the written model does not have.
    let with_body = &residual - a.columns(free, LINK_COLUMNS) * DVector::from_vec(body);
    Ok(Found { values, spread, rms: [rms(&residual), rms(&with_body)], model: of_model })
}

/// `L` with `L L' = covariance`, without columns of zero.
fn root(covariance: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    // Correlations: the parameters' units differ.
    let scale: Vec<f64> = covariance.diagonal().iter().map(|variance| variance.max(0.0).sqrt()).collect();
    let correlation = DMatrix::from_fn(scale.len(), scale.len(), |c, d| match scale[c] * scale[d] {
        0.0 => 0.0,
        size => covariance[(c, d)] / size,
    });
    let eigen = symmetric_eigen(correlation)?;
    let largest = eigen.eigenvalues.iter().copied().fold(0.0, f64::max);
    let kept: Vec<usize> = (0..scale.len()).filter(|&i| eigen.eigenvalues[i] > EXACT_RATIO * largest).collect();
    Some(DMatrix::from_fn(scale.len(), kept.len(), |c, k| {
        scale[c] * eigen.eigenvectors[(c, kept[k])] * eigen.eigenvalues[kept[k]].sqrt()
    }))
}
