//! What the data can testify: torques and columns as coefficients of orthonormal waves in the pass-band, weighed by their noise.
//!
//! The mean of a periodic motion is taken apart into the harmonics of its period; a motion that does not repeat into blocks, and each
//! block into cosines (DCT-II, whose even continuation has no step at the ends). Both are orthonormal linear maps that torque and
//! columns go through alike, so `tau = W beta` holds for the coefficients as it does for the samples; all that lies above the band is
//! left out, and the noise of the coefficients is nearly independent. Every coefficient is divided by the standard deviation of its
//! noise, which repetitions tell; without them by 1 Nm, and the scale of each band is estimated with the model.

mod noise;

use super::fold::{BLOCK_LIMITS_S, Fold, Thinned, Thinning, folds_of};
use super::rows::Rows;
use super::span::Span;
use nalgebra::{DMatrix, DVector};
use plumbline_identify::{Experiment, Timeline};
use plumbline_model::term::effect::OperatingPoint;
use plumbline_model::term::{Motion, Term};
use plumbline_model::{Chain, Structure};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// Upper edges of the bands that have a scale of their own \[Hz\].
pub const BAND_EDGES_HZ: [f64; 7] = [0.55, 1.05, 2.0, 4.0, 8.0, 16.0, f64::INFINITY];
/// Number of the bands that are the low ones: below 4 Hz.
pub const LOW_BANDS: usize = 4;
/// Blocks that the motions that do not repeat are cut into, all together.
const WANTED_BLOCKS: f64 = 20.0;

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

/// The maps from samples to coefficients for a set of experiments.
#[derive(Clone, Debug)]
pub struct Evidence {
    joints: usize,
    folds: Vec<Fold>,
    cells: Vec<Cell>,
    /// Standard deviation of each row's noise, per joint \[Nm\].
    sigma: Vec<Vec<f64>>,
    /// Variance in it that every period repeats \[Nm^2\].
    repeated: Vec<Vec<f64>>,
    repeats: bool,
    motions: Vec<Thinned>,
    recorded: Vec<Recorded>,
    /// Periods that the mean of each experiment is of.
    periods: Vec<f64>,
    /// Largest step of each joint's encoder in any experiment \[rad\]; 0 where its noise hides it.
    encoder_steps: Vec<f64>,
    chain: Chain,
}

/// When the samples of an experiment were recorded.
#[derive(Clone, Debug)]
struct Recorded {
    /// Begin of its run on the clock of the recording \[s\].
    start: f64,
    timeline: Timeline,
}

/// One run to be diagnosed.
#[derive(Clone, Copy, Debug)]
pub struct Trial<'a> {
    /// The run made ready.
    pub experiment: &'a Experiment,
    /// Its session, 1 for the first.
    pub session: u32,
    /// Its begin on the clock of the recording \[s\].
    pub start: f64,
}

impl Recorded {
    /// Share of an effect that is there in every sample.
    fn share_in(&self, span: Span) -> Vec<f64> {
        self.timeline.mean_of(|t| span.share_at(self.start + t))
    }
}

impl<'a> Trial<'a> {
    /// A run that is alone in its recording.
    pub fn alone(experiment: &'a Experiment) -> Trial<'a> {
        Trial { experiment, session: 1, start: 0.0 }
    }

    /// Its end on the clock of the recording \[s\].
    pub fn end(&self) -> f64 {
        self.start + self.experiment.timeline.end()
    }

    /// Begin of the first run \[s\].
    pub(super) fn begin_of(trials: &[Trial]) -> f64 {
        trials.iter().map(|trial| trial.start).fold(f64::INFINITY, f64::min)
    }

    /// End of the last run \[s\].
    pub(super) fn end_of(trials: &[Trial]) -> f64 {
        trials.iter().map(Trial::end).fold(0.0, f64::max)
    }

    /// Runs of one session, one after the other.
    pub fn in_turn(experiments: &'a [Experiment]) -> Vec<Trial<'a>> {
        let mut start = 0.0;
        let trial = |experiment: &'a Experiment| {
            let trial = Trial { experiment, session: 1, start };
            start += experiment.timeline.end();
            trial
        };
        experiments.iter().map(trial).collect()
    }
}

impl Evidence {
    /// Of experiments of one arm, up to a frequency \[Hz\].
    pub fn of(chain: &Chain, trials: &[Trial], band: f64) -> Evidence {
        Evidence::with_noise_of(chain, trials, trials, band)
    }

