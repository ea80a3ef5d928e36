//! Power of the residual by frequency: what the torque and velocity sensors and everything that the model lacks leave over without contact.

use super::filter::Residue;
use crate::signal::spectral::Spectral;
use plumbline_core::MAX_JOINTS;
use std::f64::consts::{PI, SQRT_2};

/// Upper end of the lowest band \[Hz\]; each of the others ends at sqrt(2) times its lower end.
const LOWEST_BAND_HZ: f64 = 0.25;
/// Length of the segments whose spectra are averaged \[s\].
const SEGMENT_S: f64 = 8.0;
/// Points of an integral over a band.
const POINTS: usize = 8;

/// Power of `tau - tau_model`, in the mean of two samples, in bands of frequency, per joint.
///
/// The bands are 0 to 0.25 Hz and then half octaves, 0.25 to 0.354 Hz and so on, up to half the sampling rate. Within a band the density is
/// constant. The powers of a joint add up to the mean square of its residual.
#[derive(Clone, Debug, PartialEq)]
pub struct ResidualSpectrum {
    /// Sampling rate of the recording \[Hz\].
    pub rate: f64,
    /// Power per joint and band, n rows \[Nm^2\].
    pub power: Vec<Vec<f64>>,
}

/// Standard deviation and rate of zero crossings of a joint's residual behind a low-pass.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Noise {
    /// \[Nm\].
    pub std: f64,
    /// Crossings of zero upwards of a Gaussian signal of this spectrum (Rice 1945) \[1/s\].
    pub crossings: f64,
}

impl ResidualSpectrum {
    /// Lower and upper ends of the bands of a sampling rate \[Hz\].
    pub fn bands(rate: f64) -> impl Iterator<Item = [f64; 2]> {
        let nyquist = 0.5 * rate;
        let end = |k: i32| if k < 0 { 0.0 } else { LOWEST_BAND_HZ * SQRT_2.powi(k) };
        (-1..).map(move |k| [end(k), end(k + 1).min(nyquist)]).take_while(move |[low, _]| *low < nyquist)
    }

    /// Spectrum of residuals of several recordings, one list of joints each, sampled at `rate` \[Hz\]; `None` where none has 16 samples.
    ///
    /// Mean of the periodograms of segments of 8 s that overlap by half, weighted by a Hann window (Welch 1967). The mean of the residual is part
    /// of the lowest band.
    pub fn of(recordings: &[Vec<Vec<f64>>], rate: f64) -> Option<ResidualSpectrum> {
        let bands: Vec<[f64; 2]> = ResidualSpectrum::bands(rate).collect();
        let joints = recordings.first()?.len();
        let mut power = vec![vec![0.0; bands.len()]; joints];
        let mut segments = 0.0;
        for recording in recordings {
            let samples = recording.first().map_or(0, Vec::len);
            let length = ((SEGMENT_S * rate) as usize).min(samples);
            if length < 16 {
                continue;
            }
            let hann = |k: usize| 1.0 - (2.0 * PI * (k as f64 + 0.5) / length as f64).cos();
            let weight: f64 = (0..length).map(|k| hann(k).powi(2)).sum();
            let spectral = Spectral::new(length, 1.0 / rate);
            for first in (0..=samples - length).step_by((length / 2).max(1)) {
                segments += 1.0;
                for (residual, power) in recording.iter().zip(&mut power) {
                    let windowed: Vec<f64> = (0..length).map(|k| hann(k) * residual[first + k]).collect();
                    for (m, value) in spectral.transform(&windowed).iter().enumerate() {
                        let sides = if m == 0 || 2 * m == length { 1.0 } else { 2.0 };
                        let f = spectral.frequency(m);
                        let band = bands.iter().position(|[_, high]| f < *high).unwrap_or(bands.len() - 1);
                        power[band] += sides * value.norm_sqr() / (weight * length as f64);
                    }
                }
            }
        }
        (segments > 0.0).then(|| {
            power.iter_mut().flatten().for_each(|value| *value /= segments);
            ResidualSpectrum { rate, power }
        })
    }

