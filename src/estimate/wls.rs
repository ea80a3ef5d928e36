//! Weighted least squares over filtered and decimated experiments, paper eqs. 9 and 10.

use super::EstimateError;
use super::covariance::{Block, sandwich, tapered_autocovariance};
use super::experiment::Experiment;
use super::validate::{Rms, validate_parameters};
use crate::model::conditioning::{Conditions, ZERO_COLUMN, conditions, friction_columns};
use crate::model::structure::Structure;
use crate::model::term::Column;
use nalgebra::{DMatrix, DVector};

/// Directions whose singular value, in equilibrated columns, is below this share of the largest are left undetermined.
const RANK_TOLERANCE: f64 = 1e-7;
/// A parameter is undetermined when more than this share of it lies in undetermined directions.
const UNDETERMINED_SHARE: f64 = 1e-3;
/// Rounds of weights from residuals; the weights settle to a few per cent in the second.
const ROUNDS: usize = 3;
/// A joint's noise is taken as at least this share of its torque, so that exact data has finite weights.
const LEAST_NOISE: f64 = 1e-7;

/// A parameter that the data can't determine.
#[derive(Clone, Debug, PartialEq)]
pub struct Undetermined {
    /// Name of its column.
    pub name: String,
    /// Share of it that lies in undetermined directions: 1 when the data says nothing about it, less when only some combination
    /// with others is unknown.
    pub share: f64,
}

/// Identified parameters and how well they are known.
#[derive(Clone, Debug)]
pub struct Identification {
    /// What the parameters are.
    pub columns: Vec<Column>,
    /// Their values. Undetermined ones have the values of the smallest solution (in equilibrated columns).
    pub beta: Vec<f64>,
    /// Their standard deviations; `None` for undetermined ones.
    pub std: Vec<Option<f64>>,
    /// Covariance of the parameters in the determined directions.
    pub covariance: DMatrix<f64>,
    /// Parameters that this data can't determine.
    pub undetermined: Vec<Undetermined>,
    /// Number of determined directions.
    pub rank: usize,
    /// Condition numbers of the stacked, filtered and decimated regressor, weighted by `sigma`.
    pub conditions: Conditions,
    /// Standard deviation of the filtered torque that weighed each joint, n \[Nm\].
    pub sigma: Vec<f64>,
    /// Equations after decimation.
    pub rows: usize,
    /// Residual and noise of each experiment, by name.
    pub runs: Vec<(String, Rms)>,
    /// The same of all experiments as one.
    pub rms: Rms,
}

impl Identification {
    /// Standard deviation over size of every parameter; `None` for undetermined ones.
    pub fn relative_std(&self) -> Vec<Option<f64>> {
        self.std.iter().zip(&self.beta).map(|(std, beta)| std.map(|std| std / beta.abs())).collect()
    }

    /// Values with their standard deviations, as `TorqueModel::new` takes them.
    pub fn values(&self) -> Vec<(f64, Option<f64>)> {
        self.beta.iter().copied().zip(self.std.iter().copied()).collect()
    }
}

/// Identifies all parameters of a structure from one or more experiments of one arm, each in its own mounting.
///
/// `beta = (W' Sigma^-1 W)^-1 W' Sigma^-1 tau` (paper eq. 10) by QR of the weighted, column-equilibrated regressor; `Sigma` has one
/// variance per joint, taken from the residual of the round before. Every column is computed at the raw rate and filtered as the
/// torque. Errors: experiments of another arm, fewer equations than parameters.
pub fn identify(structure: &Structure, experiments: &[Experiment]) -> Result<Identification, EstimateError> {
    let columns = structure.columns();
    let n = structure.chain().len();
    if let Some(other) = experiments.iter().find(|experiment| experiment.joints() != n) {
        return Err(EstimateError::Joints { run: other.name.clone(), found: other.joints(), expected: n });
    }
    let stack = stack(structure, experiments);
    let rows = stack.w.nrows();
    if rows < columns.len() {
        return Err(EstimateError::TooFewRows { rows, columns: columns.len() });
    }

    // Ordinary least squares first; then every joint weighs as its residual says.
    let m = rows / n;
    let mut sigma = vec![1.0; n];
    let mut solution = solve(&stack, &sigma)?;
    for _ in 0..ROUNDS {
        sigma = residual_std(&stack, &solution, n);
        solution = solve(&stack, &sigma)?;
    }

    let residual = &stack.tau - &stack.w * &solution.beta;
    let freedom = rows as f64 / rows.saturating_sub(solution.rank).max(1) as f64;
    let mut blocks = Vec::with_capacity(n * experiments.len());
    for j in 0..n {
        let mut first = j * m;
        for experiment in experiments {
            blocks.push(noise(experiment, j, first, &residual.as_slice()[first..], freedom));
            first += experiment.kept().len();
        }
    }
    let covariance = sandwich(&solution.projection, &blocks);

    let determined = |c: usize| solution.null_share[c] <= UNDETERMINED_SHARE;
    let beta: Vec<f64> = solution.beta.iter().copied().collect();
    let runs: Vec<(String, Rms)> = experiments
        .iter()
        .map(|experiment| (experiment.name.clone(), validate_parameters(experiment, structure, &beta)))
        .collect();
    let each: Vec<Rms> = runs.iter().map(|(_, rms)| rms.clone()).collect();
    Ok(Identification {
        std: (0..columns.len()).map(|c| determined(c).then(|| covariance[(c, c)].max(0.0).sqrt())).collect(),
        undetermined: (0..columns.len())
            .filter(|&c| !determined(c))
            .map(|c| Undetermined { name: columns[c].name.clone(), share: solution.null_share[c] })
            .collect(),
        columns: columns.to_vec(),
        beta,
        covariance,
        rank: solution.rank,
        conditions: conditions(&stack.w, &friction_columns(structure), &sigma),
        sigma,
        rows,
        rms: Rms::pooled(&each).ok_or(EstimateError::TooFewRows { rows, columns: columns.len() })?,
        runs,
    })
}

