//! What the resolution of the encoders does to the torque of a model.

use super::Experiment;
use crate::periods::Scatter;
use crate::signal::spectral::Spectral;
use nalgebra::{DMatrix, DVector};
use plumbline_model::term::Motion;
use std::f64::consts::PI;

/// Frequencies below which the errors of such places are compared \[Hz\].
const RESOLUTION_BAND_HZ: f64 = 16.0;
/// Places of an encoder's steps that are tried.
const ROUNDINGS: usize = 8;
/// Waves of the series for what rounding does to a difference of positions: exact to a hundredth of a step.
const MAX_WAVES: i32 = 50;
/// Bisections for the motion behind rounded positions.
const DITHER_BISECTIONS: usize = 30;

/// Neighbours on each side of a frequency whose power is averaged with its own.
const NEIGHBOURS: usize = 4;

/// Noise of the encoders in the mean of several periods.
#[derive(Clone, Debug)]
pub(super) struct EncoderNoise {
    /// What it is of the mean positions, N x n \[rad\].
    pub taken_off: DMatrix<f64>,
    /// Share `G` of the positions' power at each frequency that is motion, bins x n.
    shares: DMatrix<f64>,
    /// See [`kept`].
    kept: Vec<f64>,
}

impl EncoderNoise {
    /// Takes it off the positions `q` of a mean period, N x n \[rad\]:
    ///
    ///   Q_m -> G_m Q_m,   G_m = max(0, 1 - N_m / S_m),   N_m = scatter_m / P + kept^2 delta^2 / 12
    ///
    /// with the mean power `S_m` of `Q` at `m` and its neighbours (Wiener's filter). The motion differs from what is left by an error of the power `G_m N_m`
    /// that is independent of it. Of positions as measured the error is part of them, and dilutes every column of high derivatives: a soft gear would be
    /// like a low-pass that takes the rounding out of the model's torque. `scatter` has the positions' columns first.
    pub fn take_off(q: &mut DMatrix<f64>, scatter: &Scatter, steps: &[f64]) -> EncoderNoise {
        let spectral = Spectral::new(scatter.samples, scatter.dt);
        let kept = kept(steps, &scatter.std);
        let (measured, mut shares) = (q.clone(), DMatrix::from_element(spectral.bins(), q.ncols(), 1.0));
        for (j, mut column) in q.column_iter_mut().enumerate() {
            let mut spectrum = spectral.transform(column.as_slice());
            let power: Vec<f64> = spectrum.iter().map(|value| value.norm_sqr() / scatter.samples as f64).collect();
            let rounding = (kept[j] * steps[j]).powi(2) / 12.0;
            for (m, value) in spectrum.iter_mut().enumerate().skip(1) {
                let around = m.saturating_sub(NEIGHBOURS).max(1)..(m + NEIGHBOURS + 1).min(power.len());
                let mean = |of: &dyn Fn(usize) -> f64| around.clone().map(of).sum::<f64>() / around.len() as f64;
                // Of samples at which all periods count: more would take motion off there.
                let noise = mean(&|m| scatter.power[(m, j)]) / scatter.periods as f64 + rounding;
                shares[(m, j)] = (1.0 - noise / mean(&|m| power[m]).max(f64::MIN_POSITIVE)).max(0.0);
                *value *= shares[(m, j)];
            }
            column.copy_from_slice(&spectral.signal(spectrum));
        }
        EncoderNoise { taken_off: measured - &*q, shares, kept }
    }
}

/// Share of the amplitude of a rounding error that repeats in every period, per joint: motions that differ between periods by `sigma` dither a step
/// `delta`, which leaves `exp(-(2 pi sigma / delta)^2)` of the power (Widrow, Kollar, Quantization Noise, 2008).
fn kept(steps: &[f64], noise: &[f64]) -> Vec<f64> {
    let kept = |(step, noise): (&f64, &f64)| (-0.5 * (2.0 * PI * dither(*noise, *step) / step).powi(2)).exp();
    steps.iter().zip(noise).map(|(step, noise)| if *step > 0.0 { kept((step, noise)) } else { 0.0 }).collect()
}

