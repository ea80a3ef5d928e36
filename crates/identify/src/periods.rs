//! Mean period of a periodic run, and the scatter between the periods: the noise floor.

use super::signal::spectral::Spectral;
use super::signal::time_to_nearest;
use nalgebra::DMatrix;
use realfft::num_complex::Complex;

/// Time over which a period fades out of the mean before samples that are left out, and in after them \[s\].
const FADE_S: f64 = 0.5;

/// Where the periods have less weight than this together, those that are left out there have the rest.
const MIN_WEIGHT: f64 = 0.05;

/// The power of noise is averaged over frequencies from `f / 1.3` to `1.3 f`,
const SMOOTHING_RATIO: f64 = 1.3;
/// and over as many more as have this many degrees of freedom together.
const MIN_FREEDOM: f64 = 30.0;

/// Mean of P periods and their scatter.
#[derive(Clone, Debug)]
pub struct Averaged {
    /// The mean period, N x columns.
    pub mean: DMatrix<f64>,
    /// The scatter; `None` for a single period.
    pub scatter: Option<Scatter>,
    /// Every period minus the mean, one below the other, P N x columns; no rows for a single period.
    pub deviations: DMatrix<f64>,
    /// Whether a row is in the mean, P N; the deviations of the others are zero.
    pub counted: Vec<bool>,
}

/// Deviations of the periods from their mean, as a spectrum.
#[derive(Clone, Debug)]
pub struct Scatter {
    /// Number of periods, P.
    pub periods: usize,
    /// Number of periods whose mean would have the noise that this one has, `1 / mean_k(1 / P_k)` with the number `P_k` of periods that count at a sample: the
    /// start of a run that is not settled and what else is left out does not count.
    pub averaged: f64,
    /// Degrees of freedom of the power at one frequency, `mean_k(P_k - 1)`; twice as many where it stands for its negative, too.
    pub freedom: f64,
    /// Standard deviation of one raw sample as recorded, per column: the noise floor.
    pub std: Vec<f64>,
    /// Power of one period's noise, bins x columns, `sum_p |DFT(deviation_p)|^2 / (N (P - 1))`, for 0 Hz to half the rate.
    /// Excluded samples are subtracted from `N P`.
    pub power: DMatrix<f64>,
    /// Power of errors that every period repeats, so that no scatter shows them and no mean removes them, like [`Scatter::power`].
    pub repeated: DMatrix<f64>,
    /// Samples of a period, N.
    pub samples: usize,
    /// Time between samples \[s\].
    pub dt: f64,
}

/// Averages `values` (rows in time) over its whole periods of `samples` rows with these [`weights`]; a partial period at the end is ignored. There
/// must be at least one whole period. Rows that are `filled`, or no period like the others, tell nothing of the scatter. `dt`: time between samples \[s\].
pub fn average(values: &DMatrix<f64>, weights: &[f64], filled: &[bool], samples: usize, dt: f64) -> Averaged {
    let periods = values.nrows() / samples;
    assert!(periods > 0, "no whole period of {samples} samples in {}", values.nrows());
    let columns = values.ncols();
    let mean = mean(values, weights, samples);
    let counted: Vec<bool> = weights.iter().map(|weight| *weight > 0.0).collect();
    if periods < 2 {
        return Averaged { mean, scatter: None, deviations: DMatrix::zeros(0, columns), counted };
    }
    let deviations = DMatrix::from_fn(periods * samples, columns, |row, c| {
        if counted[row] { values[(row, c)] - mean[(row % samples, c)] } else { 0.0 }
    });
    let scatter = if filled.contains(&true) {
        let (mut measured, mut told) = (deviations.clone(), counted.clone());
        told.iter_mut().zip(filled).for_each(|(told, filled)| *told &= !filled);
        centre(&mut measured, &told, samples);
        Scatter::of(&measured, &told, samples, dt)
    } else {
        Scatter::of(&deviations, &counted, samples, dt)
    };
    Averaged { mean, scatter: Some(scatter), deviations, counted }
}

/// Mean of periods of `samples` rows with these [`weights`], samples x columns.
pub fn mean(values: &DMatrix<f64>, weights: &[f64], samples: usize) -> DMatrix<f64> {
    let mut mean = DMatrix::zeros(samples, values.ncols());
    for (row, weight) in weights.iter().enumerate() {
        for c in 0..values.ncols() {
            mean[(row % samples, c)] += weight * values[(row, c)];
        }
    }
    mean
}

