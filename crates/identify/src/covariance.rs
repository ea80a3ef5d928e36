//! Covariance of the parameters under coloured noise.
//!
//! Least squares assumes noise that is white in time. With coloured noise the estimate is still unbiased, but the usual formula of its
//! covariance is wrong. With `beta = B tau` the covariance is `B C B'` for any noise covariance `C`. For a periodic motion, `C` is the scatter
//! between the periods, correlations between joints included. Otherwise it is estimated from the residual: the scores `B_k r_k` of every sample
//! `k` summed with their neighbours (Newey and West 1987).

use super::periods::NoiseOfMean;
use nalgebra::{DMatrix, DVector};
use plumbline_core::JointVec;
use realfft::num_complex::Complex;
use std::f64::consts::PI;

/// Largest correlation of a score with the one before that it is whitened by.
const MAX_CORRELATION: f64 = 0.97;

/// Covariance of the parameters with the degrees of freedom of each variance.
#[derive(Clone, Debug)]
pub struct Spread {
    /// Covariance of the parameters, p x p.
    pub covariance: DMatrix<f64>,
    /// Degrees of freedom of each variance (Satterthwaite), p: an interval uses the quantile of Student's t distribution.
    pub freedom: Vec<f64>,
}

impl Spread {
    /// Zero covariance, the neutral element of [`Spread::plus`].
    pub fn zero(parameters: usize) -> Spread {
        Spread { covariance: DMatrix::zeros(parameters, parameters), freedom: vec![f64::INFINITY; parameters] }
    }

    /// `y C y'` of each joint with `y` its row of the regressor, from the regressor's columns. Neither allocates nor panics.
    pub fn variance(&self, columns: &[JointVec]) -> JointVec {
        let of = &self.covariance;
        let mut variance = JointVec::default();
        for (row, with) in columns.iter().zip(of.as_slice().chunks_exact(of.nrows().max(1))) {
            let mut spread = JointVec::default();
            for (column, covariance) in columns.iter().zip(with) {
                spread.iter_mut().zip(column).for_each(|(spread, value)| *spread += covariance * value);
            }
            for ((variance, row), spread) in variance.iter_mut().zip(row).zip(&spread) {
                *variance += row * spread;
            }
        }
        variance.map(|variance| variance.max(0.0))
    }

    /// Sum of two independent contributions.
    pub fn plus(&self, other: &Spread) -> Spread {
        let part = |of: &Spread, c: usize| of.covariance[(c, c)].powi(2) / of.freedom[c];
        let covariance = &self.covariance + &other.covariance;
        let freedom = (0..covariance.nrows())
            .map(|c| covariance[(c, c)].powi(2) / (part(self, c) + part(other, c)))
            .map(|freedom| if freedom.is_nan() { f64::INFINITY } else { freedom })
            .collect();
        Spread { covariance, freedom }
    }
}