impl Experiment {
    /// Puts into [`Scatter::repeated`] what the resolution of the encoders does to the model's torque. A motion that repeats within one step of an encoder
    /// is rounded alike in every period: no scatter between periods shows it, and no mean removes it. `predict` gives the torques along a motion.
    ///
    /// The motion behind the torques' low-pass, in which the steps are hardly left, is rounded once more: the torque of the difference has the
    /// spectrum of the error, of which [`EncoderNoise::take_off`] leaves a share. How much there is depends on where the steps are: it is that of the worst of
    /// several places.
    pub fn add_resolution(&mut self, predict: impl Fn(&Motion) -> DMatrix<f64>) {
        let (Some(scatter), Some(noise)) = (&self.scatter, &self.encoder_noise) else { return };
        let mut spectral = Spectral::new(scatter.samples, scatter.dt);
        let q = self.filter.zero_phase_periods(&self.motion.q);
        let rounded = |shift: f64, spectral: &mut Spectral| {
            let mut error = DMatrix::from_fn(q.nrows(), q.ncols(), |k, j| {
                let step = self.resolution[j];
                let steps = q[(k, j)] / step;
                if step > 0.0 { noise.kept[j] * step * ((steps + shift).round() - shift - steps) } else { 0.0 }
            });
            for (mut error, shares) in error.column_iter_mut().zip(noise.shares.column_iter()) {
                let left = spectral.scaled(error.as_slice(), |bin| shares[bin].sqrt());
                error.copy_from_slice(&left);
            }
            error
        };
        let exact = predict(&self.motion);
        let of_place = |place: usize, spectral: &mut Spectral| {
            let error = predict(&self.moved(&rounded(place as f64 / ROUNDINGS as f64, spectral))) - &exact;
            let square = |column: &[f64]| spectral.transform(column).iter().map(|value| value.norm_sqr()).collect();
            let columns: Vec<DVector<f64>> =
                error.column_iter().map(|column| DVector::from_vec(square(column.as_slice()))).collect();
            DMatrix::from_columns(&columns)
        };
        let places: Vec<DMatrix<f64>> = (0..ROUNDINGS).map(|place| of_place(place, &mut spectral)).collect();
        let mean = places.iter().sum::<DMatrix<f64>>() / ROUNDINGS as f64;
        let low = (0..spectral.bins()).take_while(|&bin| spectral.frequency(bin) < RESOLUTION_BAND_HZ).count();
        let below = |of: &DMatrix<f64>, j: usize| of.column(j).rows(0, low).sum();
        let mut repeated = mean.clone();
        for j in 0..q.ncols() {
            let largest = places.iter().map(|own| below(own, j)).fold(0.0, f64::max);
            let ratio = largest / below(&mean, j).max(f64::MIN_POSITIVE);
            repeated.column_mut(j).scale_mut(ratio / scatter.samples as f64);
        }
        self.scatter = Some(Scatter { repeated, ..scatter.clone() });
    }
}

