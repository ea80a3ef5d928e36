//! Errors of two models on runs that neither was fitted to, with intervals from a block bootstrap.

use super::lenient;
use nalgebra::DMatrix;
use plumbline_identify::{Experiment, Modelled};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

/// Length of a block \[s\]: longer than torques stay correlated.
const BLOCK_S: f64 = 1.0;
/// Draws.
const DRAW_COUNT: usize = 1000;
/// Seed of the draws.
const SEED: u64 = 0x626c_6f63_6b73;

/// What errors are taken of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Of {
    /// Raw torque samples.
    Raw,
    /// Torques after the estimator's low-pass.
    Filtered,
}

/// What reported errors are taken of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Band {
    /// Raw torque samples, noise and all: as in the paper's Tables IV and V.
    #[default]
    Raw,
    /// Torques and model after the estimator's zero-phase low-pass; of a periodic motion, the mean period.
    Filtered {
        /// Its cut-off \[Hz\].
        cutoff: f64,
    },
}

impl Of {
    /// The same with the low-pass.
    pub fn band(self, cutoff: f64) -> Band {
        match self {
            Of::Raw => Band::Raw,
            Of::Filtered => Band::Filtered { cutoff },
        }
    }
}

/// Errors per joint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// RMS of measured minus predicted torque over the held-out runs, per joint, or a difference of two \[Nm\].
    #[serde(deserialize_with = "lenient::numbers")]
    pub validate_rms: Vec<f64>,
    /// Low and high end of each one's 95 % interval from a block bootstrap \[Nm\]; empty where there is none.
    #[serde(default, deserialize_with = "lenient::intervals", skip_serializing_if = "Vec::is_empty")]
    pub intervals: Vec<[f64; 2]>,
}

/// Errors before, after, and their difference, paired block by block.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Compared {
    /// Of the first model.
    pub before: Errors,
    /// Of the second.
    pub after: Errors,
    /// Second less first.
    pub change: Errors,
    /// Noise of what is compared, per joint; nothing without repeats \[Nm\].
    pub floor: Option<Vec<f64>>,
}

/// One block: squared errors before and after, and samples.
#[derive(Clone, Copy)]
struct Block([f64; 2], f64);

/// Compares two models on unseen runs: each with the torques of the first and of the second along it.
pub fn compare(runs: &[(&Experiment, Modelled, Modelled)], of: Of) -> Option<Compared> {
    let joints = runs.first()?.0.joints();
    let mut blocks: Vec<Vec<Block>> = vec![Vec::new(); joints];
    let mut constant = vec![0.0; joints];
    let mut floors: Vec<Vec<f64>> = Vec::new();
    for (experiment, before, after) in runs {
        let residuals = [before, after].map(|modelled| residual(experiment, modelled, of));
        let samples = experiment.motion.samples();
        let length = ((BLOCK_S / experiment.motion.dt) as usize).clamp(1, samples);
        let resting = experiment.resting();
        for (joint, blocks) in blocks.iter_mut().enumerate() {
            for first in (0..samples).step_by(length) {
                let counted: Vec<usize> = (first..(first + length).min(samples)).filter(|&k| !resting[k]).collect();
                let square = |residual: &DMatrix<f64>| counted.iter().map(|&k| residual[(k, joint)].powi(2)).sum();
                if !counted.is_empty() {
                    blocks.push(Block(residuals.each_ref().map(square), counted.len() as f64));
                }
            }
        }
        if let Some(scatter) = &experiment.scatter {
            let periods = scatter.periods as f64;
            let of_mean = scatter.std_of_mean(|f| experiment.gain(f));
            floors.push(if of == Of::Raw { scatter.std.clone() } else { of_mean });
            if of == Of::Raw {
                for (sum, std) in constant.iter_mut().zip(&scatter.std) {
                    *sum += std * std * (periods - 1.0) / periods / runs.len() as f64;
                }
            }
        }
    }
    let mut rng = ChaCha8Rng::seed_from_u64(SEED);
    let mut compared = Compared::default();
    for (blocks, constant) in blocks.iter().zip(&constant) {
        let rms = |drawn: &mut dyn Iterator<Item = &Block>| {
            let sum = drawn.fold(([0.0; 2], 0.0), |(sum, n), Block(square, count)| {
                ([sum[0] + square[0], sum[1] + square[1]], n + count)
            });
            sum.0.map(|square| (square / f64::max(sum.1, 1.0) + constant).sqrt())
        };
        let [before, after] = rms(&mut blocks.iter());
        let draw = |_| {
            let picks: Vec<&Block> = (0..blocks.len()).map(|_| &blocks[rng.random_range(0..blocks.len())]).collect();
            rms(&mut picks.into_iter())
        };
        let draws: Vec<[f64; 2]> = (0..DRAW_COUNT).map(draw).collect();
        let interval = |of: &dyn Fn(&[f64; 2]) -> f64| {
            let mut values: Vec<f64> = draws.iter().map(of).collect();
            values.sort_by(f64::total_cmp);
            [values[DRAW_COUNT / 40], values[DRAW_COUNT - 1 - DRAW_COUNT / 40]]
        };
        let mut push = |errors: fn(&mut Compared) -> &mut Errors, rms: f64, interval: [f64; 2]| {
            errors(&mut compared).validate_rms.push(rms);
            errors(&mut compared).intervals.push(interval);
        };
        push(|all| &mut all.before, before, interval(&|draw| draw[0]));
        push(|all| &mut all.after, after, interval(&|draw| draw[1]));
        push(|all| &mut all.change, after - before, interval(&|draw| draw[1] - draw[0]));
    }
    if floors.len() == runs.len() {
        let mean = |joint: usize| floors.iter().map(|floor| floor[joint].powi(2)).sum::<f64>() / floors.len() as f64;
        compared.floor = Some((0..joints).map(|joint| mean(joint).sqrt()).collect());
    }
    Some(compared)
}

/// Measured minus modelled torque, N x n.
fn residual(experiment: &Experiment, modelled: &Modelled, of: Of) -> DMatrix<f64> {
    match of {
        Of::Raw => &experiment.tau - modelled.comparison(),
        Of::Filtered => {
            let rest = &experiment.tau - modelled.regression();
            let stacked = DMatrix::from_column_slice(rest.len(), 1, rest.as_slice());
            DMatrix::from_column_slice(rest.nrows(), rest.ncols(), experiment.filter(&stacked).as_slice())
        }
    }
}
