//! What the data can testify: torques and columns as coefficients of orthonormal waves in the pass-band, weighed by their noise.
//!
//! The mean of a periodic motion is taken apart into the harmonics of its period; a motion that does not repeat into blocks, and each
//! block into cosines (DCT-II, whose even continuation has no step at the ends). Both are orthonormal linear maps that torque and
//! columns go through alike, so `tau = W beta` holds for the coefficients as it does for the samples; all that lies above the band is
//! left out, and the noise of the coefficients is nearly independent. Every coefficient is divided by the standard deviation of its
//! noise, which repetitions tell; without them by 1 Nm, and the scale of each band is estimated with the model.

use crate::estimate::experiment::Experiment;
use crate::estimate::signal::spectral::Spectral;
use crate::model::chain::Chain;
use crate::model::structure::Structure;
use crate::model::term::{Motion, Term};
use nalgebra::{DMatrix, DVector};
use realfft::num_complex::Complex;
use std::f64::consts::PI;
use std::ops::Range;
use std::sync::Arc;

/// Upper edges of the bands that have a scale of their own \[Hz\].
pub const BANDS: [f64; 7] = [0.55, 1.05, 2.0, 4.0, 8.0, 16.0, f64::INFINITY];
/// Columns of candidates are computed at no less than this rate \[Hz\].
const RATE: f64 = 180.0;
/// Noise is averaged over frequencies from `f / 1.3` to `1.3 f`.
const SMOOTHING: f64 = 1.3;
/// A block of a motion that does not repeat is no shorter than this \[s\] and no longer than the other.
const BLOCK: (f64, f64) = (1.0, 10.0);
/// Blocks that the motions that do not repeat are cut into, all together.
const BLOCKS: f64 = 20.0;

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
    /// Cosines over the block, one column each, for all samples and for those of candidates.
    Block { all: DMatrix<f64>, thinned: DMatrix<f64> },
}

/// What thinning does to a bin of the spectrum.
#[derive(Clone, Copy, Debug)]
struct Bin {
    /// Sine and cosine of the angle by which the first sample that is there is late.
    late: (f64, f64),
    /// What the mean of the samples that one stands for keeps of a wave.
    gain: f64,
}

/// Rows of one joint, one fold and one band.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Cell {
    /// The joint, from 0.
    pub joint: usize,
    /// The fold.
    pub fold: usize,
    /// The band.
    pub band: usize,
    /// Its rows among those of the joint.
    pub rows: Range<usize>,
}

/// Coefficients of columns; joints that are not listed have none.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    /// Number of columns.
    pub width: usize,
    /// Joint, from 0, and its coefficients, divided by their noise.
    pub parts: Vec<(usize, DMatrix<f64>)>,
}

/// The maps from samples to coefficients for a set of experiments.
#[derive(Clone, Debug)]
pub struct Evidence {
    joints: usize,
    folds: Vec<Fold>,
    cells: Vec<Cell>,
    /// Standard deviation of each row's noise, per joint \[Nm\].
    sigma: Vec<Vec<f64>>,
    repeats: bool,
    motions: Vec<Thinned>,
    chain: Chain,
}

/// A motion and the same with fewer samples.
#[derive(Clone, Debug)]
struct Thinned {
    whole: Motion,
    few: Motion,
    /// Every how many-th sample the second has.
    step: usize,
}

/// How samples stand for those between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Thinning {
    /// All are there.
    None,
    /// The middle one of every so many.
    Middle(usize),
    /// The mean of every so many, so that nothing sharp falls between two of them.
    Mean(usize),
    /// The mean of so many up to the middle one of every so many.
    MeanBefore(usize),
}

impl Thinning {
    fn step(self) -> usize {
        match self {
            Thinning::None => 1,
            Thinning::Middle(step) | Thinning::Mean(step) | Thinning::MeanBefore(step) => step,
        }
    }

    /// What a wave that turns by `angle` from sample to sample keeps of its height.
    fn gain(self, angle: f64) -> f64 {
        match self {
            Thinning::Mean(step) | Thinning::MeanBefore(step) if angle > 0.0 => {
                (0.5 * angle * step as f64).sin() / (step as f64 * (0.5 * angle).sin())
            }
            _ => 1.0,
        }
    }
}

