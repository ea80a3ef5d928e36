//! Filters and derivatives of one period of a periodic signal, exact for every frequency below half the sampling rate.

use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::f64::consts::PI;
use std::fmt;
use std::sync::Arc;

/// Real Fourier transform of signals of one length.
pub struct Spectral {
    forward: Arc<dyn RealToComplex<f64>>,
    inverse: Arc<dyn ComplexToReal<f64>>,
    samples: usize,
    dt: f64,
}

impl fmt::Debug for Spectral {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.debug_struct("Spectral").field("samples", &self.samples).field("dt", &self.dt).finish_non_exhaustive()
    }
}

impl Spectral {
    /// Transform of periods of `samples` samples, `dt` apart \[s\].
    pub fn new(samples: usize, dt: f64) -> Spectral {
        let mut planner = RealFftPlanner::new();
        Spectral { forward: planner.plan_fft_forward(samples), inverse: planner.plan_fft_inverse(samples), samples, dt }
    }

    /// Number of frequencies, 0 Hz to half the sampling rate.
    pub fn bins(&self) -> usize {
        self.samples / 2 + 1
    }

    /// Frequency of a bin \[Hz\].
    pub fn frequency(&self, bin: usize) -> f64 {
        bin as f64 / (self.samples as f64 * self.dt)
    }

    /// `X[m] = sum_k x[k] exp(-2 pi i m k / N)` for the bins up to half the sampling rate. `x` has the planned length.
    pub fn transform(&self, x: &[f64]) -> Vec<Complex<f64>> {
        let mut input = x.to_vec();
        let mut spectrum = self.forward.make_output_vec();
        self.forward.process(&mut input, &mut spectrum).expect("planned length");
        spectrum
    }

    /// The signal of a spectrum, the inverse of [`Spectral::transform`].
    pub fn signal(&self, mut spectrum: Vec<Complex<f64>>) -> Vec<f64> {
        // A real signal has real values at 0 Hz and, for an even length, at half the rate.
        spectrum[0].im = 0.0;
        if self.samples.is_multiple_of(2) {
            spectrum[self.samples / 2].im = 0.0;
        }
        let mut x = self.inverse.make_output_vec();
        self.inverse.process(&mut spectrum, &mut x).expect("planned length");
        let scale = 1.0 / self.samples as f64;
        x.iter_mut().for_each(|value| *value *= scale);
        x
    }

    /// Zero-phase filter: multiplies the spectrum by a real gain of the frequency \[Hz\].
    pub fn filter(&mut self, x: &[f64], gain: impl Fn(f64) -> f64) -> Vec<f64> {
        self.scaled(x, |bin| gain(self.frequency(bin)))
    }

    /// The same by a gain of the bin.
    pub fn scaled(&self, x: &[f64], gain: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut spectrum = self.transform(x);
        spectrum.iter_mut().enumerate().for_each(|(bin, value)| *value *= gain(bin));
        self.signal(spectrum)
    }

    /// The signal itself and its first two derivatives after a filter of the given gain, `(x, dx/dt, d2x/dt2)`.
    pub fn derivatives(&mut self, x: &[f64], gain: impl Fn(f64) -> f64) -> [Vec<f64>; 3] {
        let spectrum: Vec<_> =
            self.transform(x).into_iter().enumerate().map(|(m, value)| value * gain(self.frequency(m))).collect();
        let omega = |m: usize| 2.0 * PI * self.frequency(m);
        let mut first: Vec<_> =
            spectrum.iter().enumerate().map(|(m, value)| value * Complex::new(0.0, omega(m))).collect();
        // The first derivative of the component at half the rate is zero at the samples.
        if self.samples.is_multiple_of(2) {
            first[self.samples / 2] = Complex::new(0.0, 0.0);
        }
        let second: Vec<_> = spectrum.iter().enumerate().map(|(m, value)| value * -(omega(m) * omega(m))).collect();
        [self.signal(spectrum), self.signal(first), self.signal(second)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_of_a_fourier_series_are_exact() {
        for samples in [997, 1000] {
            let dt = 2.0 / samples as f64;
            let w = PI;
            let t = |k: usize| k as f64 * dt;
            let x: Vec<f64> = (0..samples).map(|k| 0.3 + (w * t(k)).sin() - 0.4 * (7.0 * w * t(k)).cos()).collect();
            let [same, first, second] = Spectral::new(samples, dt).derivatives(&x, |_| 1.0);
            for k in 0..samples {
                let dx = w * (w * t(k)).cos() + 2.8 * w * (7.0 * w * t(k)).sin();
                let ddx = -w * w * (w * t(k)).sin() + 19.6 * w * w * (7.0 * w * t(k)).cos();
                assert!((same[k] - x[k]).abs() < 1e-12);
                assert!((first[k] - dx).abs() < 1e-10, "{samples}: {} {dx}", first[k]);
                assert!((second[k] - ddx).abs() < 1e-7);
            }
        }
    }

    #[test]
    fn an_ideal_low_pass_keeps_lower_frequencies() {
        let samples = 500;
        let low = |k: usize| (2.0 * PI * 3.0 * k as f64 / 500.0).sin();
        let x: Vec<f64> = (0..samples).map(|k| low(k) + (2.0 * PI * 40.0 * k as f64 / 500.0).cos()).collect();
        let y = Spectral::new(samples, 1.0 / 500.0).filter(&x, |f| if f < 10.0 { 1.0 } else { 0.0 });
        assert!((0..samples).all(|k| (y[k] - low(k)).abs() < 1e-12));
    }
}
