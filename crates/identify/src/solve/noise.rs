//! Noise of the experiments, and its effect on the parameters.

use super::iv::Pair;
use super::linear::{Fit, Weights, deviations, freedom};
use super::stack::{Stack, regressor};
use super::wls::Weighed;
use crate::EstimateError;
use crate::covariance::{Spread, between_periods, newey_west};
use crate::experiment::{Experiment, Repeats};
use crate::periods::NoiseOfMean;
use crate::signal::spectral::Spectral;
use nalgebra::{DMatrix, DVector};
use plumbline_core::transposed_product;
use plumbline_model::Structure;
use plumbline_model::term::Motion;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};

/// Random draws of the position noise where there are no repeated periods.
const DRAWS: usize = 8;
/// Minimum ratio of torque noise to the residual's variance.
const MIN_TORQUE_NOISE_RATIO: f64 = 0.01;
const MAX_LEVERAGE: f64 = 0.95;
/// Probability that the noise of a mean period alone is taken for something that every period repeats.
const BY_CHANCE: f64 = 0.05;
/// Frequencies up to this ratio, and some more, are the neighbours of one whose power is a mean over them.
const NEIGHBOURHOOD_RATIO: f64 = 1.2;
const NEIGHBOURS: f64 = 4.0;

/// Covariance of the parameters from the noise of the torques: from the scatter between periods and from what every period repeats beyond it, else from the residual.
pub fn of_torques(stack: &Stack, experiments: &[Experiment], fit: &Fit) -> Spread {
    let residual = stack.residual(&fit.beta);
    let each = experiments.iter().enumerate().map(|(index, experiment)| match &experiment.noise {
        Some(noise) => of_mean(stack, fit, &residual, index, experiment.kept(), noise),
        None => from_residual(stack, fit, &residual, index),
    });
    each.fold(Spread::zero(fit.beta.len()), |sum, one| sum.plus(&one))
}

/// Covariance of a robust estimate's parameters from its `influences`, the residuals times their `weights`. With repeated periods,
/// the scatter gives the spectrum of the noise and the influences its size: a contact in one period has a large scatter and little influence.
pub fn of_influences(
    stack: &Stack,
    experiments: &[Experiment],
    fit: &Fit,
    influences: &DVector<f64>,
    weights: &[f64],
) -> Spread {
    let weighed = DMatrix::from_row_slice(1, weights.len(), weights);
    let each = experiments.iter().enumerate().map(|(index, experiment)| {
        let Some(noise) = &experiment.noise else { return from_residual(stack, fit, influences, index) };
        let (sizes, weights) = (leverage_corrected(stack, fit, influences, index), part(stack, &weighed, index));
        let mut map = part(stack, &fit.projection, index);
        let m = stack.spans[index];
        for (j, variance) in variances(noise).iter().enumerate() {
            let squares = sizes.columns(j * m, m).norm_squared();
            let expected = weights.columns(j * m, m).norm_squared() * variance;
            let size = if expected > 0.0 { (squares / expected).sqrt() } else { 0.0 };
            for k in j * m..(j + 1) * m {
                map.column_mut(k).scale_mut(size * weights[k]);
            }
        }
        between_periods(&map, experiment.kept(), noise)
    });
    each.fold(Spread::zero(fit.beta.len()), |sum, one| sum.plus(&one))
}

/// Covariance of the parameters from the noise of torques and positions together: every period's torques are compared with the model
/// at that period's positions. Without repeated periods, the residual contains both.
pub fn of_all(structure: &Structure, stack: &Stack, experiments: &[Experiment], kept: &[usize], fit: &Fit) -> Spread {
    let mut beta = vec![0.0; structure.columns().len()];
    kept.iter().zip(fit.beta.iter()).for_each(|(&c, &value)| beta[c] = value);
    let residual = stack.residual(&fit.beta);
    let each = experiments.iter().enumerate().map(|(index, experiment)| match &experiment.repeats {
        Some(repeats) => {
            let both = combined(structure, experiment, repeats, &beta);
            let (samples, dt) = (experiment.motion.samples(), experiment.motion.dt);
            let noise = NoiseOfMean::of(&both, &repeats.counted, samples, dt, |f| experiment.gain(f));
            of_mean(stack, fit, &residual, index, experiment.kept(), &noise)
        }
        None => from_residual(stack, fit, &residual, index),
    });
    each.fold(Spread::zero(fit.beta.len()), |sum, one| sum.plus(&one))
}