/// One run to be diagnosed.
pub struct Trial<'a> {
    /// The run made ready.
    pub experiment: &'a Experiment,
    /// Its session, 1 for the first.
    pub session: u32,
}

impl Evidence {
    /// Of experiments of one arm, up to a frequency \[Hz\].
    pub fn of(chain: &Chain, trials: &[Trial], band: f64) -> Evidence {
        let joints = chain.len();
        let free: f64 = trials
            .iter()
            .filter(|trial| !trial.experiment.motion.periodic)
            .map(|trial| trial.experiment.motion.samples() as f64 * trial.experiment.motion.dt)
            .sum();
        let length = (free / BLOCKS).clamp(BLOCK.0, BLOCK.1);
        let (mut folds, mut motions) = (Vec::new(), Vec::new());
        for (index, trial) in trials.iter().enumerate() {
            let thinned = Thinned::of(&trial.experiment.motion);
            for fold in folds_of(index, trial, band, length, thinned.step) {
                folds.push(fold);
            }
            motions.push(thinned);
        }
        let mut before = 0;
        for fold in &mut folds {
            fold.rows = before..before + fold.frequencies.len();
            before = fold.rows.end;
        }
        let mut cells = Vec::new();
        for joint in 0..joints {
            for (index, fold) in folds.iter().enumerate() {
                cells.extend(cells_of(joint, index, fold));
            }
        }
        let repeats = trials.iter().all(|trial| trial.experiment.scatter.is_some());
        let sigma = (0..joints).map(|joint| noise(trials, &folds, joint, repeats)).collect();
        Evidence { joints, folds, cells, sigma, repeats, motions, chain: chain.clone() }
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// The folds.
    pub fn folds(&self) -> &[Fold] {
        &self.folds
    }

    /// The cells, joint by joint, within that fold by fold.
    pub fn cells(&self) -> &[Cell] {
        &self.cells
    }

    /// Whether repetitions tell the noise.
    pub fn repeats(&self) -> bool {
        self.repeats
    }

    /// Rows of a joint.
    pub fn per_joint(&self) -> usize {
        self.folds.last().map_or(0, |fold| fold.rows.end)
    }

    /// Standard deviations that the rows of a joint are divided by \[Nm\].
    pub fn sigma(&self, joint: usize) -> &[f64] {
        &self.sigma[joint]
    }

    /// Samples per joint that the rows stand for: the mean square of a signal in the band is the sum of its squared coefficients
    /// (times `sigma`) over this.
    pub fn samples(&self) -> f64 {
        self.folds.iter().map(|fold| fold.samples.len() as f64).sum()
    }

    /// Mean square of the noise of a joint in the band \[Nm2\]; nothing without repeats.
    pub fn floor(&self, joint: usize) -> Option<f64> {
        let square: f64 = self.sigma[joint].iter().map(|sigma| sigma * sigma).sum();
        self.repeats.then(|| (square / self.samples()).sqrt())
    }

    /// Measured torques, per joint.
    pub fn torques(&self, trials: &[Trial]) -> Vec<DVector<f64>> {
        let rows = self.of_samples(|index| trials[index].experiment.stacked_tau(), 1);
        rows.into_iter().map(|part| part.column(0).into_owned()).collect()
    }

    /// The regressor of a structure, per joint: columns at the full rate.
    pub fn regressor(&self, structure: &Structure, trials: &[Trial]) -> Vec<DMatrix<f64>> {
        let width = structure.columns().len();
        self.of_samples(|index| structure.regressor(&trials[index].experiment.motion), width)
    }

    /// Columns of a term at the rate of candidates, in the folds of sessions from `since` on where that is given.
    ///
    /// Terms that are smooth in time are computed for some of the samples alone.
    pub fn columns(&self, term: &dyn Term, since: Option<u32>) -> Rows {
        self.look(term, since, false)
    }

    /// Nearly the same in a fraction of the time, for terms that integrate in time.
    pub fn sketch(&self, term: &dyn Term, since: Option<u32>) -> Rows {
        self.look(term, since, true)
    }

    fn look(&self, term: &dyn Term, since: Option<u32>, rough: bool) -> Rows {
        let width = term.columns().len();
        let mut parts: Vec<Option<DMatrix<f64>>> = vec![None; self.joints];
        // One piece of memory for all motions: fresh pages cost more than what is computed into them.
        let mut buffer = Vec::new();
        for (index, Thinned { whole, few, step }) in self.motions.iter().enumerate() {
            let own: Vec<&Fold> = self.folds.iter().filter(|fold| fold.experiment == index).collect();
            if !own.iter().any(|fold| since.is_none_or(|since| fold.session >= since)) {
                continue;
            }
            let means = rough && whole.periodic && term.integrates();
            let (thinning, motion) = match (term.smooth(), means) {
                (true, _) => (Thinning::Middle(*step), few),
                (false, true) => (Thinning::MeanBefore(*step), few),
                (false, false) => (Thinning::Mean(*step), whole),
            };
            let samples = motion.samples();
            buffer.clear();
            buffer.resize(samples * self.joints * width, 0.0);
            let mut y = DMatrix::from_vec(samples * self.joints, width, std::mem::take(&mut buffer));
            if means {
                term.fill_means(&self.chain, motion, &mut y, 0);
            } else {
                term.fill(&self.chain, motion, &mut y, 0);
            }
            let mut blocks = Vec::new();
            for (joint, part) in parts.iter_mut().enumerate() {
                for column in 0..width {
                    let mut x = &y.as_slice()[column * y.nrows() + joint * samples..][..samples];
                    if x.iter().all(|value| *value == 0.0) {
                        continue;
                    }
                    if let Thinning::Mean(step) = thinning {
                        blocks.clear();
                        blocks.extend(x.chunks_exact(step).map(|piece| piece.iter().sum::<f64>() / step as f64));
                        x = &blocks;
                    }
                    let part = part.get_or_insert_with(|| DMatrix::zeros(self.per_joint(), width));
                    let mut part = part.column_mut(column);
                    for fold in &own {
                        let mut out = part.rows_mut(fold.rows.start, fold.rows.len());
                        fold.project(x, thinning, out.as_mut_slice());
                    }
                }
            }
            buffer = y.data.into();
        }
        let whiten = |(joint, part): (usize, Option<DMatrix<f64>>)| {
            let mut part = part?;
            self.whiten(joint, &mut part);
            Some((joint, part))
        };
        Rows { width, parts: parts.into_iter().enumerate().filter_map(whiten).collect() }
    }

    /// The motion of each experiment at the rate of candidates.
    pub fn motion(&self, experiment: usize) -> &Motion {
        &self.motions[experiment].few
    }

    /// Number of experiments.
    pub fn experiments(&self) -> usize {
        self.motions.len()
    }

    /// Samples at the rate of candidates that a fold spans, of those of its experiment.
    pub fn thinned(&self, fold: usize) -> Range<usize> {
        let Fold { experiment, samples, .. } = &self.folds[fold];
        let step = self.motions[*experiment].step;
        samples.start / step..samples.end / step
    }

    /// Coefficients of torques of one joint that are given at the samples of [`Evidence::motion`], N x width in each experiment; divided
    /// by the noise.
    pub fn project(&self, joint: usize, samples: &[DMatrix<f64>]) -> DMatrix<f64> {
        let width = samples.first().map_or(0, DMatrix::ncols);
        let mut part = DMatrix::zeros(self.per_joint(), width);
        for (index, (Thinned { few: motion, step, .. }, values)) in self.motions.iter().zip(samples).enumerate() {
            assert_eq!(values.shape(), (motion.samples(), width), "samples of experiment {index}");
            for (mut out, x) in part.column_iter_mut().zip(values.as_slice().chunks_exact(motion.samples())) {
                for fold in self.folds.iter().filter(|fold| fold.experiment == index) {
                    let mut own = out.rows_mut(fold.rows.start, fold.rows.len());
                    fold.project(x, Thinning::Middle(*step), own.as_mut_slice());
                }
            }
        }
        self.whiten(joint, &mut part);
        part
    }

    /// The signal that has these coefficients in one fold, and nothing outside the band, at the samples of [`Evidence::thinned`]: the
    /// inverse of what torques go through. `rows` are those of the fold, not divided by the noise.
    pub fn signal(&self, fold: usize, rows: &[f64]) -> Vec<f64> {
        let fold = &self.folds[fold];
        let Thinned { few: motion, step, .. } = &self.motions[fold.experiment];
        fold.signal(rows, *step, motion)
    }

    /// Coefficients of samples at the full rate, n N x width in each experiment.
    fn of_samples(&self, samples: impl Fn(usize) -> DMatrix<f64>, width: usize) -> Vec<DMatrix<f64>> {
        let mut parts = vec![DMatrix::zeros(self.per_joint(), width); self.joints];
        for (index, Thinned { whole, .. }) in self.motions.iter().enumerate() {
            let y = samples(index);
            let count = whole.samples();
            for (joint, part) in parts.iter_mut().enumerate() {
                for column in 0..width {
                    let x = &y.as_slice()[column * y.nrows() + joint * count..][..count];
                    let mut part = part.column_mut(column);
                    for fold in self.folds.iter().filter(|fold| fold.experiment == index) {
                        let mut out = part.rows_mut(fold.rows.start, fold.rows.len());
                        fold.project(x, Thinning::None, out.as_mut_slice());
                    }
                }
            }
        }
        for (joint, part) in parts.iter_mut().enumerate() {
            self.whiten(joint, part);
        }
        parts
    }

    fn whiten(&self, joint: usize, part: &mut DMatrix<f64>) {
        for mut column in part.column_iter_mut() {
            for (value, sigma) in column.iter_mut().zip(&self.sigma[joint]) {
                *value /= sigma;
            }
        }
    }
}

impl Thinned {
    /// Every `step`-th sample, from the middle of the first so many on; `step` is odd, and divides the samples of a period.
    fn of(motion: &Motion) -> Thinned {
        let samples = motion.samples();
        let most = (1.0 / (RATE * motion.dt)).floor().max(1.0) as usize;
        let fits = |step: &usize| step % 2 == 1 && (!motion.periodic || samples.is_multiple_of(*step));
        let step = (1..=most).rev().find(fits).unwrap_or(1);
        let kept: Vec<usize> = (0..samples / step).map(|k| k * step + step / 2).collect();
        let thin = |x: &DMatrix<f64>| x.select_rows(&kept);
        let start = motion.start + (step / 2) as f64 * motion.dt;
        let (q, dq, ddq) = (thin(&motion.q), thin(&motion.dq), thin(&motion.ddq));
        let few = Motion { dt: motion.dt * step as f64, q, dq, ddq, start, ..motion.clone() };
        Thinned { whole: motion.clone(), few, step }
    }
}

impl Fold {
    /// Writes the coefficients of the experiment's samples `x`.
    fn project(&self, x: &[f64], thinning: Thinning, out: &mut [f64]) {
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
                    let ((sin, cos), gain) = match thinning {
                        Thinning::None => ((0.0, 1.0), 1.0),
                        Thinning::Middle(_) => (thinned[bin].late, 1.0),
                        Thinning::Mean(_) => (thinned[bin].late, thinned[bin].gain),
                        // As late as the middle one, less half of what the mean goes back.
                        Thinning::MeanBefore(_) => ((0.0, 1.0), thinned[bin].gain),
                    };
                    let (re, im) = (spectrum[bin].re, spectrum[bin].im);
                    let scale = scale * 2.0_f64.sqrt() / gain;
                    out[2 * bin - 1] = scale * (re * cos + im * sin);
                    out[2 * bin] = scale * (im * cos - re * sin);
                }
            }
            Waves::Block { all, thinned } => {
                let waves = if step == 1 { all } else { thinned };
                let x = &x[self.samples.start / step..][..waves.nrows()];
                for (row, (value, wave)) in out.iter_mut().zip(waves.column_iter()).enumerate() {
                    let sum: f64 = wave.iter().zip(x).map(|(wave, x)| wave * x).sum();
                    *value = sum / thinning.gain(PI * row as f64 / n);
                }
            }
        }
    }
}

