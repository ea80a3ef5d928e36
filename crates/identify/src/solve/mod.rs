//! Estimators of the parameters from filtered equations, one per file, with a common result type.
//!
//! | estimator | minimises | for |
//! |---|---|---|
//! | [`ols`] | squared errors, equally weighted | comparison |
//! | [`wls`] | squared errors weighted by each joint's noise, by frequency where periods repeat ([`coloured`]), or by the covariance between joints | default |
//! | [`huber`] | squared errors below a threshold, absolute errors above | torques with outliers: contacts |
//! | [`tls`] | errors in torques and positions | noisy positions, known noise |
//! | [`iv`] | correlation of errors with instruments | noisy positions, unknown noise |
//!
//! Standard deviations are valid for coloured noise ([`super::covariance`]).

pub mod coloured;
mod equations;
pub mod gains;
pub mod huber;
pub mod iv;
pub mod linear;
pub mod noise;
pub mod ols;
pub(crate) mod solved;
pub mod stack;
pub mod tls;
pub mod wls;

use super::EstimateError;
use super::essential::Dropped;
use super::experiment::Experiment;
use super::validate::{Rms, validate_parameters};
pub use equations::Equations;
use linear::{Weights, deviations, residual_covariance};
use nalgebra::DMatrix;
use plumbline_core::{parallel, threads};
use plumbline_model::term::Column;
use plumbline_model::{Conditions, Structure, conditions, friction_columns};
use serde::{Deserialize, Serialize};
pub use solved::Outcome;
use solved::Solved;
use stack::Stack;
use statrs::distribution::{ContinuousCDF, Normal, StudentsT};

/// Estimator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Estimator {
    /// Ordinary least squares.
    Ols,
    /// Weighted least squares, one variance per joint (paper eqs. 9 and 10).
    #[default]
    Wls,
    /// Weighted least squares with the full covariance between the joints.
    WlsFull,
    /// Huber's robust estimator.
    Huber,
    /// Total least squares.
    Tls,
    /// Instrumental variables.
    Iv,
}

impl Estimator {
    /// Every estimator.
    pub const ALL: [Estimator; 6] =
        [Estimator::Ols, Estimator::Wls, Estimator::WlsFull, Estimator::Huber, Estimator::Tls, Estimator::Iv];

    /// Its name on the command line and in files.
    pub fn id(self) -> &'static str {
        match self {
            Estimator::Ols => "ols",
            Estimator::Wls => "wls",
            Estimator::WlsFull => "wls-full",
            Estimator::Huber => "huber",
            Estimator::Tls => "tls",
            Estimator::Iv => "iv",
        }
    }

    /// The estimator of that name.
    pub fn by_id(id: &str) -> Option<Estimator> {
        Estimator::ALL.into_iter().find(|estimator| estimator.id() == id)
    }

    /// Whether it needs every period's deviation from the mean (`Settings::keep_periods`).
    pub fn needs_periods(self) -> bool {
        matches!(self, Estimator::Tls | Estimator::Iv)
    }
}

/// Options of an identification.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Options {
    /// The estimator.
    pub estimator: Estimator,
    /// Whether insignificant parameters are eliminated, [`crate::essential`].
    pub essential: bool,
}

/// Parameter that the data does not determine.
#[derive(Clone, Debug, PartialEq)]
pub struct Undetermined {
    /// Name of its column.
    pub name: String,
    /// Share in undetermined directions: 1 when the data contains no information on it, less when only a combination
    /// with others is undetermined.
    pub share: f64,
}

/// Identified parameters with their uncertainty.
#[derive(Clone, Debug)]
pub struct Identification {
    /// Estimator used.
    pub estimator: Estimator,
    /// Outcome of its iteration.
    pub outcome: Outcome,
    /// Rounds of weights; 1 without iteration.
    pub rounds: usize,
    /// Columns of the parameters.
    pub columns: Vec<Column>,
    /// Parameter values. Undetermined ones are those of the minimum-norm solution (in equilibrated columns), eliminated ones are zero.
    pub beta: Vec<f64>,
    /// Standard deviations; `None` for undetermined and eliminated ones.
    pub std: Vec<Option<f64>>,
    /// Covariance of the parameters in the determined directions.
    pub covariance: DMatrix<f64>,
    /// Degrees of freedom of each standard deviation: a confidence interval is the quantile of Student's t distribution
    /// times the standard deviation.
    pub freedom: Vec<f64>,
    /// Parameters that this data does not determine.
    pub undetermined: Vec<Undetermined>,
    /// Eliminated insignificant parameters, in the order of elimination.
    pub dropped: Vec<Dropped>,
    /// Number of determined directions.
    pub rank: usize,
    /// Condition numbers of the stacked, filtered and decimated regressor, weighted by `sigma`.
    pub conditions: Conditions,
    /// Standard deviation of the filtered torque of each joint, n \[Nm\], used as weight where the estimator has weights.
    pub sigma: Vec<f64>,
    /// Weight of each equation of a robust estimator, 0 to 1.
    pub row_weights: Option<Vec<f64>>,
    /// Equations after decimation.
    pub rows: usize,
    /// RMS residual and noise floor of each experiment, by name.
    pub runs: Vec<(String, Rms)>,
    /// Pooled RMS of all experiments.
    pub rms: Rms,
}