/// Covariance of the parameters from one experiment's mean period at the samples `at`: from its `noise`, and from what is left beyond that. What the model lacks
/// and the steps of the encoders are alike in every period, and no scatter shows them. They count as noise of their own spectrum, frequency by frequency as
/// the estimate weighs them: in each joint the power of the residual beyond that of the noise, both as means over neighbouring frequencies. Unless their ratio
/// is more than chance by its degrees of freedom in the mean over all frequencies, the largest power that the noise alone would have by chance counts as its.
fn of_mean(
    stack: &Stack,
    fit: &Fit,
    residual: &DVector<f64>,
    index: usize,
    at: &[usize],
    noise: &NoiseOfMean,
) -> Spread {
    let own = part(stack, &DMatrix::from_row_slice(1, residual.len(), residual.as_slice()), index);
    let correction = freedom(stack.tau.len(), fit.rank);
    let m = stack.spans[index];
    let of_joint = |signal: &[f64]| power(signal, at, noise.samples, correction);
    let left: Vec<Vec<f64>> = own.as_slice().chunks_exact(m).map(of_joint).collect();
    let left = beyond(&left, noise);
    let map = part(stack, &fit.projection, index);
    between_periods(&map, at, noise).plus(&between_periods(&map, at, &left))
}

/// Spectrum of what is left beyond the noise, from the power of the residual by joint and frequency.
fn beyond(left: &[Vec<f64>], noise: &NoiseOfMean) -> NoiseOfMean {
    let bins: Vec<usize> = noise.bins.iter().map(|(bin, _)| *bin).collect();
    let near: Vec<Vec<usize>> =
        bins.iter().map(|bin| (0..bins.len()).filter(|&k| are_near(*bin, bins[k])).collect()).collect();
    // Largest ratio of two means over so many frequencies that noise alone has.
    let by_chance = |number: usize| {
        let freedom = 2.0 * number as f64;
        let f = FisherSnedecor::new(freedom, freedom * noise.freedom);
        f.map_or(1.0, |f| f.inverse_cdf(1.0 - BY_CHANCE))
    };
    let everywhere = by_chance(bins.len());
    let ratios: Vec<f64> = near.iter().map(|near| by_chance(near.len())).collect();
    let of_joint = |(j, left): (usize, &Vec<f64>)| -> Vec<f64> {
        let mean =
            |near: &[usize], of: &dyn Fn(usize) -> f64| near.iter().map(|&k| of(k)).sum::<f64>() / near.len() as f64;
        let residual = |near: &[usize]| mean(near, &|k| *left.get(bins[k]).unwrap_or(&0.0));
        let scatter = |near: &[usize]| mean(near, &|k| noise.bins[k].1[(j, j)].re);
        let powers: Vec<[f64; 2]> = near.iter().map(|near| [residual(near), scatter(near)]).collect();
        let ratio = |[residual, scatter]: &[f64; 2]| residual / scatter.max(f64::MIN_POSITIVE);
        let lacks = powers.iter().map(ratio).sum::<f64>() / bins.len() as f64 > everywhere;
        let more = |([residual, scatter], ratio): (&[f64; 2], &f64)| {
            (residual - if lacks { 1.0 } else { *ratio } * scatter).max(0.0)
        };
        powers.iter().zip(&ratios).map(more).collect()
    };
    let joints: Vec<Vec<f64>> = left.iter().enumerate().map(of_joint).collect();
    let at = |k: usize| DMatrix::from_diagonal(&DVector::from_fn(left.len(), |j, _| joints[j][k].into()));
    let bins = bins.iter().enumerate().map(|(k, bin)| (*bin, at(k))).collect();
    // As many degrees of freedom as the spectrum of one period has.
    NoiseOfMean { freedom: 1.0, samples: noise.samples, bins }
}

/// Power by frequency of a signal at some of a period's samples, in the units of [`NoiseOfMean::bins`]. The others are zeros of an even grid.
fn power(signal: &[f64], at: &[usize], samples: usize, correction: f64) -> Vec<f64> {
    let step = at.windows(2).map(|pair| pair[1] - pair[0]).min().unwrap_or(1).max(1);
    let mut even = vec![0.0; samples.div_ceil(step)];
    at.iter().zip(signal).for_each(|(at, value)| even[at / step] = *value);
    let scale = correction * samples as f64 / (even.len() * signal.len()) as f64;
    Spectral::new(even.len(), 1.0).transform(&even).iter().map(|value| scale * value.norm_sqr()).collect()
}