impl Fold {
    /// Inverse of [`Fold::project`] within the band, at every `step`-th sample.
    fn signal(&self, rows: &[f64], step: usize, motion: &Motion) -> Vec<f64> {
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
                let rows = DVector::from_column_slice(rows);
                (thinned * rows / step as f64).as_slice().to_vec()
            }
        }
    }
}

fn folds_of(index: usize, trial: &Trial, band: f64, length: f64, step: usize) -> Vec<Fold> {
    let motion = &trial.experiment.motion;
    let (samples, dt) = (motion.samples(), motion.dt);
    let highest = band.min(0.4 / dt);
    let name = trial.experiment.name.clone();
    let fold = |samples: Range<usize>, frequencies: Vec<f64>, waves: Waves| Fold {
        name: name.clone(),
        experiment: index,
        session: trial.session,
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
            gain: Thinning::Mean(step).gain(turn(bin)),
        };
        let thinned = (0..bins).map(bin).collect();
        return vec![fold(0..samples, frequencies, Waves::Periodic { bins, all, few, thinned })];
    }
    let mut folds = Vec::new();
    for moving in stretches(trial.experiment.resting()) {
        let seconds = moving.len() as f64 * dt;
        if seconds < 0.5 * BLOCK.0 {
            continue;
        }
        let blocks = (seconds / length).round().max(1.0) as usize;
        // Whole steps, so that candidates have the same blocks.
        let (first, count) = (moving.start.div_ceil(step), moving.end / step - moving.start.div_ceil(step));
        for block in 0..blocks {
            let thin = first + block * count / blocks..first + (block + 1) * count / blocks;
            let span = thin.start * step..thin.end * step;
            let n = span.len();
            let rows = ((2.0 * highest * n as f64 * dt) as usize + 1).min(thin.len());
            let scale = |row: usize| if row == 0 { (1.0 / n as f64).sqrt() } else { (2.0 / n as f64).sqrt() };
            let wave = |row: usize, k: f64| scale(row) * (PI * row as f64 * (k + 0.5) / n as f64).cos();
            let all = DMatrix::from_fn(n, rows, |k, row| wave(row, k as f64));
            let middle = |k: usize| (k * step + step / 2) as f64;
            let thinned = DMatrix::from_fn(thin.len(), rows, |k, row| step as f64 * wave(row, middle(k)));
            let frequencies = (0..rows).map(|row| row as f64 / (2.0 * n as f64 * dt)).collect();
            folds.push(fold(span, frequencies, Waves::Block { all, thinned }));
        }
    }
    folds
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

