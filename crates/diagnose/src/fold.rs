//! The parts of the data that are left out as a whole when findings are tested, and the maps from their samples to coefficients.

use nalgebra::DMatrix;
use plumbline_identify::Experiment;
use plumbline_identify::signal::spectral::Spectral;
use plumbline_model::term::Motion;
use realfft::num_complex::Complex;
use std::f64::consts::PI;
use std::ops::Range;
use std::sync::Arc;

/// Columns of candidates are computed at no less than this rate \[Hz\].
const MIN_RATE_HZ: f64 = 180.0;
/// A block of a motion that does not repeat is no shorter than this \[s\] and no longer than the other.
pub(super) const BLOCK_LIMITS_S: (f64, f64) = (1.0, 10.0);

/// A trajectory, or a block of a motion that does not repeat: what is left out as a whole when findings are tested.
#[derive(Clone, Debug)]
pub struct Fold {
    /// Name of its run.
    pub name: String,
    /// Which experiment it belongs to.
    pub experiment: usize,
    /// Session of its run, 1 for the first.
    pub session: u32,
    /// Samples of the experiment that it spans.
    pub samples: Range<usize>,
    /// Its rows among those of a joint.
    pub rows: Range<usize>,
    /// Frequency of each of its rows \[Hz\].
    pub frequencies: Vec<f64>,
    waves: Waves,
}

#[derive(Clone, Debug)]
enum Waves {
    /// The first bins of the period's spectrum.
    Periodic { bins: usize, all: Arc<Spectral>, few: Arc<Spectral>, thinned: Vec<Bin> },
    /// Cosines over the block, for all samples and for those of candidates.
    Block { all: Cosines, thinned: Cosines },
}

/// Discrete cosine transform of a block (DCT-II, orthonormal).
#[derive(Clone, Debug)]
pub(super) struct Cosines {
    spectral: Arc<Spectral>,
    /// Cosine and sine of `pi k / (2 N)` for the coefficients `k` up to half of them.
    turns: Vec<(f64, f64)>,
    samples: usize,
}

impl Cosines {
    pub fn new(samples: usize) -> Cosines {
        let spectral = Arc::new(Spectral::new(samples, 1.0));
        let turn = |k: usize| (PI * k as f64 / (2 * samples) as f64).sin_cos();
        let turns = (0..spectral.bins()).map(turn).map(|(sin, cos)| (cos, sin)).collect();
        Cosines { spectral, turns, samples }
    }

    /// Height of the cosine of a coefficient.
    fn scale(&self, row: usize) -> f64 {
        (if row == 0 { 1.0 } else { 2.0 } / self.samples as f64).sqrt()
    }

    /// The first coefficients: `c_k = s_k sum_m x_m cos(pi k (m + 1/2) / N)`, by a Fourier transform of the even samples followed by the odd ones
    /// backwards (Makhoul, IEEE Trans. ASSP 28, 1980).
    pub fn transform(&self, x: &[f64], out: &mut [f64]) {
        let n = self.samples;
        let even = x.iter().step_by(2);
        let odd = x[1..].iter().step_by(2).rev();
        let spectrum = self.spectral.transform(&even.chain(odd).copied().collect::<Vec<_>>());
        for (k, (value, (cos, sin))) in spectrum.iter().zip(&self.turns).enumerate() {
            if let Some(out) = out.get_mut(k) {
                *out = self.scale(k) * (value.re * cos + value.im * sin);
            }
            if let Some(out) = out.get_mut(n - k).filter(|_| k > 0) {
                *out = self.scale(n - k) * (value.re * sin - value.im * cos);
            }
        }
    }

    /// The signal of the first coefficients.
    fn signal(&self, rows: &[f64]) -> Vec<f64> {
        let wave = |row: usize, k: usize| (PI * row as f64 * (k as f64 + 0.5) / self.samples as f64).cos();
        let value = |k: usize| rows.iter().enumerate().map(|(row, c)| c * self.scale(row) * wave(row, k)).sum();
        (0..self.samples).map(value).collect()
    }
}

/// What thinning does to a bin of the spectrum.
#[derive(Clone, Copy, Debug)]
struct Bin {
    /// Sine and cosine of the angle by which the first sample that is there is late.
    late: (f64, f64),
    /// What the mean of the samples that one stands for keeps of a wave,
    of_mean: f64,
    /// and the mean of two means.
    around: f64,
}

/// A motion and the same with fewer samples.
#[derive(Clone, Debug)]
pub(super) struct Thinned {
    /// All samples.
    pub whole: Arc<Motion>,
    /// Some of them.
    pub few: Arc<Motion>,
    /// Every how many-th sample the second has.
    pub step: usize,
}

/// How samples stand for those between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Thinning {
    /// All are there.
    None,
    /// The middle one of every so many.
    Middle(usize),
    /// The mean of every so many, so that nothing sharp falls between two of them.
    Mean(usize),
    /// The middle one of every so many, as the mean of the means since the one before and up to the one after.
    MeanAround(usize),
}