/// Weight of every row in the mean over its periods, one in sum for each sample of a period.
///
/// Rows that are `left_out` count nowhere but where all periods are; of these `unusable` ones not there either if there are others, and of the unusable
/// ones the `lost` ones never. Periods differ a little, so a period fades out before rows that are left out and in after them: a step in the mean of
/// the positions would be a blow in its accelerations. The end of the record adjoins its start, as the end of the mean does.
pub fn weights(left_out: &[bool], unusable: &[bool], lost: &[bool], samples: usize, dt: f64) -> Vec<f64> {
    let periods = left_out.len() / samples;
    let quintic = |x: f64| x.powi(3) * (10.0 - 15.0 * x + 6.0 * x * x);
    let faded = |out: &dyn Fn(usize) -> bool| {
        let times = time_to_nearest(periods * samples, dt, true, out).into_iter();
        times.map(|time| quintic((time / FADE_S).min(1.0))).collect::<Vec<f64>>()
    };
    let mut weights = faded(&|row| left_out[row]);
    let at_need = faded(&|row| unusable[row]);
    let at_last = faded(&|row| lost[row]);
    for k in 0..samples {
        let own = || (0..periods).map(|p| p * samples + k);
        let open = 1.0 - own().map(|row| at_need[row]).sum::<f64>();
        let missing = MIN_WEIGHT - own().map(|row| weights[row]).sum::<f64>();
        own().filter(|&row| left_out[row] && missing > 0.0).for_each(|row| weights[row] = missing * at_need[row]);
        own().for_each(|row| weights[row] += open.max(0.0) * at_last[row]);
        let total: f64 = own().map(|row| weights[row]).sum();
        own().for_each(|row| weights[row] = if total > 0.0 { weights[row] / total } else { 1.0 / periods as f64 });
    }
    weights
}

/// [`Scatter::averaged`] and [`Scatter::freedom`], that at least of one sample, of periods of which these samples count.
fn averaged(counted: &[bool], samples: usize) -> (f64, f64) {
    let numbers = (0..samples).map(|k| counted.iter().skip(k).step_by(samples).filter(|counted| **counted).count());
    let (mut inverse, mut counting, mut freedom) = (0.0, 0, 0);
    for number in numbers.filter(|number| *number > 0) {
        inverse += 1.0 / number as f64;
        counting += 1;
        freedom += number - 1;
    }
    (f64::from(counting.max(1)) / f64::max(inverse, f64::MIN_POSITIVE), freedom.max(1) as f64 / samples as f64)
}

/// Subtracts from every sample of a period the mean over the counted periods, and sets the other rows to zero. `deviations`, P N x columns.
pub fn centre(deviations: &mut DMatrix<f64>, counted: &[bool], samples: usize) {
    let periods = counted.len() / samples;
    for mut column in deviations.column_iter_mut() {
        for k in 0..samples {
            let rows = || (0..periods).map(|p| p * samples + k);
            let used = rows().filter(|&row| counted[row]);
            let (sum, count) = used.fold((0.0, 0.0), |(sum, count), row| (sum + column[row], count + 1.0));
            let mean = sum / f64::max(count, 1.0);
            rows().for_each(|row| column[row] = if counted[row] { column[row] - mean } else { 0.0 });
        }
    }
}

/// Spectrum of the noise of the mean of P periods after a filter, with correlations between columns.
#[derive(Clone, Debug)]
pub struct NoiseOfMean {
    /// Degrees of freedom of the power at one frequency, see [`Scatter::freedom`].
    pub freedom: f64,
    /// Samples of a period, N.
    pub samples: usize,
    /// Per frequency that the filter passes, its bin and `sum_p D_p D_p^H / (P (P - 1) N)` with `D_p` the filtered deviations' DFT,
    /// columns x columns; `P` is [`Scatter::averaged`], and `P - 1` [`Scatter::freedom`].
    pub bins: Vec<(usize, DMatrix<Complex<f64>>)>,
}

impl NoiseOfMean {
    /// Minimum gain: frequencies with a smaller gain are ignored.
    const MIN_GAIN: f64 = 1e-6;