/// `B C B'` with `C` the noise of a mean period at the samples `at` of its grid; `b` is p x n m, its columns joint by joint in the order of
/// `at`.
pub fn between_periods(b: &DMatrix<f64>, at: &[usize], noise: &NoiseOfMean) -> Spread {
    let (p, m) = (b.nrows(), at.len());
    let n = b.ncols() / m;
    assert_eq!(b.ncols(), n * m, "one block of columns per joint");
    let mut covariance = DMatrix::<f64>::zeros(p, p);
    let mut fourth = vec![0.0; p];
    for (bin, power) in &noise.bins {
        assert_eq!(power.nrows(), n, "one column of noise per joint");
        // Spectrum of the map `b` at this frequency, p x n.
        let turn = -2.0 * PI * *bin as f64 / noise.samples as f64;
        let (cos, sin): (Vec<f64>, Vec<f64>) =
            at.iter().map(|&k| ((turn * k as f64).cos(), (turn * k as f64).sin())).unzip();
        let (cos, sin) = (DVector::from_vec(cos), DVector::from_vec(sin));
        let mut spectrum = DMatrix::<Complex<f64>>::zeros(p, n);
        for j in 0..n {
            let block = b.columns(j * m, m);
            let (re, im) = (block * &cos, block * &sin);
            for c in 0..p {
                spectrum[(c, j)] = Complex::new(re[c], im[c]);
            }
        }
        // Two-sided: every frequency except 0 Hz and half the rate represents its negative too.
        let one_sided = *bin == 0 || 2 * bin == noise.samples;
        let sides = if one_sided { 1.0 } else { 2.0 };
        let product = spectrum.conjugate() * power * spectrum.transpose();
        let freedom = sides * noise.freedom;
        for c in 0..p {
            for d in 0..p {
                covariance[(c, d)] += sides * product[(c, d)].re / noise.samples as f64;
            }
            fourth[c] += (sides * product[(c, c)].re / noise.samples as f64).powi(2) / freedom;
        }
    }
    // Of two periods that are alike in a part of their time less than one is left; an interval of fewer than one says no more than that nothing is known.
    let at_least_one = |c: usize| (covariance[(c, c)].powi(2) / fourth[c]).max(1.0);
    let freedom = (0..p).map(|c| if fourth[c] > 0.0 { at_least_one(c) } else { f64::INFINITY });
    Spread { freedom: freedom.collect(), covariance: symmetric(&covariance) }
}

/// `sum_l w_l sum_k s_k s_{k+l}'` of the scores `s_k = B_k r_k` (Newey and West 1987, Bartlett's weights `w_l = 1 - |l| / (L + 1)`), each
/// [whitened](prewhitened) before.
///
/// `b` is p x n m, `residual` n m, both joint by joint with m samples in time. The number of lags `L` comes from the scores themselves
/// (Newey and West 1994). The residual must be corrected for the degrees of freedom of the fit.
pub fn newey_west(b: &DMatrix<f64>, residual: &[f64], samples: usize) -> Spread {
    let (p, n) = (b.nrows(), b.ncols() / samples);
    assert_eq!((residual.len(), b.ncols()), (n * samples, n * samples), "one residual per column");
    let mut scores = DMatrix::zeros(p, samples);
    for j in 0..n {
        for k in 0..samples {
            scores.column_mut(k).axpy(residual[j * samples + k], &b.column(j * samples + k), 1.0);
        }
    }
    let (scores, gains) = prewhitened(&scores);
    let lags = bandwidth(&scores);
    let mut covariance = DMatrix::zeros(p, p);
    for lag in 0..=lags {
        let weight = 1.0 - lag as f64 / (lags + 1) as f64;
        let count = samples - lag;
        let product = scores.columns(0, count) * scores.columns(lag, count).transpose();
        covariance += if lag == 0 { product * weight } else { (&product + product.transpose()) * weight };
    }
    covariance.component_mul_assign(&(&gains * gains.transpose()));
    // A variance from Bartlett's window over m samples has about 1.5 m / L degrees of freedom (Priestley 1981, table 6.2).
    let freedom = 1.5 * samples as f64 / (lags as f64).max(1.0);
    Spread { freedom: vec![freedom; p], covariance: symmetric(&covariance) }
}

/// Every score less what the one before predicts, `e_k = s_k - a s_(k-1)`, and the gain `1 / (1 - a)` of the slow part of `s` over that of `e`
/// (Andrews and Monahan, Econometrica 60, 1992). Bartlett's window takes from slow noise what lies beyond its lags; what is whitened has less there.
fn prewhitened(scores: &DMatrix<f64>) -> (DMatrix<f64>, DVector<f64>) {
    let (mut whitened, mut gains) = (scores.clone(), DVector::zeros(scores.nrows()));
    for (i, row) in scores.row_iter().enumerate() {
        let row: Vec<f64> = row.iter().copied().collect();
        let product: f64 = row.windows(2).map(|pair| pair[0] * pair[1]).sum();
        let square: f64 = row.iter().map(|x| x * x).sum();
        let a = (product / square.max(f64::MIN_POSITIVE)).clamp(-MAX_CORRELATION, MAX_CORRELATION);
        for k in 1..row.len() {
            whitened[(i, k)] = row[k] - a * row[k - 1];
        }
        whitened[(i, 0)] = row[0] * (1.0 - a * a).sqrt();
        gains[i] = 1.0 / (1.0 - a);
    }
    (whitened, gains)
}