impl Thinning {
    /// Samples that one stands for.
    fn step(self) -> usize {
        match self {
            Thinning::None => 1,
            Thinning::Middle(step) | Thinning::Mean(step) | Thinning::MeanAround(step) => step,
        }
    }

    /// What a wave that turns by `angle` from sample to sample keeps of its height.
    fn gain(self, angle: f64) -> f64 {
        match self {
            _ if angle <= 0.0 => 1.0,
            Thinning::None | Thinning::Middle(_) => 1.0,
            Thinning::Mean(step) => (0.5 * angle * step as f64).sin() / (step as f64 * (0.5 * angle).sin()),
            Thinning::MeanAround(step) => Thinning::Mean(step).gain(angle) * (0.5 * angle * step as f64).cos(),
        }
    }
}

impl Thinned {
    /// Every `step`-th sample, from the middle of the first so many on; `step` is odd, and divides the samples of a period.
    pub fn of(motion: &Motion) -> Thinned {
        let samples = motion.samples();
        let most = (1.0 / (MIN_RATE_HZ * motion.dt)).floor().max(1.0) as usize;
        let fits = |step: &usize| step % 2 == 1 && (!motion.periodic || samples.is_multiple_of(*step));
        let step = (1..=most).rev().find(fits).unwrap_or(1);
        let kept: Vec<usize> = (0..samples / step).map(|k| k * step + step / 2).collect();
        let thin = |x: &DMatrix<f64>| x.select_rows(&kept);
        let start = motion.start + (step / 2) as f64 * motion.dt;
        let (q, dq, ddq) = (thin(&motion.q), thin(&motion.dq), thin(&motion.ddq));
        let few = Motion { dt: motion.dt * step as f64, q, dq, ddq, start, ..motion.clone() };
        Thinned { whole: Arc::new(motion.clone()), few: Arc::new(few), step }
    }
}

impl Fold {
    /// Writes the coefficients of the experiment's samples `x`.
    pub(super) fn project(&self, x: &[f64], thinning: Thinning, out: &mut [f64]) {
        let (n, step) = (self.samples.len() as f64, thinning.step());
        match &self.waves {
            Waves::Periodic { bins, all, few, thinned } => {
                let spectrum = match thinning {
                    Thinning::None => all.transform(x),
                    _ => few.transform(x),
                };
                // As if all samples had been there: each stands for `step` of them, and the first is late by half of that.
                let scale = step as f64 / n.sqrt();
                out[0] = scale * spectrum[0].re;
                for bin in 1..*bins {
                    let Bin { late, of_mean, around } = thinned[bin];
                    let ((sin, cos), gain) = match thinning {
                        Thinning::None => ((0.0, 1.0), 1.0),
                        Thinning::Middle(_) => (late, 1.0),
                        Thinning::Mean(_) => (late, of_mean),
                        Thinning::MeanAround(_) => (late, around),
                    };
                    let (re, im) = (spectrum[bin].re, spectrum[bin].im);
                    let scale = scale * 2.0_f64.sqrt() / gain;
                    out[2 * bin - 1] = scale * (re * cos + im * sin);
                    out[2 * bin] = scale * (im * cos - re * sin);
                }
            }
            Waves::Block { all, thinned } => {
                let cosines = if thinning == Thinning::None { all } else { thinned };
                cosines.transform(&x[self.samples.start / step..][..cosines.samples], out);
                // As if all samples had been there: each stands for `step` of them.
                for (row, value) in out.iter_mut().enumerate() {
                    *value *= (step as f64).sqrt() / thinning.gain(PI * row as f64 / n);
                }
            }
        }
    }

    /// Inverse of [`Fold::project`] within the band, at every `step`-th sample.
    pub(super) fn signal(&self, rows: &[f64], step: usize, motion: &Motion) -> Vec<f64> {
        match &self.waves {
            Waves::Periodic { bins, few: spectral, .. } => {
                let n = self.samples.len() as f64;
                let late = 2.0 * PI * (step / 2) as f64 / n;
                let mut spectrum = vec![Complex::new(0.0, 0.0); spectral.bins()];
                // `Spectral::signal` divides by its own number of samples.
                let scale = motion.samples() as f64 / n.sqrt();
                spectrum[0] = Complex::new(scale * rows[0], 0.0);
                for bin in 1..*bins {
                    let value = Complex::new(rows[2 * bin - 1], rows[2 * bin]);
                    spectrum[bin] = value * Complex::cis(late * bin as f64) * (scale / 2.0_f64.sqrt());
                }
                spectral.signal(spectrum)
            }
            Waves::Block { thinned, .. } => {
                let height = 1.0 / (step as f64).sqrt();
                thinned.signal(rows).into_iter().map(|value| height * value).collect()
            }
        }
    }
}