impl Identification {
    /// Standard deviation divided by the absolute value of every parameter; `None` for undetermined and eliminated ones.
    pub fn relative_std(&self) -> Vec<Option<f64>> {
        self.std.iter().zip(&self.beta).map(|(std, beta)| std.map(|std| std / beta.abs())).collect()
    }

    /// Half the width of each parameter's 95 % confidence interval; `None` for undetermined and eliminated ones.
    pub fn interval_95(&self) -> Vec<Option<f64>> {
        self.std.iter().zip(&self.freedom).map(|(std, &freedom)| std.map(|std| student_975(freedom) * std)).collect()
    }

    /// With more columns at the end of its structure, whose `k` parameters were estimated afterwards with all others held: their covariance is
    /// k x k, and they have none with the others.
    ///
    /// # Errors
    /// [`EstimateError::TooFewRows`] without experiments.
    pub fn extended(
        &self,
        structure: &Structure,
        experiments: &[Experiment],
        beta: &[f64],
        covariance: &DMatrix<f64>,
        freedom: f64,
    ) -> Result<Identification, EstimateError> {
        let (before, columns) = (self.columns.len(), structure.columns().to_vec());
        let mut all = self.clone();
        all.beta.extend(beta);
        all.std.extend(covariance.diagonal().iter().map(|variance| Some(variance.max(0.0).sqrt())));
        all.freedom.resize(columns.len(), freedom);
        all.covariance = all.covariance.resize(columns.len(), columns.len(), 0.0);
        all.covariance.view_mut((before, before), covariance.shape()).copy_from(covariance);
        all.rank += beta.len();
        let each = parallel(experiments, threads(), |experiment| validate_parameters(experiment, structure, &all.beta));
        all.rms = Rms::pooled(&each).ok_or(EstimateError::TooFewRows { rows: self.rows, columns: columns.len() })?;
        all.runs = self.runs.iter().map(|(name, _)| name.clone()).zip(each).collect();
        Ok(Identification { columns, ..all })
    }

    /// Values with their standard deviations, as input of `TorqueModel::new`.
    pub fn values(&self) -> Vec<(f64, Option<f64>)> {
        self.beta.iter().copied().zip(self.std.iter().copied()).collect()
    }
}

/// Identifies all parameters of a structure by weighted least squares, from one or more experiments of one arm, each in its own mounting.
///
/// # Errors
/// As [`identify_with`].
pub fn identify(structure: &Structure, experiments: &[Experiment]) -> Result<Identification, EstimateError> {
    identify_with(structure, experiments, &Options::default())
}

/// Identifies the parameters of a structure with a given estimator.
///
/// # Errors
/// Experiments of another arm; fewer equations than parameters; for instrumental variables, an experiment that has neither two
/// periods nor a desired motion.
pub fn identify_with(
    structure: &Structure,
    experiments: &[Experiment],
    options: &Options,
) -> Result<Identification, EstimateError> {
    Equations::of(structure.clone(), experiments)?.identify(options)
}

/// One estimator with the noise data of its experiments.
struct Solver<'a> {
    structure: &'a Structure,
    experiments: &'a [Experiment],
    estimator: Estimator,
    draws: Option<noise::Draws>,
    pairs: Vec<iv::Pair>,
    coloured: Option<coloured::Noise>,
}

impl<'a> Solver<'a> {
    fn new(
        structure: &'a Structure,
        experiments: &'a [Experiment],
        estimator: Estimator,
    ) -> Result<Solver<'a>, EstimateError> {
        let draws = (estimator == Estimator::Tls).then(|| noise::Draws::of(structure, experiments));
        let pairs = match estimator {
            Estimator::Iv => noise::instruments(structure, experiments)?,
            _ => Vec::new(),
        };
        let coloured = coloured::Noise::of(experiments).filter(|_| estimator == Estimator::Wls);
        Ok(Solver { structure, experiments, estimator, draws, pairs, coloured })
    }

    fn solve(&self, stack: &Stack, kept: &[usize]) -> Result<Solved, EstimateError> {
        let experiments = self.experiments;
        if self.estimator == Estimator::Ols {
            let fit = ols::solve(stack)?;
            let sigma = deviations(&residual_covariance(stack, &fit));
            let spread = noise::of_torques(stack, experiments, &fit);
            return Ok(Solved { fit, spread, sigma, row_weights: None, rounds: 1, outcome: Outcome::Settled });
        }
        if self.estimator == Estimator::Huber {
            let robust = huber::solve(stack)?;
            let spread = noise::of_influences(stack, experiments, &robust.fit, &robust.influence, &robust.weights);
            let (row_weights, outcome) = (Some(robust.weights), outcome(robust.converged));
            return Ok(Solved {
                fit: robust.fit,
                spread,
                sigma: robust.sigma,
                row_weights,
                rounds: robust.rounds,
                outcome,
            });
        }
        // The others need the joints' noise, which weighted least squares estimates.
        let weighed = wls::solve(stack, self.estimator == Estimator::WlsFull, self.coloured.as_ref())?;
        let sigma = deviations(&weighed.sigma);
        let weights = Weights::per_joint(&sigma);
        let outcome = outcome(weighed.converged);
        let rounds = weighed.rounds;
        let (fit, spread) = if let Some(draws) = &self.draws {
            let errors = draws.columns(kept).errors(stack, experiments, &weighed);
            let fit = tls::solve(stack, &errors, &weights)?;
            let spread = noise::of_all(self.structure, stack, experiments, kept, &fit);
            (fit, spread)
        } else if self.estimator == Estimator::Iv {
            let pairs: Vec<iv::Pair> = self.pairs.iter().map(|pair| pair.columns(kept)).collect();
            let fit = iv::solve(stack, &pairs, &weights)?;
            let spread = noise::of_all(self.structure, stack, experiments, kept, &fit);
            (fit, spread)
        } else {
            let spread = noise::of_torques(stack, experiments, &weighed.fit);
            (weighed.fit, spread)
        };
        Ok(Solved { fit, spread, sigma, row_weights: None, rounds, outcome })
    }
}