/// Lags for Bartlett's window: `1.1447 (s1^2 / s0^2)^(1/3) m^(1/3)`, `s0` and `s1` the sums of the autocovariance and of lag times it over
/// `4 (m / 100)^(2/9)` lags (Newey and West 1994), here over all scores, each divided by its variance.
fn bandwidth(scores: &DMatrix<f64>) -> usize {
    let m = scores.ncols();
    let first = ((4.0 * (m as f64 / 100.0).powf(2.0 / 9.0)).ceil() as usize).min(m.saturating_sub(1));
    let (mut s0, mut s1) = (0.0, 0.0);
    for row in scores.row_iter() {
        let row: Vec<f64> = row.iter().copied().collect();
        let variance: f64 = row.iter().map(|x| x * x).sum();
        if variance <= 0.0 {
            continue;
        }
        s0 += 1.0;
        for lag in 1..=first {
            let sum: f64 = row.iter().zip(&row[lag..]).map(|(a, b)| a * b).sum::<f64>() / variance;
            s0 += 2.0 * sum;
            s1 += 2.0 * lag as f64 * sum;
        }
    }
    let ratio = if s0.abs() > 0.0 { (s1 / s0).powi(2) } else { 0.0 };
    let lags = (1.1447 * (ratio * m as f64).cbrt()).round() as usize;
    // An upper bound: more lags average too few terms.
    lags.min(m / 4)
}