/// The folds of an experiment: its period, or blocks of about `length` \[s\] of its motion, up to the frequency `band` \[Hz\]. Their rows are not
/// counted yet.
pub(super) fn folds_of(
    index: usize,
    experiment: &Experiment,
    session: u32,
    band: f64,
    length: f64,
    step: usize,
) -> Vec<Fold> {
    let motion = &experiment.motion;
    let (samples, dt) = (motion.samples(), motion.dt);
    let highest = band.min(0.4 / dt);
    let name = experiment.name.clone();
    let fold = |samples: Range<usize>, frequencies: Vec<f64>, waves: Waves| Fold {
        name: name.clone(),
        experiment: index,
        session,
        samples,
        rows: 0..0,
        frequencies,
        waves,
    };
    if motion.periodic {
        let bins = ((highest * samples as f64 * dt) as usize + 1).clamp(2, samples / 2);
        let frequency = |row: usize| row.div_ceil(2) as f64 / (samples as f64 * dt);
        let frequencies = (0..2 * bins - 1).map(frequency).collect();
        let all = Arc::new(Spectral::new(samples, dt));
        let few = Arc::new(Spectral::new(samples / step, dt * step as f64));
        let turn = |bin: usize| 2.0 * PI * bin as f64 / samples as f64;
        let bin = |bin: usize| Bin {
            late: (0.5 * (step - 1) as f64 * turn(bin)).sin_cos(),
            of_mean: Thinning::Mean(step).gain(turn(bin)),
            around: Thinning::MeanAround(step).gain(turn(bin)),
        };
        let thinned = (0..bins).map(bin).collect();
        return vec![fold(0..samples, frequencies, Waves::Periodic { bins, all, few, thinned })];
    }
    let mut folds = Vec::new();
    for moving in stretches(experiment.resting()) {
        let seconds = moving.len() as f64 * dt;
        if seconds < 0.5 * BLOCK_LIMITS_S.0 {
            continue;
        }
        let blocks = (seconds / length).round().max(1.0) as usize;
        // Whole steps, so that candidates have the same blocks.
        let (mut first, last) = (moving.start.div_ceil(step), moving.end / step);
        for block in 0..blocks {
            let length = transformed(last - first, blocks - block);
            let thin = first..first + length;
            first = thin.end;
            let span = thin.start * step..thin.end * step;
            let n = span.len();
            let rows = ((2.0 * highest * n as f64 * dt) as usize + 1).min(thin.len());
            let frequencies = (0..rows).map(|row| row as f64 / (2.0 * n as f64 * dt)).collect();
            let (all, thinned) = (Cosines::new(n), Cosines::new(thin.len()));
            folds.push(fold(span, frequencies, Waves::Block { all, thinned }));
        }
    }
    folds
}

/// Length of the next of so many blocks of so many samples: near their mean one that a Fourier transform takes apart, even and without a prime factor
/// above 7; others take several times as long. What the last block has too much is left out.
fn transformed(samples: usize, blocks: usize) -> usize {
    let is_fast = |length: &usize| {
        let rest = [2, 3, 5, 7].into_iter().fold(*length, |mut rest, factor| {
            while rest.is_multiple_of(factor) {
                rest /= factor;
            }
            rest
        });
        length.is_multiple_of(2) && rest == 1
    };
    let mean = samples / blocks;
    let below = (2..=mean).rev().find(is_fast);
    let above = (mean..=samples).find(is_fast).filter(|above| blocks > 1 && above + below.unwrap_or(0) < 2 * mean);
    above.or(below).unwrap_or(mean)
}

/// Stretches of samples without rest.
fn stretches(resting: &[bool]) -> Vec<Range<usize>> {
    let mut found = Vec::new();
    let mut start = None;
    for (k, rests) in resting.iter().chain([&true]).enumerate() {
        match (start, rests) {
            (None, false) => start = Some(k),
            (Some(first), true) => {
                found.push(first..k);
                start = None;
            }
            _ => {}
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::transformed;

    #[test]
    fn blocks_have_lengths_that_are_transformed_fast_and_lose_some_samples_at_the_end() {
        for (samples, blocks) in [(10_948, 20), (547, 1), (2003, 3), (90, 1), (3000, 7)] {
            let (mut left, mut lengths) = (samples, Vec::new());
            for block in 0..blocks {
                lengths.push(transformed(left, blocks - block));
                left -= lengths[block];
            }
            let mean = samples / blocks;
            for length in lengths {
                let rest = [2, 3, 5, 7].iter().fold(length, |rest, factor| {
                    (0..9).fold(rest, |rest, _| if rest % factor == 0 { rest / factor } else { rest })
                });
                assert!(length % 2 == 0 && rest == 1 && length.abs_diff(mean) <= mean / 20, "{length} of {mean}");
            }
            assert!(left <= mean / 20, "{left} of {samples} are left");
        }
    }
}