    /// Noise of the mean from deviations as in [`Averaged`], `dt` apart \[s\], after a filter with zero-phase `gain` of the frequency \[Hz\].
    pub fn of(
        deviations: &DMatrix<f64>,
        counted: &[bool],
        samples: usize,
        dt: f64,
        gain: impl Fn(f64) -> f64,
    ) -> NoiseOfMean {
        let (periods, columns) = (deviations.nrows() / samples, deviations.ncols());
        assert!(periods > 1 && deviations.nrows() == periods * samples, "whole periods, two or more");
        let spectral = Spectral::new(samples, dt);
        let gains: Vec<(usize, f64)> = (0..spectral.bins())
            .map(|bin| (bin, gain(spectral.frequency(bin))))
            .filter(|(_, gain)| *gain > NoiseOfMean::MIN_GAIN)
            .collect();
        let (averaged, freedom) = averaged(counted, samples);
        let scale = 1.0 / (averaged * freedom * samples as f64);
        let mut bins: Vec<_> = gains.iter().map(|&(bin, _)| (bin, DMatrix::zeros(columns, columns))).collect();
        for p in 0..periods {
            let spectra: Vec<Vec<Complex<f64>>> = (0..columns)
                .map(|c| spectral.transform(&deviations.column(c).as_slice()[p * samples..(p + 1) * samples]))
                .collect();
            for ((bin, power), (_, gain)) in bins.iter_mut().zip(&gains) {
                for i in 0..columns {
                    for k in 0..columns {
                        power[(i, k)] += spectra[i][*bin] * spectra[k][*bin].conj() * (scale * gain * gain);
                    }
                }
            }
        }
        NoiseOfMean { freedom, samples, bins }
    }
}

impl Scatter {
    /// Of deviations from the mean as in [`Averaged`], `dt` apart \[s\].
    pub fn of(deviations: &DMatrix<f64>, counted: &[bool], samples: usize, dt: f64) -> Scatter {
        let columns = deviations.ncols();
        let spectral = Spectral::new(samples, dt);
        let mut power = DMatrix::zeros(spectral.bins(), columns);
        let mut std = vec![0.0; columns];
        let (averaged, freedom) = averaged(counted, samples);
        let scale = 1.0 / (freedom * samples as f64);
        for (c, column) in deviations.column_iter().enumerate() {
            std[c] = (scale * column.norm_squared()).sqrt();
            for deviation in column.as_slice().chunks(samples) {
                for (m, value) in spectral.transform(deviation).iter().enumerate() {
                    power[(m, c)] += scale * value.norm_sqr();
                }
            }
        }
        let repeated = DMatrix::zeros(power.nrows(), columns);
        Scatter { periods: counted.len() / samples, averaged, freedom, std, power, repeated, samples, dt }
    }

    /// Power of the mean's noise in a bin.
    pub fn power_of_mean(&self, bin: usize, column: usize) -> f64 {
        self.power[(bin, column)] / self.averaged + self.repeated[(bin, column)]
    }

    /// Autocovariance of the mean's noise after a filter of the given zero-phase gain (of the frequency in Hz), at lags of
    /// 0 to N - 1 samples. It is circular: the end of a period adjoins the start of the next.
    pub fn autocovariance_of_mean(&self, column: usize, gain: impl Fn(f64) -> f64) -> Vec<f64> {
        let spectral = Spectral::new(self.samples, self.dt);
        let spectrum = (0..spectral.bins())
            .map(|m| self.power_of_mean(m, column) * gain(spectral.frequency(m)).powi(2))
            .map(|power| power.into())
            .collect();
        spectral.signal(spectrum)
    }

    /// Standard deviation of the mean's noise after a filter, per column.
    pub fn std_of_mean(&self, gain: impl Fn(f64) -> f64) -> Vec<f64> {
        (0..self.std.len()).map(|c| self.autocovariance_of_mean(c, &gain)[0].max(0.0).sqrt()).collect()
    }

    /// The scatter of some of the columns.
    pub fn select(&self, columns: std::ops::Range<usize>) -> Scatter {
        Scatter {
            std: self.std[columns.clone()].to_vec(),
            power: self.power.columns(columns.start, columns.len()).into_owned(),
            repeated: self.repeated.columns(columns.start, columns.len()).into_owned(),
            ..self.clone()
        }
    }
}

/// Power of the noise by frequency, from several recordings together.
#[derive(Clone, Debug)]
pub struct NoisePower {
    recordings: Vec<Recording>,
}

#[derive(Clone, Debug)]
struct Recording {
    /// Distance of its frequencies \[Hz\].
    width: f64,
    /// Degrees of freedom of the power at one frequency.
    freedom: f64,
    /// Sums of the power at all frequencies below one, times the time between samples \[s\]: of one period, and of what every period repeats.
    below: [Vec<f64>; 2],
}