/// Degrees of freedom above which a two-term expansion about the normal distribution is used, exact to 3e-6. The iteration for Student's
/// distribution does not converge for large values.
const ALMOST_NORMAL_FREEDOM: f64 = 1000.0;

/// 97.5 % quantile of Student's t distribution with `freedom` degrees of freedom, not necessarily an integer.
pub fn student_975(freedom: f64) -> f64 {
    if freedom > ALMOST_NORMAL_FREEDOM {
        let z = Normal::standard().inverse_cdf(0.975);
        return z + (z.powi(3) + z) / (4.0 * freedom);
    }
    StudentsT::new(0.0, 1.0, freedom).map_or(f64::NAN, |distribution| distribution.inverse_cdf(0.975))
}

fn outcome(converged: bool) -> Outcome {
    if converged { Outcome::Settled } else { Outcome::Unconverged }
}

/// The identification in the order of the structure's columns; parameters not in `kept` are zero.
fn finish(
    structure: &Structure,
    experiments: &[Experiment],
    estimator: Estimator,
    stack: &Stack,
    solved: Solved,
    kept: &[usize],
    dropped: Vec<Dropped>,
) -> Result<Identification, EstimateError> {
    let columns = structure.columns();
    let (p, rows) = (columns.len(), stack.tau.len());
    let mut beta = vec![0.0; p];
    let mut std = vec![None; p];
    let mut freedom = vec![f64::INFINITY; p];
    let mut covariance = DMatrix::zeros(p, p);
    let mut undetermined = Vec::new();
    for (own, &c) in kept.iter().enumerate() {
        beta[c] = solved.fit.beta[own];
        freedom[c] = solved.spread.freedom[own];
        for (other, &d) in kept.iter().enumerate() {
            covariance[(c, d)] = solved.spread.covariance[(own, other)];
        }
        if solved.determined(own) {
            std[c] = Some(covariance[(c, c)].max(0.0).sqrt());
        } else {
            undetermined.push(Undetermined { name: columns[c].name.clone(), share: solved.fit.null_share[own] });
        }
    }
    let each = parallel(experiments, threads(), |experiment| validate_parameters(experiment, structure, &beta));
    let names = experiments.iter().map(|experiment| experiment.name.clone());
    let runs: Vec<(String, Rms)> = names.zip(each.iter().cloned()).collect();
    Ok(Identification {
        estimator,
        outcome: solved.outcome,
        rounds: solved.rounds,
        columns: columns.to_vec(),
        beta,
        std,
        covariance,
        freedom,
        undetermined,
        dropped,
        rank: solved.fit.rank,
        conditions: conditions(&stack.w, &friction_columns(structure), &solved.sigma),
        sigma: solved.sigma,
        row_weights: solved.row_weights,
        rows,
        rms: Rms::pooled(&each).ok_or(EstimateError::TooFewRows { rows, columns: p })?,
        runs,
    })
}

#[cfg(test)]
mod tests {
    use super::{Estimator, student_975};

    #[test]
    fn student_quantiles_agree_with_the_tables() {
        for (freedom, table) in [(5.0, 2.5706), (9.0, 2.2622), (30.0, 2.0423), (1e9, 1.95996), (f64::INFINITY, 1.95996)]
        {
            assert!((student_975(freedom) / table - 1.0).abs() < 1e-4, "{freedom}: {}", student_975(freedom));
        }
    }

    #[test]
    fn every_estimator_is_found_by_its_name() {
        for estimator in Estimator::ALL {
            assert_eq!(Estimator::by_id(estimator.id()), Some(estimator));
        }
        assert_eq!(Estimator::by_id("magic"), None);
    }
}
