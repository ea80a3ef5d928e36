//! Weights by frequency, for noise that is coloured in time and known from repeated periods.
//!
//! The noise of a mean of P periods is stationary and circular in time: frequency by frequency it is independent, and dividing the equations by the square
//! root of its power whitens it. What the model lacks has no such spectrum. The residual's excess over the noise is treated as white, so that a
//! model that is far from complete is weighted as by [`super::wls`] without spectra:
//!
//!   S_j(f) = D_j(f) / P + E_j,   E_j = max(0, sigma_j^2 - mean_f g^2 D_j / P) / mean_f g^2
//!
//! with `D_j` the noise of one period, `g` the gain of the filter and `sigma_j` the residual's standard deviation. The filter attenuates what the model
//! says and noise alike, which the weights make up for.

use super::gains::Gains;
use super::linear::Weights;
use super::stack::Stack;
use crate::experiment::Experiment;
use crate::periods::NoisePower;
use crate::signal::spectral::Spectral;

/// Least gain of the filter that the weights make up for.
const MIN_GAIN: f64 = 0.03;

/// Noise of each joint's mean torque by frequency, experiment by experiment.
#[derive(Clone, Debug)]
pub struct Noise {
    each: Vec<NoiseOfExperiment>,
    joints: usize,
}

#[derive(Clone, Debug)]
struct NoiseOfExperiment {
    /// Power at the frequencies of the kept samples, per joint \[Nm2\].
    power: Vec<Vec<f64>>,
    /// Variance behind the filter, per joint \[Nm2\].
    filtered: Vec<f64>,
    /// Variance behind the filter of white noise of variance 1.
    passed: f64,
    /// Inverse of the filter's gain at the frequencies of the kept samples.
    unfiltered: Vec<f64>,
}

impl Noise {
    /// Of these experiments; `None` where one has no repeats or is not weighted by frequency.
    pub fn of(experiments: &[Experiment]) -> Option<Noise> {
        let scatters: Option<Vec<_>> = experiments.iter().map(Experiment::coloured).collect();
        let scatters = scatters.filter(|scatters| !scatters.is_empty())?;
        let joints = experiments[0].joints();
        let smooth: Vec<NoisePower> = (0..joints).map(|joint| NoisePower::of(&scatters, joint)).collect();
        let each = experiments.iter().zip(&scatters).map(|(experiment, scatter)| {
            let whole = Spectral::new(scatter.samples, scatter.dt);
            let white = |m: usize| experiment.gain(whole.frequency(m)).powi(2);
            let passed = both_sides(scatter.samples, white);
            let kept = experiment.kept().len();
            let dt = scatter.samples as f64 * scatter.dt / kept as f64;
            let own = Spectral::new(kept, dt);
            let power = |joint: usize| {
                let at = |m: usize| {
                    let [scattered, repeated] = smooth[joint].at(own.frequency(m), scatter.dt);
                    scattered / scatter.averaged + repeated
                };
                (0..own.bins()).map(at).collect()
            };
            let filtered = |joint: usize| both_sides(scatter.samples, |m| white(m) * scatter.power_of_mean(m, joint));
            NoiseOfExperiment {
                power: (0..joints).map(power).collect(),
                filtered: (0..joints).map(filtered).collect(),
                passed,
                unfiltered: (0..own.bins()).map(|m| 1.0 / experiment.gain(own.frequency(m)).max(MIN_GAIN)).collect(),
            }
        });
        Some(Noise { each: each.collect(), joints })
    }

    /// Weights for a residual of these standard deviations \[Nm\].
    pub fn weights(&self, stack: &Stack, sigma: &[f64], least: &[f64]) -> Weights {
        let of = |(experiment, &samples): (&NoiseOfExperiment, &usize)| {
            let gains = |joint: usize| {
                let excess = (sigma[joint].powi(2) - experiment.filtered[joint]).max(least[joint].powi(2));
                let gain = |(power, unfiltered): (&f64, &f64)| unfiltered / (power + excess / experiment.passed).sqrt();
                experiment.power[joint].iter().zip(&experiment.unfiltered).map(gain).collect()
            };
            Gains { samples, joints: (0..self.joints).map(gains).collect() }
        };
        Weights::by_frequency(self.joints, self.each.iter().zip(&stack.spans).map(of).collect())
    }
}

/// Mean over the frequencies of both sides of a spectrum of `samples` samples.
fn both_sides(samples: usize, of: impl Fn(usize) -> f64) -> f64 {
    let sides = |m: usize| if m == 0 || 2 * m == samples { 1.0 } else { 2.0 };
    (0..=samples / 2).map(|m| sides(m) * of(m)).sum::<f64>() / samples as f64
}