/// Whether two frequencies are neighbours.
fn are_near(one: usize, other: usize) -> bool {
    let [low, high] = [one.min(other) as f64, one.max(other) as f64];
    high <= NEIGHBOURHOOD_RATIO * low + NEIGHBOURS
}

fn from_residual(stack: &Stack, fit: &Fit, residual: &DVector<f64>, index: usize) -> Spread {
    let own = leverage_corrected(stack, fit, residual, index);
    newey_west(&part(stack, &fit.projection, index), own.as_slice(), stack.spans[index])
}

/// One experiment's residuals, corrected for leverage.
fn leverage_corrected(stack: &Stack, fit: &Fit, residual: &DVector<f64>, index: usize) -> DMatrix<f64> {
    // The variance of a residual is reduced by its leverage, the derivative of the modelled torque with respect to the measured one.
    let leverage_corrected = DMatrix::from_fn(1, residual.len(), |_, row| {
        let leverage = (stack.w.row(row) * fit.projection.column(row))[(0, 0)];
        residual[row] / (1.0 - leverage.clamp(0.0, MAX_LEVERAGE)).sqrt()
    });
    part(stack, &leverage_corrected, index)
}

/// Columns of one experiment, joint by joint, of a matrix with a column for every equation.
fn part(stack: &Stack, b: &DMatrix<f64>, index: usize) -> DMatrix<f64> {
    let m = stack.per_joint();
    let range = stack.ranges().nth(index).expect("an experiment of the stack");
    let columns: Vec<usize> = (0..stack.joints).flat_map(|j| range.clone().map(move |k| j * m + k)).collect();
    b.select_columns(&columns)
}

/// Deviation of each period's torques from the model's response to the deviation of its positions, P N x n. The response is evaluated at
/// deviations of the size of the mean's noise, as in the estimate, and scaled back.
fn combined(structure: &Structure, experiment: &Experiment, repeats: &Repeats, beta: &[f64]) -> DMatrix<f64> {
    let samples = experiment.motion.samples();
    let at_mean = structure.torques(beta, &experiment.motion);
    let mut both = repeats.tau.clone();
    for (p, (motion, scale)) in moved_by_period(experiment, repeats).enumerate() {
        let change = (structure.torques(beta, &motion) - &at_mean) * scale;
        let mut rows = both.rows_mut(p * samples, samples);
        rows -= change;
    }
    both
}

/// For each period the mean motion plus noise of the mean's size, and the ratio of the period's noise to it.
fn moved_by_period<'a>(experiment: &'a Experiment, repeats: &'a Repeats) -> impl Iterator<Item = (Motion, f64)> + 'a {
    let samples = experiment.motion.samples();
    let periods = repeats.q.nrows() / samples;
    let scale = ((periods - 1) as f64).sqrt();
    (0..periods).map(move |p| (experiment.moved(&(repeats.q.rows(p * samples, samples) / scale)), scale))
}

/// Changes of the regressor under noise of the positions, filtered and decimated, per experiment; each with the parameters' columns.
pub struct Draws(Vec<Vec<DMatrix<f64>>>);

impl Draws {
    /// Draws from the repeated periods, else from white noise of the positions' standard deviation.
    pub fn of(structure: &Structure, experiments: &[Experiment]) -> Draws {
        let each = experiments.iter().map(|experiment| {
            let at_mean = structure.regressor(&experiment.motion);
            let change = |motion: Motion| experiment.band(&(structure.regressor(&motion) - &at_mean));
            match &experiment.repeats {
                Some(repeats) => moved_by_period(experiment, repeats).map(|(motion, _)| change(motion)).collect(),
                None => white(experiment).map(change).collect(),
            }
        });
        Draws(each.collect())
    }

    /// Restriction to some of the columns.
    pub fn columns(&self, kept: &[usize]) -> Draws {
        Draws(self.0.iter().map(|draws| draws.iter().map(|draw| draw.select_columns(kept)).collect()).collect())
    }