    /// The same with the noise of the recordings `known`, which the experiments themselves may be too short to tell.
    pub fn with_noise_of(chain: &Chain, trials: &[Trial], known: &[Trial], band: f64) -> Evidence {
        let joints = chain.len();
        let free: f64 = trials
            .iter()
            .filter(|trial| !trial.experiment.motion.periodic)
            .map(|trial| trial.experiment.motion.samples() as f64 * trial.experiment.motion.dt)
            .sum();
        let length = (free / WANTED_BLOCKS).clamp(BLOCK_LIMITS_S.0, BLOCK_LIMITS_S.1);
        let (mut folds, mut motions) = (Vec::new(), Vec::new());
        let recorded = |trial: &Trial| Recorded { start: trial.start, timeline: trial.experiment.timeline.clone() };
        for (index, trial) in trials.iter().enumerate() {
            let thinned = Thinned::of(&trial.experiment.motion);
            for fold in folds_of(index, trial.experiment, trial.session, band, length, thinned.step) {
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
        let encoder_step = |joint: usize| {
            let steps = trials.iter().filter_map(|trial| trial.experiment.resolution.get(joint).copied());
            steps.fold(0.0, f64::max)
        };
        let repeats = known.iter().all(|trial| trial.experiment.scatter.is_some());
        let (sigma, repeated) = (0..joints).map(|joint| noise::of_rows(trials, known, &folds, joint, repeats)).unzip();
        Evidence {
            joints,
            folds,
            cells,
            sigma,
            repeated,
            repeats,
            motions,
            recorded: trials.iter().map(recorded).collect(),
            periods: trials.iter().map(|trial| trial.experiment.averaged_periods()).collect(),
            encoder_steps: (0..joints).map(encoder_step).collect(),
            chain: chain.clone(),
        }
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

    /// Step of a joint's encoder \[rad\]; 0 where its noise hides it.
    pub fn encoder_step(&self, joint: usize) -> f64 {
        self.encoder_steps[joint]
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

    fn cells_below(&self, joint: usize, bands: usize) -> impl Iterator<Item = &Cell> {
        self.cells.iter().filter(move |cell| cell.joint == joint && cell.band < bands)
    }

    /// Rows of a joint in the lowest `bands` of [`BAND_EDGES_HZ`].
    pub fn rows_below(&self, joint: usize, bands: usize) -> impl Iterator<Item = usize> {
        self.cells_below(joint, bands).flat_map(|cell| cell.rows.clone())
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

    /// The operating point of candidates at these parameters of a structure.
    pub fn operating_point(&self, structure: &Structure, beta: &[f64]) -> OperatingPoint {
        structure.operating_point(beta).known_along(self.motions.iter().flat_map(|own| [&own.whole, &own.few]))
    }

    /// Columns of a term at the rate of candidates, of an effect that acts in a part of the recording.
    ///
    /// Terms that are smooth in time are computed for some of the samples alone.
    pub fn columns(&self, term: &dyn Term, span: Span) -> Rows {
        self.look(term, span, false)
    }

    /// Nearly the same in a fraction of the time, for terms that integrate in time.
    pub fn sketch(&self, term: &dyn Term, span: Span) -> Rows {
        self.look(term, span, true)
    }

    fn look(&self, term: &dyn Term, span: Span, rough: bool) -> Rows {
        let width = term.columns().len();
        let mut parts: Vec<Option<DMatrix<f64>>> = vec![None; self.joints];
        // One piece of memory for all motions: fresh pages cost more than what is computed into them.
        let mut buffer = Vec::new();
        for (index, Thinned { whole, few, step }) in self.motions.iter().enumerate() {
            let own: Vec<&Fold> = self.folds.iter().filter(|fold| fold.experiment == index).collect();
            let share = (!span.is_all()).then(|| self.recorded[index].share_in(span));
            if share.as_ref().is_some_and(|share| share.iter().all(|share| *share == 0.0)) {
                continue;
            }
            let means = rough && term.integrates();
            let (thinning, motion) = match (term.smooth(), means) {
                (true, _) => (Thinning::Middle(*step), few),
                (false, true) => (Thinning::MeanAround(*step), few),
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
            if let Some(share) = share {
                let (first, every) = if Arc::ptr_eq(motion, whole) { (0, 1) } else { (step / 2, *step) };
                let share: Vec<f64> = share.into_iter().skip(first).step_by(every).take(samples).collect();
                for column in y.as_mut_slice().chunks_exact_mut(samples) {
                    column.iter_mut().zip(&share).for_each(|(value, share)| *value *= share);
                }
            }
            let mut blocks = Vec::new();
            for (joint, part) in parts.iter_mut().enumerate() {
                for column in 0..width {
                    let mut x = &y.as_slice()[column * y.nrows() + joint * samples..][..samples];
                    if x.iter().all(|value| *value == 0.0) {
                        continue;
                    }
                    blocks.clear();
                    match thinning {
                        Thinning::Mean(step) => {
                            blocks.extend(x.chunks_exact(step).map(|piece| piece.iter().sum::<f64>() / step as f64));
                        }
                        Thinning::MeanAround(_) => {
                            let after_last = if motion.periodic { x[0] } else { x[samples - 1] };
                            let next = x[1..].iter().chain([&after_last]);
                            blocks.extend(x.iter().zip(next).map(|(one, next)| 0.5 * (one + next)));
                        }
                        Thinning::None | Thinning::Middle(_) => {}
                    }
                    if !blocks.is_empty() {
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
        Rows::new(width, parts.into_iter().enumerate().filter_map(whiten).collect())
    }

    /// Begin of the first run of each session on the clock of the recording, in the order of the sessions.
    pub fn sessions(&self) -> BTreeMap<u32, f64> {
        let mut starts = BTreeMap::new();
        for fold in &self.folds {
            let start = self.recorded[fold.experiment].start;
            starts.entry(fold.session).and_modify(|first: &mut f64| *first = first.min(start)).or_insert(start);
        }
        starts
    }

    /// Begin of each fold on the clock of the recording \[s\].
    pub fn begins(&self) -> Vec<f64> {
        let begin = |fold: &Fold| {
            let Recorded { start, timeline } = &self.recorded[fold.experiment];
            // The first of a run has what lies before its samples.
            if fold.samples.start == 0 { *start } else { start + timeline.time(fold.samples.start) }
        };
        self.folds.iter().map(begin).collect()
    }

    /// Length of the block of a motion that does not repeat that begins at a time \[s\]; `None` where there is none.
    pub fn length_of_block_at(&self, begin: f64) -> Option<f64> {
        let fold = self.begins().iter().position(|own| (own - begin).abs() < 1e-9)?;
        if self.folds[fold].samples.start == 0 {
            return None;
        }
        let Fold { experiment, samples, .. } = &self.folds[fold];
        let Motion { dt, periodic, .. } = *self.motions[*experiment].whole;
        (!periodic).then_some(samples.len() as f64 * dt)
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

fn cells_of(joint: usize, fold: usize, of: &Fold) -> Vec<Cell> {
    let mut cells: Vec<Cell> = Vec::new();
    for (k, frequency) in of.frequencies.iter().enumerate() {
        let band = BAND_EDGES_HZ.iter().position(|edge| frequency <= edge).unwrap_or(BAND_EDGES_HZ.len() - 1);
        let row = of.rows.start + k;
        match cells.last_mut() {
            Some(cell) if cell.band == band => cell.rows.end = row + 1,
            _ => cells.push(Cell { joint, fold, band, rows: row..row + 1 }),
        }
    }
    cells
}