    /// The residual of each joint behind a low-pass; zero past the joints. Power above half the recording's rate is unknown and taken as none.
    /// Neither allocates nor panics.
    pub fn behind(&self, filter: &Residue) -> [Noise; MAX_JOINTS] {
        // Variance of the signal and of its rate of change.
        let mut sums = [[0.0; 2]; MAX_JOINTS];
        for (band, [low, high]) in ResidualSpectrum::bands(self.rate).enumerate() {
            let points = (0..POINTS).map(|i| low + (high - low) * (i as f64 + 0.5) / POINTS as f64);
            let gains = points.fold([0.0; 2], |[signal, rate], f| {
                let gain = filter.power_gain(f) / POINTS as f64;
                [signal + gain, rate + gain * (2.0 * PI * f).powi(2)]
            });
            for (sums, power) in sums.iter_mut().zip(&self.power) {
                let power = power.get(band).copied().unwrap_or_default();
                sums.iter_mut().zip(gains).for_each(|(sum, gain)| *sum += power * gain);
            }
        }
        sums.map(|[variance, of_rate]: [f64; 2]| {
            let crossings = if variance > 0.0 { (of_rate / variance).sqrt() / (2.0 * PI) } else { 0.0 };
            Noise { std: variance.sqrt(), crossings }
        })
    }
}

impl Noise {
    /// Threshold in standard deviations that a Gaussian residual exceeds on either side `rate` times a second: `sqrt(2 ln(2 nu / rate))` with `nu`
    /// the zero crossings upwards (Rice 1945). At least 1.
    pub fn threshold(&self, rate: f64) -> f64 {
        (2.0 * (2.0 * self.crossings / rate).ln()).max(1.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::super::filter::Memory;
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    /// White noise and an AR(1) process, in the mean of two samples: standard deviation and crossings behind a filter are those of the filtered record.
    #[test]
    fn the_noise_behind_a_filter_is_that_of_the_filtered_record() {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut normal = || rng.sample::<f64, _>(StandardNormal);
        let (mut slow, samples) = (0.0, 400_000);
        let raw: Vec<[f64; 2]> = (0..samples)
            .map(|_| {
                slow = 0.99 * slow + 0.02 * normal();
                [0.15 * normal(), slow]
            })
            .collect();
        let mean = |j: usize| raw.windows(2).map(|two| 0.5 * (two[0][j] + two[1][j])).collect::<Vec<_>>();
        let spectrum = ResidualSpectrum::of(&[vec![mean(0), mean(1)]], 1000.0).unwrap();
        for cutoff in [5.0, 20.0, 60.0] {
            let filter = Residue::new(cutoff, 1e-3).unwrap();
            for (j, noise) in spectrum.behind(&filter).into_iter().take(2).enumerate() {
                let (mut memory, mut last, mut squares, mut crossings) = (Memory::default(), 0.0, 0.0, 0.0);
                for raw in &raw {
                    let y = filter.next(&mut memory, raw[j], 0.0);
                    squares += y * y;
                    crossings += f64::from(u8::from(last < 0.0 && y >= 0.0));
                    last = y;
                }
                let std = (squares / f64::from(samples)).sqrt();
                assert!((noise.std / std - 1.0).abs() < 0.04, "{cutoff} Hz, {j}: {} {std}", noise.std);
                let rate = crossings / (f64::from(samples) * 1e-3);
                assert!((noise.crossings / rate - 1.0).abs() < 0.12, "{cutoff} Hz, {j}: {} {rate}", noise.crossings);
            }
        }
    }

    /// The powers add up to the mean square, a mean in the lowest band.
    #[test]
    fn powers_add_up_and_bands_are_half_octaves() {
        let wave = |k: usize, f: f64| (2.0 * PI * f * k as f64 * 1e-3).sin();
        let residual: Vec<f64> = (0..60_000).map(|k| 0.3 + wave(k, 10.0) + 0.1 * wave(k, 300.0)).collect();
        let spectrum = ResidualSpectrum::of(&[vec![residual]], 1000.0).unwrap();
        let bands: Vec<[f64; 2]> = ResidualSpectrum::bands(1000.0).collect();
        assert_eq!((bands[0], bands[1][0], bands.last().unwrap()[1]), ([0.0, 0.25], 0.25, 500.0));
        let power = &spectrum.power[0];
        let of = |f: f64| power[bands.iter().position(|[low, high]| (*low..*high).contains(&f)).unwrap()];
        for (found, expected) in [(of(0.0), 0.09), (of(10.0), 0.5), (of(300.0), 0.005)] {
            assert!((found / expected - 1.0).abs() < 0.01, "{found} {expected}");
        }
        assert!((power.iter().sum::<f64>() - 0.595).abs() < 2e-3);
        assert_eq!(ResidualSpectrum::of(&[vec![vec![1.0; 10]]], 1000.0), None);
    }

    #[test]
    fn a_threshold_is_exceeded_as_often_as_stated() {
        let noise = Noise { std: 1.0, crossings: 20.0 };
        let u = noise.threshold(1.0 / 3600.0);
        assert!((2.0 * 20.0 * (-0.5 * u * u).exp() * 3600.0 - 1.0).abs() < 1e-9, "{u}");
        assert_eq!(Noise::default().threshold(1.0), 1.0);
    }
}