/// Symmetric part, which removes the rounding error.
fn symmetric(covariance: &DMatrix<f64>) -> DMatrix<f64> {
    (covariance + covariance.transpose()) * 0.5
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::periods::average;
    use crate::signal::spectral::Spectral;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    /// A fixed map of 2 x 8 samples, every fifth of 40, to 3 parameters.
    fn map() -> (DMatrix<f64>, Vec<usize>) {
        (DMatrix::from_fn(3, 16, |i, k| ((i * 7 + k * 3) as f64).sin()), (0..8).map(|k| 5 * k).collect())
    }

    #[test]
    fn the_spectrum_gives_the_covariance_of_the_mapped_noise() {
        // Two joints whose noise shares a part, coloured in time.
        let (periods, samples) = (6, 40);
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut x = [0.0; 2];
        let values = DMatrix::from_fn(2, periods * samples, |j, _| {
            let unit: f64 = rng.sample(StandardNormal);
            x[j] = 0.7 * x[j] + unit + if j == 1 { 0.8 * x[0] } else { 0.0 };
            x[j]
        });
        let averaged = average(&values.transpose(), &vec![samples as f64 / 240.0; 240], &[], samples, 0.1);
        let gain = |f: f64| 1.0 / (1.0 + f * f);
        let noise = NoiseOfMean::of(&averaged.deviations, &averaged.counted, samples, 0.1, gain);
        let (b, at) = map();
        let found = between_periods(&b, &at, &noise).covariance;

        // Second route: filter every period's deviation, map it, and compute the scatter of the result.
        let mut spectral = Spectral::new(samples, 0.1);
        let mut expected = DMatrix::zeros(3, 3);
        // The process is circular: average over all shifts of the period.
        for shift in 0..samples {
            for p in 0..periods {
                let mut filtered = Vec::new();
                for j in 0..2 {
                    let column = averaged.deviations.column(j);
                    let whole = spectral.filter(&column.as_slice()[p * samples..(p + 1) * samples], gain);
                    filtered.extend(at.iter().map(|&k| whole[(k + shift) % samples]));
                }
                let mapped = &b * DVector::from_vec(filtered);
                expected += &mapped * mapped.transpose() / (samples * periods * (periods - 1)) as f64;
            }
        }
        let scale = expected.abs().max();
        assert!((&found - &expected).abs().max() < 1e-5 * scale, "{found} {expected}");
    }

    #[test]
    fn degrees_of_freedom_increase_with_the_number_of_frequencies() {
        let samples = 40;
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let values = DMatrix::from_fn(5 * samples, 2, |_, _| rng.sample::<f64, _>(StandardNormal));
        let averaged = average(&values, &vec![samples as f64 / 200.0; 200], &[], samples, 0.1);
        let noise = NoiseOfMean::of(&averaged.deviations, &averaged.counted, samples, 0.1, |_| 1.0);
        // One parameter at a single frequency (two sides, four periods beyond the mean, in each of two joints), one at all of them.
        let at: Vec<usize> = (0..samples).collect();
        let wave = |k: usize| (2.0 * PI * 3.0 * k as f64 / samples as f64).sin();
        let b = DMatrix::from_fn(2, samples, |i, k| if i == 0 { wave(k) } else { f64::from(k == 7) });
        let one_joint = NoiseOfMean {
            bins: noise.bins.iter().map(|(bin, power)| (*bin, power.view((0, 0), (1, 1)).into_owned())).collect(),
            ..noise
        };
        let freedom = between_periods(&b, &at, &one_joint).freedom;
        assert!((freedom[0] - 8.0).abs() < 1e-6, "{freedom:?}");
        assert!((60.0..161.0).contains(&freedom[1]), "{freedom:?}");
    }

    #[test]
    fn newey_west_of_white_noise_agrees_with_the_textbook_covariance() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let (m, n) = (4000, 2);
        let w = DMatrix::from_fn(n * m, 3, |k, c| ((k * (c + 1)) as f64 * 0.0037).cos());
        let inverse = (w.transpose() * &w).try_inverse().unwrap();
        let b = &inverse * w.transpose();
        let residual: Vec<f64> = (0..n * m).map(|_| 0.2 * rng.sample::<f64, _>(StandardNormal)).collect();
        let found = newey_west(&b, &residual, m).covariance;
        for c in 0..3 {
            let ratio = found[(c, c)] / (0.04 * inverse[(c, c)]);
            assert!((0.75..1.3).contains(&ratio), "{ratio}");
        }
    }

    #[test]
    fn slow_noise_is_not_taken_for_less() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (m, pole, draws) = (600, 0.9, 100);
        // The mean of noise of first order: its variance is `1 / (m (1 - pole)^2)`.
        let b = DMatrix::from_element(1, m, 1.0 / m as f64);
        let expected = 1.0 / (m as f64 * (1.0 - pole) * (1.0 - pole));
        let mut x: f64 = 0.0;
        let mut found = || {
            let noise = std::iter::repeat_with(|| {
                x = pole * x + rng.sample::<f64, _>(StandardNormal);
                x
            });
            let residual: Vec<f64> = noise.take(m).collect();
            newey_west(&b, &residual, m).covariance[(0, 0)] / expected
        };
        let mean = (0..draws).map(|_| found()).sum::<f64>() / f64::from(draws);
        // By the window alone 0.57.
        assert!((0.9..1.15).contains(&mean), "{mean}");
    }

    #[test]
    fn lags_increase_with_the_correlation_of_the_scores() {
        let mut rng = ChaCha8Rng::seed_from_u64(6);
        let mut lags = |pole: f64| {
            let mut x = 0.0;
            bandwidth(&DMatrix::from_fn(1, 2000, |_, _| {
                x = pole * x + rng.sample::<f64, _>(StandardNormal);
                x
            }))
        };
        let (white, coloured) = (lags(0.0), lags(0.8));
        assert!(white < 12 && coloured > 12, "{white} {coloured}");
    }

    #[test]
    fn independent_contributions_add_up() {
        let one = |variance: f64, freedom: f64| Spread {
            covariance: DMatrix::from_element(1, 1, variance),
            freedom: vec![freedom],
        };
        let sum = one(1.0, 8.0).plus(&one(1.0, 8.0));
        assert_eq!((sum.covariance[(0, 0)], sum.freedom[0]), (2.0, 16.0));
        assert_eq!(Spread::zero(1).plus(&one(2.0, 5.0)).freedom, [5.0]);
    }
}