impl NoisePower {
    /// Of one column of their scatter.
    pub fn of(scatters: &[&Scatter], column: usize) -> NoisePower {
        let recording = |scatter: &&Scatter| {
            let sums = |power: &DMatrix<f64>| {
                let sum = |sum: &mut f64, power: &f64| {
                    *sum += power * scatter.dt;
                    Some(*sum)
                };
                [0.0].into_iter().chain(power.column(column).iter().scan(0.0, sum)).collect()
            };
            Recording {
                width: 1.0 / (scatter.samples as f64 * scatter.dt),
                freedom: 2.0 * scatter.freedom,
                below: [sums(&scatter.power), sums(&scatter.repeated)],
            }
        };
        NoisePower { recordings: scatters.iter().map(recording).collect() }
    }

    /// Means over the frequencies near `frequency` \[Hz\], in the units of [`Scatter::power`] for samples `dt` apart \[s\]: of the scatter of one period, and of
    /// what every period repeats.
    pub fn at(&self, frequency: f64, dt: f64) -> [f64; 2] {
        for more in 0.. {
            let (mut powers, mut freedom, mut whole) = ([0.0; 2], 0.0, true);
            for Recording { width, freedom: own, below } in &self.recordings {
                let bins = below[0].len() - 1;
                let bin = |frequency: f64| ((frequency / width).round() as usize).min(bins - 1);
                let low = bin(frequency / SMOOTHING_RATIO).saturating_sub(more);
                let high = (bin(frequency * SMOOTHING_RATIO).max(low + 1) + more).min(bins - 1);
                for (power, below) in powers.iter_mut().zip(below) {
                    *power += own * (below[high + 1] - below[low]) / dt;
                }
                freedom += own * (high + 1 - low) as f64;
                whole &= low == 0 && high == bins - 1;
            }
            if freedom >= MIN_FREEDOM || whole {
                return powers.map(|power| power / freedom.max(f64::MIN_POSITIVE));
            }
        }
        unreachable!("the whole spectrum is the widest")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    fn equal(periods: usize, samples: usize) -> Vec<f64> {
        vec![1.0 / periods as f64; periods * samples]
    }

    fn noise(rng: &mut ChaCha8Rng) -> f64 {
        StandardNormal.sample(rng)
    }

    /// First-order noise of standard deviation 0.2 and pole 0.9 on a known period, and white noise of 0.05.
    fn record(seed: u64, periods: usize, samples: usize) -> DMatrix<f64> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut x = 0.0;
        DMatrix::from_fn(periods * samples + 7, 2, |k, c| {
            let clean = ((k % samples) as f64 * 0.01).sin();
            let unit = noise(&mut rng);
            if c == 0 {
                clean + 0.05 * unit
            } else {
                x = 0.9 * x + 0.2 * (1.0 - 0.81_f64).sqrt() * unit;
                clean + x
            }
        })
    }

    /// Of three periods the first two have half and a quarter left out: the mean has the noise of two samples there, and of one.
    #[test]
    fn what_is_left_out_of_some_periods_is_in_no_mean_and_leaves_its_noise() {
        let (periods, samples, draws) = (3, 400, 200);
        let uncounted = |row: usize| row < 200 || (samples..samples + 100).contains(&row);
        let weights: Vec<f64> = (0..periods * samples)
            .map(|row| {
                let own = (row % samples..periods * samples).step_by(samples);
                let number = own.filter(|row| !uncounted(*row)).count() as f64;
                if uncounted(row) { 0.0 } else { 1.0 / number }
            })
            .collect();
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let (mut expected, mut found, mut square) = (0.0, 0.0, 0.0);
        for _ in 0..draws {
            let values = DMatrix::from_fn(periods * samples, 1, |_, _| noise(&mut rng));
            let averaged = average(&values, &weights, &[], samples, 1e-3);
            let of_mean = NoiseOfMean::of(&averaged.deviations, &averaged.counted, samples, 1e-3, |_| 1.0);
            let sides = |bin: usize| if bin == 0 || 2 * bin == samples { 1.0 } else { 2.0 };
            let power = of_mean.bins.iter().map(|(bin, power)| sides(*bin) * power[(0, 0)].re);
            expected += power.sum::<f64>() / samples as f64;
            found += averaged.scatter.unwrap().std_of_mean(|_| 1.0)[0].powi(2);
            square += averaged.mean.norm_squared() / samples as f64;
        }
        // 1/3 of the variance in the second half of a period, 1/2 in the second quarter, all of it in the first.
        assert!((square / f64::from(draws) - (0.5 / 3.0 + 0.25 / 2.0 + 0.25)).abs() < 0.01, "{square}");
        for known in [expected, found] {
            assert!((known / square - 1.0).abs() < 0.02, "{known} {square}");
        }
    }