    /// `errors` of [`super::tls::solve`]: expected squares of the whitened regressor's and torque's noise.
    pub fn errors(&self, stack: &Stack, experiments: &[Experiment], weighed: &Weighed) -> DMatrix<f64> {
        let p = stack.w.ncols();
        let sigma = deviations(&weighed.sigma);
        let mut errors = DMatrix::zeros(p + 1, p + 1);
        for (draws, experiment) in self.0.iter().zip(experiments) {
            let count = experiment.kept().len();
            let mut of_regressor = DMatrix::zeros(p, p);
            for draw in draws {
                let whitened = Weights::per_joint(&sigma).apply(draw);
                of_regressor += transposed_product(&whitened, &whitened) / draws.len() as f64;
            }
            let of_torque = match &experiment.noise {
                Some(noise) => variances(noise).iter().zip(&sigma).map(|(v, s)| count as f64 * v / (s * s)).sum(),
                None => {
                    let beta = &weighed.fit.beta;
                    let all = (count * stack.joints) as f64;
                    (all - beta.dot(&(&of_regressor * beta))).max(MIN_TORQUE_NOISE_RATIO * all)
                }
            };
            let mut block = errors.view_mut((0, 0), (p, p));
            block += of_regressor;
            errors[(p, p)] += of_torque;
        }
        errors
    }
}

/// Variance of the filtered mean torques, n.
fn variances(noise: &NoiseOfMean) -> Vec<f64> {
    let n = noise.bins.first().map_or(0, |(_, power)| power.nrows());
    let sides = |bin: usize| if bin == 0 || 2 * bin == noise.samples { 1.0 } else { 2.0 };
    let of = |j: usize| noise.bins.iter().map(|(bin, power)| sides(*bin) * power[(j, j)].re).sum::<f64>();
    (0..n).map(|j| of(j) / noise.samples as f64).collect()
}

/// Measured motion with additional white noise of the positions' standard deviation.
fn white(experiment: &Experiment) -> impl Iterator<Item = Motion> + '_ {
    let std = experiment.noise_of_positions();
    let (samples, n) = experiment.grid();
    let mut rng = ChaCha8Rng::seed_from_u64(0x746c_7320);
    (0..DRAWS).map(move |_| {
        experiment.moved(&DMatrix::from_fn(samples, n, |_, j| std[j] * rng.sample::<f64, _>(StandardNormal)))
    })
}

/// Regressors and their instruments: the desired motion where it was recorded, else the mean of the odd periods for that of the even
/// ones and vice versa.
///
/// # Errors
/// An experiment with neither.
pub fn instruments(structure: &Structure, experiments: &[Experiment]) -> Result<Vec<Pair>, EstimateError> {
    let (mut first, mut second) = (Vec::new(), Vec::new());
    for experiment in experiments {
        let [one, other] = match (&experiment.desired, &experiment.repeats) {
            (Some(desired), _) => [experiment.motion.clone(), desired.clone()],
            (None, Some(repeats)) => halves(experiment, repeats),
            (None, None) => return Err(EstimateError::NoInstruments { run: experiment.name.clone() }),
        };
        first.push(one);
        second.push(other);
    }
    let along = |motions: &[Motion]| regressor(structure, experiments, &motions.iter().collect::<Vec<_>>(), 0);
    let (one, other) = (along(&first)?, along(&second)?);
    let mut pairs = vec![Pair { regressor: one.clone(), instrument: other.clone() }];
    // The halves are symmetric: each is the other's instrument. A desired motion is an instrument only.
    if experiments.iter().all(|experiment| experiment.desired.is_none()) {
        pairs.push(Pair { regressor: other, instrument: one });
    }
    Ok(pairs)
}

/// Mean motion of the even and of the odd periods, as measured: noise that is taken off the mean of all would be in both, with opposite signs.
fn halves(experiment: &Experiment, repeats: &Repeats) -> [Motion; 2] {
    let samples = experiment.motion.samples();
    let periods = repeats.q.nrows() / samples;
    [0, 1].map(|parity| {
        let own = (0..periods).filter(|p| p % 2 == parity);
        let count = own.clone().count() as f64;
        let sum =
            own.fold(DMatrix::zeros(samples, repeats.q.ncols()), |sum, p| sum + repeats.q.rows(p * samples, samples));
        experiment.moved_as_measured(&(sum / count))
    })
}

impl Pair {
    /// Restriction to some of the columns.
    pub fn columns(&self, kept: &[usize]) -> Pair {
        Pair { regressor: self.regressor.select_columns(kept), instrument: self.instrument.select_columns(kept) }
    }
}