/// Standard deviation of a motion between periods from that of its positions, which were rounded to steps: `sigma` in
///
///   s^2 = sigma^2 + delta^2 / 2 (1/6 - sum_k exp(-(2 pi k sigma / delta)^2) / (pi k)^2)
///
/// A motion that differs by little is often rounded to another step, and its positions seem to differ by more.
fn dither(std: f64, step: f64) -> f64 {
    let lost = |sigma: f64| {
        let wave = |k: f64| (-(2.0 * PI * k * sigma / step).powi(2)).exp() / (PI * k).powi(2);
        0.5 * step * step * (1.0 / 6.0 - (1..=MAX_WAVES).map(|k| wave(f64::from(k))).sum::<f64>())
    };
    let (mut low, mut high) = (0.0, std);
    for _ in 0..DITHER_BISECTIONS {
        let middle = 0.5 * (low + high);
        if middle * middle + lost(middle) < std * std { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

#[cfg(test)]
mod tests {
    use super::super::tests::{inertia, kept_periods, run};
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    #[test]
    fn the_resolution_of_an_encoder_is_noise_that_repeats() {
        const STEP: f64 = 1e-4;
        for (dither, repeats) in [(0.0, true), (2.0 * STEP, false)] {
            let mut run = run(Some(2.0), 16.0);
            run.tau = DMatrix::from_fn(run.q.nrows(), 2, |k, j| -2.0 * (PI * (j + 1) as f64).powi(2) * run.q[(k, j)]);
            // What dithers differs from sample to sample and from period to period.
            let dithered = |k: usize| dither * (2.0 * ((k * k) as f64 * 0.618_034).fract() - 1.0);
            run.q = DMatrix::from_fn(run.q.nrows(), 2, |k, j| ((run.q[(k, j)] + dithered(k)) / STEP).round() * STEP);
            let mut experiment = Experiment::prepare(&run, &kept_periods()).unwrap();
            assert!(experiment.resolution.iter().all(|step| (step / STEP - 1.0).abs() < 1e-6));
            let in_band = |signal: &[f64]| {
                let spectral = Spectral::new(signal.len(), 1e-3);
                let values = spectral.transform(signal);
                let power = values.iter().enumerate().filter(|(bin, _)| spectral.frequency(*bin) < 16.0);
                (2.0 * power.map(|(_, value)| value.norm_sqr()).sum::<f64>()).sqrt() / signal.len() as f64
            };
            let error = inertia(&experiment.motion) - &experiment.tau;
            let noise =
                |experiment: &Experiment| experiment.scatter.as_ref().unwrap().std_of_mean(|f| f64::from(f < 16.0));
            let before = noise(&experiment);
            experiment.add_resolution(inertia);
            let after = noise(&experiment);
            for j in 0..2 {
                let ratio = after[j] / in_band(error.column(j).as_slice());
                if repeats {
                    assert!(
                        before[j] < 1e-9 && (0.5..2.0).contains(&ratio),
                        "joint {j}: {before:?} {after:?}, {ratio}"
                    );
                } else {
                    assert!(
                        (after[j] - before[j]).abs() < 1e-3 * before[j].max(1e-9),
                        "joint {j}: {before:?} {after:?}"
                    );
                }
            }
        }
    }

    /// The slope of a gear's torque over its column, the fourth derivative of the positions, is that of the motion however coarse the encoder is.
    #[test]
    fn what_an_encoder_rounds_does_not_dilute_a_column_of_high_derivatives() {
        const STEP: f64 = 1e-4;
        for (dither, slow) in [(0.0, 1.0), (2.0 * STEP, 1.0), (0.0, 0.3)] {
            let motion = |t: f64| slow * (PI * t).sin() + 2e-4 * (16.0 * PI * t).sin();
            let mut run = run(Some(2.0), 16.0);
            let dithered = |k: usize| dither * (2.0 * ((k * k) as f64 * 0.618_034).fract() - 1.0);
            let t = run.t.clone();
            run.q = DMatrix::from_fn(t.len(), 2, |k, _| ((motion(t[k]) + dithered(k)) / STEP).round() * STEP);
            let experiment = Experiment::prepare(&run, &kept_periods()).unwrap();
            let samples = experiment.motion.samples();
            let truth: Vec<f64> = (0..samples)
                .map(|k| slow * PI.powi(4) * (PI * t[k]).sin() + 2e-4 * (16.0 * PI).powi(4) * (16.0 * PI * t[k]).sin())
                .collect();
            let slope = |q: &[f64]| {
                let mut spectral = Spectral::new(samples, experiment.motion.dt);
                let low = |f: f64| f64::from(f < 25.0);
                let [.., ddq] = spectral.derivatives(q, low);
                let [.., column] = spectral.derivatives(&ddq, low);
                let square: f64 = column.iter().map(|value| value * value).sum();
                column.iter().zip(&truth).map(|(column, truth)| column * truth).sum::<f64>() / square
            };
            let rounded: Vec<f64> = (0..samples).map(|k| run.q[(k, 0)]).collect();
            let (kept, diluted) = (slope(experiment.q.column(0).as_slice()), slope(&rounded));
            assert!(
                (kept - 1.0).abs() < 0.1 && diluted < 0.6,
                "{dither} {slow}: {kept}, of one rounded period {diluted}"
            );
        }
    }

    #[test]
    fn motions_that_differ_little_are_often_rounded_to_other_steps() {
        // Two motions, of which the second is a normal number from the first, at places all over a step.
        for (sigma, apart) in [(0.02, 0.1), (0.1, 0.22), (0.5, 0.5)] {
            let mut rng = ChaCha8Rng::seed_from_u64(3);
            let mut normal = || -> f64 { StandardNormal.sample(&mut rng) };
            let count = 200_000;
            let square = |k: usize| {
                let place = (k as f64 * 0.618_034).fract();
                let [one, other] = [normal(), normal()].map(|unit| (place + sigma * unit).round());
                (one - other).powi(2)
            };
            let seen = ((0..count).map(square).sum::<f64>() / (2 * count) as f64).sqrt();
            assert!(seen > apart, "{sigma} of a step are seen as {seen}");
            assert!((dither(seen, 1.0) / sigma - 1.0).abs() < 0.05, "{} for {sigma}", dither(seen, 1.0));
        }
        assert_eq!(dither(0.0, 1.0), 0.0);
    }
}