    #[test]
    fn scatter_and_autocovariance_agree_with_the_noise_process() {
        let (periods, samples) = (12, 4000);
        let mut values = DMatrix::zeros(periods * samples + 7, 2);
        for c in 0..2 {
            // Column by column, so that the coloured process runs in time.
            values.set_column(c, &record(5 + c as u64, periods, samples).column(c));
        }
        let averaged = average(&values, &equal(periods, samples), &[], samples, 1e-3);
        let scatter = averaged.scatter.unwrap();
        assert_eq!(scatter.periods, periods);
        assert!((scatter.std[0] / 0.05 - 1.0).abs() < 0.02, "{:?}", scatter.std);
        assert!((scatter.std[1] / 0.2 - 1.0).abs() < 0.05, "{:?}", scatter.std);
        let mean = scatter.autocovariance_of_mean(1, |_| 1.0);
        for lag in [0, 1, 5, 10] {
            let expected = 0.04 * 0.9_f64.powi(lag as i32) / periods as f64;
            assert!((mean[lag] - expected).abs() < 0.06 * 0.04 / periods as f64, "lag {lag}: {} {expected}", mean[lag]);
        }
        // Half of white noise lies below a quarter of the rate.
        let half = scatter.std_of_mean(|f| if f < 250.0 { 1.0 } else { 0.0 });
        assert!((half[0] / (0.05 / (2.0 * periods as f64).sqrt()) - 1.0).abs() < 0.03);
    }

    #[test]
    fn a_period_fades_out_of_the_mean_and_in_again() {
        // The first of two periods of 4 s is up to 1 mrad above the second and left out at its start: the end of the second has no part either.
        let (samples, dt) = (4000, 1e-3);
        let above = |k: usize| if k < samples { 1e-3 * (1.0 - k as f64 / samples as f64).powi(3) } else { 0.0 };
        let values = DMatrix::from_fn(2 * samples, 1, |k, _| above(k));
        let mut left_out = vec![false; values.nrows()];
        left_out[..500].fill(true);
        let none = vec![false; left_out.len()];
        let mean = mean(&values, &weights(&left_out, &none, &none, samples, dt), samples);
        assert_eq!((mean[250], mean[2000]), (0.0, 0.5 * above(2000)));
        let ddq = |k: usize| {
            let at = |k: usize| mean[k % samples];
            (at(k + 1) - 2.0 * at(k) + at(k + samples - 1)) / (dt * dt)
        };
        let worst = (0..samples).map(ddq).fold(0.0, |worst: f64, ddq| worst.max(ddq.abs()));
        // A step of 0.3 mrad from one sample to the next would be 300 rad/s2.
        assert!(worst < 0.05, "{worst} rad/s2");
    }

    #[test]
    fn what_is_left_out_counts_rather_than_a_period_that_is_not_settled() {
        let (samples, dt) = (4000, 1e-3);
        // The first period is 1 in all its samples, the second 2; 1 s of the first is not settled, and 0.4 s of the second are left out in there.
        let values = DMatrix::from_fn(2 * samples, 1, |k, _| if k < samples { 1.0 } else { 2.0 });
        let unsettled: Vec<bool> = (0..2 * samples).map(|k| k < 1000).collect();
        let left_out: Vec<bool> =
            unsettled.iter().enumerate().map(|(k, out)| *out || (4300..4700).contains(&k)).collect();
        let none = vec![false; 2 * samples];
        let of_period = mean(&values, &weights(&left_out, &unsettled, &none, samples, dt), samples);
        for (k, expected) in [(200, 2.0), (500, 2.0), (900, 2.0), (2500, 1.5)] {
            assert!((of_period[k] - expected).abs() < 1e-12, "{k}: {}", of_period[k]);
        }
        // Where the second is lost the first counts, settled or not.
        let lost: Vec<bool> = (0..2 * samples).map(|k| (4300..4700).contains(&k)).collect();
        let unusable: Vec<bool> = (0..2 * samples).map(|k| unsettled[k] || lost[k]).collect();
        let of_period = mean(&values, &weights(&left_out, &unusable, &lost, samples, dt), samples);
        for (k, expected) in [(300, 1.0), (500, 1.0), (699, 1.0), (2500, 1.5)] {
            assert!((of_period[k] - expected).abs() < 1e-12, "{k}: {}", of_period[k]);
        }
        let steps = (1..samples).map(|k| (of_period[k] - of_period[k - 1]).abs());
        assert!(steps.fold(0.0, f64::max) < 0.01);
    }

    #[test]
    fn one_period_has_no_scatter() {
        assert!(average(&DMatrix::zeros(30, 1), &equal(1, 20), &[], 20, 0.1).scatter.is_none());
    }
}