/// `tau = W beta` of all experiments: joint by joint, and within a joint experiment by experiment.
struct Stack {
    w: DMatrix<f64>,
    tau: DVector<f64>,
}

fn stack(structure: &Structure, experiments: &[Experiment]) -> Stack {
    let n = structure.chain().len();
    let m: usize = experiments.iter().map(|experiment| experiment.kept().len()).sum();
    let mut w = DMatrix::zeros(n * m, structure.columns().len());
    let mut tau = DVector::zeros(n * m);
    let mut before = 0;
    for experiment in experiments {
        let count = experiment.kept().len();
        let y = experiment.band(&structure.regressor(&experiment.motion));
        let measured = experiment.band(&experiment.stacked_tau());
        for j in 0..n {
            w.rows_mut(j * m + before, count).copy_from(&y.rows(j * count, count));
            tau.rows_mut(j * m + before, count).copy_from(&measured.rows(j * count, count));
        }
        before += count;
    }
    Stack { w, tau }
}

struct Solution {
    beta: DVector<f64>,
    /// `beta = projection * tau`, p x rows.
    projection: DMatrix<f64>,
    rank: usize,
    /// Share of each parameter in the directions left undetermined.
    null_share: Vec<f64>,
}

fn solve(stack: &Stack, sigma: &[f64]) -> Result<Solution, EstimateError> {
    let (rows, p) = stack.w.shape();
    let m = rows / sigma.len();
    let mut w = stack.w.clone();
    for (j, sigma) in sigma.iter().enumerate() {
        w.rows_mut(j * m, m).scale_mut(1.0 / sigma);
    }

    // Equilibrate: the rank must not depend on the parameters' units.
    let norms: Vec<f64> = w.column_iter().map(|column| column.norm()).collect();
    let largest = norms.iter().copied().fold(0.0, f64::max);
    let scales: Vec<f64> =
        norms.iter().map(|&norm| if norm > ZERO_COLUMN * largest { 1.0 / norm } else { 0.0 }).collect();
    for (mut column, scale) in w.column_iter_mut().zip(&scales) {
        column *= *scale;
    }

    let failed = EstimateError::Decomposition { rows, columns: p };
    let qr = w.qr();
    let q = qr.q();
    let svd = qr.r().try_svd(true, true, f64::EPSILON, 0).ok_or(failed.clone())?;
    let (Some(u), Some(v_t)) = (&svd.u, &svd.v_t) else { return Err(failed) };
    let s_max = svd.singular_values.max();
    if !s_max.is_finite() {
        return Err(failed);
    }

    let mut inverse = DMatrix::zeros(p, p);
    let mut null_share = vec![0.0; p];
    let mut rank = 0;
    for (i, &s) in svd.singular_values.iter().enumerate() {
        if s > RANK_TOLERANCE * s_max && s > 0.0 {
            inverse += v_t.row(i).transpose() * u.column(i).transpose() / s;
            rank += 1;
        } else {
            for (c, share) in null_share.iter_mut().enumerate() {
                *share += v_t[(i, c)].powi(2);
            }
        }
    }
    let mut projection = inverse * q.transpose();
    for (mut row, scale) in projection.row_iter_mut().zip(&scales) {
        row *= *scale;
    }
    for (j, sigma) in sigma.iter().enumerate() {
        projection.columns_mut(j * m, m).scale_mut(1.0 / sigma);
    }
    Ok(Solution { beta: &projection * &stack.tau, projection, rank, null_share })
}

/// Standard deviation of each joint's residual, for the degrees of freedom that are left.
fn residual_std(stack: &Stack, solution: &Solution, n: usize) -> Vec<f64> {
    let rows = stack.tau.len();
    let m = rows / n;
    let residual = &stack.tau - &stack.w * &solution.beta;
    let freedom = rows as f64 / rows.saturating_sub(solution.rank).max(1) as f64;
    let rms = |x: &DVector<f64>, j: usize| (x.rows(j * m, m).norm_squared() / m as f64).sqrt();
    let largest = (0..n).map(|j| rms(&stack.tau, j)).fold(f64::MIN_POSITIVE.sqrt(), f64::max);
    (0..n)
        .map(|j| {
            let torque = rms(&stack.tau, j).max(LEAST_NOISE * largest);
            (rms(&residual, j) * freedom.sqrt()).max(LEAST_NOISE * torque)
        })
        .collect()
}

/// Noise of one joint's filtered torque in one experiment: from the scatter between periods, else from the residual
/// (`residual` starts at the block's first row).
fn noise(experiment: &Experiment, joint: usize, first: usize, residual: &[f64], freedom: f64) -> Block {
    let kept = experiment.kept();
    match &experiment.scatter {
        Some(scatter) => Block {
            first,
            at: kept.to_vec(),
            autocovariance: scatter.autocovariance_of_mean(joint, |f| experiment.gain(f)),
        },
        None => Block {
            first,
            at: (0..kept.len()).collect(),
            autocovariance: tapered_autocovariance(&residual[..kept.len()], freedom),
        },
    }
}