fn cells_of(joint: usize, fold: usize, of: &Fold) -> Vec<Cell> {
    let mut cells: Vec<Cell> = Vec::new();
    for (k, frequency) in of.frequencies.iter().enumerate() {
        let band = BANDS.iter().position(|edge| frequency <= edge).unwrap_or(BANDS.len() - 1);
        let row = of.rows.start + k;
        match cells.last_mut() {
            Some(cell) if cell.band == band => cell.rows.end = row + 1,
            _ => cells.push(Cell { joint, fold, band, rows: row..row + 1 }),
        }
    }
    cells
}

/// Standard deviation of the noise of each row of a joint: that of the mean period, from all experiments together.
fn noise(trials: &[Trial], folds: &[Fold], joint: usize, repeats: bool) -> Vec<f64> {
    let mut sigma = Vec::new();
    for fold in folds {
        if !repeats {
            sigma.extend(fold.frequencies.iter().map(|_| 1.0));
            continue;
        }
        let own = &trials[fold.experiment].experiment.scatter;
        let periods = own.as_ref().map_or(1, |scatter| scatter.periods) as f64;
        for &frequency in &fold.frequencies {
            let (mut power, mut weight) = (0.0, 0.0);
            for scatter in trials.iter().filter_map(|trial| trial.experiment.scatter.as_ref()) {
                let width = 1.0 / (scatter.samples as f64 * scatter.dt);
                let low = (frequency / SMOOTHING / width).round() as usize;
                let high = ((frequency * SMOOTHING / width).round() as usize).max(low + 1);
                for bin in low..=high.min(scatter.power.nrows() - 1) {
                    let freedom = (scatter.periods - 1) as f64;
                    power += freedom * scatter.power[(bin, joint)];
                    weight += freedom;
                }
            }
            // Torques that repeat to the last bit have no noise; a thousandth of a milli-newton-metre stands for it.
            sigma.push((power / weight / periods).sqrt().max(1e-6));
        }
    }
    sigma
}
