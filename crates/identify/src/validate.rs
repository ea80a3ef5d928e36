//! Torque errors of a model.

use super::experiment::Experiment;
use nalgebra::DMatrix;
use plumbline_model::Structure;
use plumbline_model::term::Motion;

/// Root mean square of measured minus modelled torque, per joint \[Nm\].
#[derive(Clone, Debug, PartialEq)]
pub struct Rms {
    /// Of the raw torque samples, as in the paper's Tables IV and V. The model is evaluated at the measured motion (filtered, the
    /// mean period of a periodic run); every sample of every period is used.
    pub raw: Vec<f64>,
    /// After the estimator's low-pass; of the mean period of a periodic run.
    pub filtered: Vec<f64>,
    /// Noise floor of `raw`: standard deviation of one raw torque sample between the periods. `None` without repeats.
    pub noise_floor: Option<Vec<f64>>,
    /// Noise floor of `filtered`: standard deviation of the mean period after the low-pass. `None` without repeats.
    pub filtered_noise_floor: Option<Vec<f64>>,
    /// Number of samples used, per joint.
    pub samples: usize,
}

impl Rms {
    /// Pooled RMS of several runs, weighted by their samples. `None` when there is none.
    pub fn pooled(runs: &[Rms]) -> Option<Rms> {
        let first = runs.first()?;
        let joints = first.raw.len();
        let pool = |of: &dyn Fn(&Rms) -> Option<Vec<f64>>| -> Option<Vec<f64>> {
            let known: Vec<(f64, Vec<f64>)> =
                runs.iter().filter_map(|run| Some((run.samples as f64, of(run)?))).collect();
            let total: f64 = known.iter().map(|(weight, _)| weight).sum();
            let square = |j: usize| known.iter().map(|(weight, values)| weight * values[j] * values[j]).sum::<f64>();
            (!known.is_empty()).then(|| (0..joints).map(|j| (square(j) / total).sqrt()).collect())
        };
        Some(Rms {
            raw: pool(&|run| Some(run.raw.clone()))?,
            filtered: pool(&|run| Some(run.filtered.clone()))?,
            noise_floor: pool(&|run| run.noise_floor.clone()),
            filtered_noise_floor: pool(&|run| run.filtered_noise_floor.clone()),
            samples: runs.iter().map(|run| run.samples).sum(),
        })
    }
}

/// Torques of a model along an experiment's motions in the experiment's mounting.
pub struct Modelled {
    /// Along the motion of the regression, N x n \[Nm\].
    along_regression: DMatrix<f64>,
    /// Along [`Experiment::comparison_motion`], where given, N x n \[Nm\].
    along_comparison: Option<DMatrix<f64>>,
}

impl Modelled {
    /// Evaluates `predict`, the torques along a motion, N x n \[Nm\].
    pub fn of(experiment: &Experiment, predict: impl Fn(&Motion) -> DMatrix<f64>) -> Modelled {
        let along_comparison = experiment.comparison_motion.as_ref().map(&predict);
        Modelled { along_regression: predict(&experiment.motion), along_comparison }
    }

    /// Torques along the motion of the regression, to compare with filtered torques, N x n \[Nm\].
    pub fn regression(&self) -> &DMatrix<f64> {
        &self.along_regression
    }

    /// Torques along the comparison motion, to compare with raw torques, N x n \[Nm\].
    pub fn comparison(&self) -> &DMatrix<f64> {
        self.along_comparison.as_ref().unwrap_or(&self.along_regression)
    }
}

/// Torque errors of any model on an experiment. `predict` gives the torques along a motion, N x n \[Nm\].
pub fn validate(experiment: &Experiment, predict: impl Fn(&Motion) -> DMatrix<f64>) -> Rms {
    compare(experiment, &Modelled::of(experiment, predict))
}

/// Torque errors of modelled torques on an experiment.
///
/// Raw torques are compared along [`Experiment::comparison_motion`], whose accelerations have less noise; filtered ones along the motion of the
/// regression, whose noise the filter removes.
pub fn compare(experiment: &Experiment, modelled: &Modelled) -> Rms {
    let of_filtered = &experiment.tau - &modelled.along_regression;
    let residual = &experiment.tau - modelled.comparison();
    let (n, samples) = (experiment.joints(), experiment.motion.samples());
    let resting = experiment.resting();
    let counted = resting.iter().filter(|resting| !**resting).count().max(1);
    let mean_square = |block: &[f64]| {
        block.iter().zip(resting).filter(|(_, resting)| !**resting).map(|(x, _)| x * x).sum::<f64>() / counted as f64
    };
    let scatter = experiment.scatter.as_ref();
    let raw = (0..n)
        .map(|j| {
            let of_mean = mean_square(&residual.as_slice()[j * samples..(j + 1) * samples]);
            // Every sample is the mean plus its deviation: the squares add up.
            let of_deviations = scatter.map_or(0.0, |s| s.std[j].powi(2) * (s.periods - 1) as f64 / s.periods as f64);
            (of_mean + of_deviations).sqrt()
        })
        .collect();
    let stacked = DMatrix::from_column_slice(of_filtered.len(), 1, of_filtered.as_slice());
    let band = experiment.filter(&stacked);
    let filtered = band.as_slice().chunks(samples).map(|block| mean_square(block).sqrt()).collect();
    Rms {
        raw,
        filtered,
        noise_floor: scatter.map(|scatter| scatter.std.clone()),
        filtered_noise_floor: scatter.map(|scatter| scatter.std_of_mean(|f| experiment.gain(f))),
        samples: (counted as f64 * experiment.averaged_periods()).round() as usize,
    }
}

/// [`validate`] for a structure and its parameters.
pub fn validate_parameters(experiment: &Experiment, structure: &Structure, beta: &[f64]) -> Rms {
    validate(experiment, |motion| structure.torques(beta, motion))
}
