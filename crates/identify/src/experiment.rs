//! One run prepared for the regression: averaged, filtered, differentiated.

mod fading;
mod resolution;

use super::EstimateError;
use super::differentiate::Differentiator;
use super::even::Even;
use super::faults;
use super::periods::{NoiseOfMean, Scatter, centre, mean};
use super::run::Run;
use super::settings::Settings;
use super::signal::butterworth::Butterworth;
use super::signal::resample::{Sampling, resample};
use super::signal::spectral::Spectral;
use super::signal::{SignalError, decimation};
use super::timeline::Timeline;
use fading::Fading;
use nalgebra::DMatrix;
use plumbline_model::term::Motion;
use resolution::EncoderNoise;
use std::f64::consts::PI;

/// Maximum position cut-off \[Hz\]. At a reversal of friction the joint's controller reacts within its bandwidth of about 20 Hz, and the step of
/// the acceleration contains higher frequencies. A filter that removes them biases friction and inertia.
const MAX_CUTOFF_HZ: f64 = 80.0;
/// Position cut-off of the mean of several periods for the comparison with raw torques \[Hz\]: no filter removes the noise of the
/// accelerations there.
const COMPARISON_CUTOFF_HZ: f64 = 20.0;
/// Position cut-off of a run without repeats for the same comparison \[Hz\]: the minimum position cut-off.
const APERIODIC_CUTOFF_HZ: f64 = 10.0;
/// Maximum velocity noise that the position filter may pass \[rad/s\]. Friction reverses within 0.01 rad/s; more noise would blur its sign.
const MAX_VELOCITY_NOISE: f64 = 1e-3;
/// Ends of an aperiodic run that [`Settings::without_ends`] leaves out, in periods of the torque cut-off. The odd reflection of [`Butterworth::zero_phase`]
/// holds the first and the last sample, whose noise it passes whole: six times as much as within the run at 4 Hz and 250 samples per second, and within
/// 0.35 periods as much. What is left of the errors of the accelerations near the ends is there, too.
const END_PERIODS: f64 = 0.5;
/// Maximum ratio of the position cut-off to half the sampling rate.
const MAX_NYQUIST_RATIO: f64 = 0.8;

/// One run, prepared for the regression.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// Name of the run.
    pub name: String,
    /// Filtered motion with derivatives on the even grid: one period of a periodic run, an aperiodic run without its ends.
    pub motion: Motion,
    /// Motion behind a narrower low-pass, for the comparison of a model with raw torques; `None` where `motion` is used.
    pub comparison_motion: Option<Motion>,
    /// Torques on the same grid, N x n, averaged over the periods and not filtered \[Nm\].
    pub tau: DMatrix<f64>,
    /// Scatter of the torques between the periods \[Nm\]; `None` without repeats.
    pub scatter: Option<Scatter>,
    /// Noise of the filtered mean torques; `None` without repeats.
    pub noise: Option<NoiseOfMean>,
    /// Standard deviation of one raw position sample between the periods, n \[rad\]; `None` without repeats.
    pub position_noise: Option<Vec<f64>>,
    /// Smallest step between two positions of the recording, n \[rad\]: the resolution of a coarse encoder.
    pub resolution: Vec<f64>,
    /// Every period's deviation from the mean, where the settings keep it.
    pub repeats: Option<Repeats>,
    /// The desired motion on the same grid, filtered alike; where it was given.
    pub desired: Option<Motion>,
    /// Statistics of the time stamps.
    pub sampling: Sampling,
    /// Time at the start of the first period that is excluded, because the motion did not repeat yet \[s\].
    pub settling: f64,
    /// When the samples of the grid were recorded.
    pub timeline: Timeline,
    /// Torque samples per joint that were spoiled, by a spike or a drop-out, and replaced.
    pub replaced: Vec<usize>,
    /// Samples of the grid at which the whole arm is at rest, or that the settings exclude.
    resting: Vec<bool>,
    /// Samples of the grid that enter the regression.
    kept: Vec<usize>,
    filter: Butterworth,
    /// Scatter of the torques as recorded, where weights are by frequency: the same whatever is taken off the deviations later.
    recorded_scatter: Option<Scatter>,
    /// Torque of a drift that `tau` is without, N x n \[Nm\].
    drift: Option<DMatrix<f64>>,
    /// Positions on the even grid before the low-pass, ends included; of the mean of several periods without their noise \[rad\].
    q: DMatrix<f64>,
    /// What was taken off them; `None` without repeats.
    encoder_noise: Option<EncoderNoise>,
    /// What fading periods add to its derivatives; `None` where none fades.
    fading: Option<Fading>,
    /// Measured velocities on the same grid \[rad/s\], where velocities and accelerations are computed from them.
    dq: Option<DMatrix<f64>>,
    differentiator: Differentiator,
    /// Differentiator of the comparison motion.
    comparison_differentiator: Differentiator,
    /// Samples cut off each end of the grid.
    edge: usize,
}

/// Every period's deviation from the mean, P N rows, period below period. Excluded samples are zero.
#[derive(Clone, Debug)]
pub struct Repeats {
    /// Indices of these periods in the recording, P, from 0, without excluded ones.
    pub periods: Vec<usize>,
    /// Deviations of the positions, P N x n \[rad\].
    pub q: DMatrix<f64>,
    /// Deviations of the torques, P N x n \[Nm\].
    pub tau: DMatrix<f64>,
    /// The mean torques, less those of the models whose deviations were taken off, N x n \[Nm\].
    pub mean: DMatrix<f64>,
    /// Whether a row counts, P N.
    pub counted: Vec<bool>,
}

impl Experiment {
    /// Resamples a run to an even grid, averages its periods, filters and differentiates the positions.
    ///
    /// # Errors
    /// Samples that can't be processed; too few periods or samples.
    pub fn prepare(run: &Run, settings: &Settings) -> Result<Experiment, EstimateError> {
        let even = Even::of(run, settings)?;
        Experiment::build(run, settings, even).map_err(|source| EstimateError::Signal { run: run.name.clone(), source })
    }

    fn build(run: &Run, settings: &Settings, even: Even) -> Result<Experiment, SignalError> {
        let Even {
            values,
            sampling,
            periodic,
            periods,
            weights,
            q: of_periods,
            scatter,
            deviations,
            counted,
            settling,
            long_lines,
            replaced,
        } = even;
        let (n, samples, dt) = (run.joints(), values.nrows(), sampling.dt);
        let rate = 1.0 / dt;
        let filter = Butterworth::new(settings.order, settings.torque_cutoff, rate)?;
        let steps: Vec<f64> =
            run.q.column_iter().map(|column| faults::resolution(column.as_slice()).unwrap_or(0.0)).collect();
        let mut q = values.columns(0, n).into_owned();
        let fading = if periodic { Fading::of(&of_periods, &weights, samples, settings.order, dt)? } else { None };
        let encoder_noise = scatter.as_ref().map(|scatter| EncoderNoise::take_off(&mut q, scatter, &steps));
        let largest = |each: &mut dyn Iterator<Item = f64>| each.fold(0.0, f64::max);
        let noise = match &scatter {
            Some(scatter) => largest(&mut scatter.std[..n].iter().copied()) / scatter.averaged.sqrt(),
            None => {
                let each = q.column_iter().map(|column| noise_of_aperiodic(column.as_slice(), settings.order, rate));
                largest(&mut each.collect::<Result<Vec<f64>, SignalError>>()?.into_iter())
            }
        };
        // White noise of the positions gives velocities of `noise 2 pi f_c sqrt(2 f_c dt / 3)` behind the filter.
        let noise_limited = (MAX_VELOCITY_NOISE / (noise * 2.0 * PI * (2.0 * dt / 3.0).sqrt())).powf(2.0 / 3.0);
        let default_comparison_cutoff = if scatter.is_some() { COMPARISON_CUTOFF_HZ } else { APERIODIC_CUTOFF_HZ };
        let default_cutoff = noise_limited.clamp(default_comparison_cutoff, MAX_CUTOFF_HZ);
        let differentiator = |default_cutoff: f64| {
            let cutoff = settings.position_cutoff.unwrap_or(default_cutoff).min(MAX_NYQUIST_RATIO * rate / 2.0);
            Differentiator::new(settings.order, cutoff, settings.derivative, periodic, dt, run.mounting.gravity())
        };
        let (comparison_differentiator, differentiator) =
            (differentiator(default_comparison_cutoff)?, differentiator(default_cutoff)?);

        // Without repeats the ends are cut before torques and columns are filtered. The filter is linear: its end effects are the same on both
        // sides of the equation.
        let trim = if periodic { 0.0 } else { (settings.trim * rate).ceil().max(0.0) };
        let edge = differentiator.edge().max(trim as usize);
        let step = settings.decimation.unwrap_or_else(|| decimation(rate, 2.0 * settings.torque_cutoff)).max(1);
        let count = samples.saturating_sub(2 * edge);
        if count < 2 * step {
            return Err(SignalError::TooShort { samples, needed: 2 * edge + 2 * step });
        }
        let dq = (values.ncols() > 2 * n).then(|| values.columns(2 * n, n).into_owned());
        let motion =
            |differentiator: &Differentiator| motion_of(differentiator, &q, dq.as_ref(), fading.as_ref(), edge);
        let narrower = comparison_differentiator.cutoff() < differentiator.cutoff();
        let of_tau = || deviations.columns(n, n).into_owned();
        let recorded_scatter =
            scatter.as_ref().filter(|_| settings.weights_by_frequency).map(|scatter| scatter.select(n..2 * n));
        let mut experiment = Experiment {
            name: run.name.clone(),
            motion: motion(&differentiator),
            comparison_motion: narrower.then(|| motion(&comparison_differentiator)),
            tau: values.view((edge, n), (count, n)).into_owned(),
            noise: scatter
                .as_ref()
                .map(|_| NoiseOfMean::of(&of_tau(), &counted, samples, dt, |f| filter.zero_phase_gain(f))),
            repeats: (scatter.is_some() && settings.keep_periods).then(|| Repeats {
                periods: periods.clone(),
                q: deviations.columns(0, n).into_owned(),
                tau: of_tau(),
                mean: values.view((edge, n), (count, n)).into_owned(),
                counted,
            }),
            resolution: steps,
            position_noise: scatter.as_ref().map(|scatter| scatter.std[..n].to_vec()),
            scatter: scatter.map(|scatter| scatter.select(n..2 * n)),
            desired: None,
            sampling,
            settling,
            replaced,
            timeline: Timeline { dt, samples: count, edge, periods, weights },
            resting: vec![false; count],
            kept: (0..count).step_by(step).collect(),
            filter,
            recorded_scatter,
            drift: None,
            q,
            encoder_noise,
            fading,
            dq,
            differentiator,
            comparison_differentiator,
            edge,
        };
        experiment.exclude_rests(settings.rest);
        if !periodic {
            settings.left_out(&run.name).for_each(|one| one.mark(&mut experiment.resting, edge, dt));
            for (out, rows) in experiment.resting.iter_mut().zip(&long_lines[edge..]) {
                *out |= rows;
            }
            let end = if settings.without_ends { END_PERIODS / settings.torque_cutoff * rate } else { 0.0 };
            let end = (end.ceil() as usize).min(count / 4);
            experiment.resting[..end].fill(true);
            experiment.resting[count - end..].fill(true);
            experiment.kept.retain(|&k| !experiment.resting[k]);
        }
        Ok(experiment)
    }

    /// Excludes samples at which every joint is slower than `rest` \[rad/s\] from regression and errors. A periodic motion is at rest for an
    /// instant only and keeps all samples.
    fn exclude_rests(&mut self, rest: Option<f64>) {
        let Some(rest) = rest.filter(|_| !self.motion.periodic) else { return };
        for (k, resting) in self.resting.iter_mut().enumerate() {
            *resting = self.motion.dq.row(k).iter().all(|speed| speed.abs() < rest);
        }
        self.kept.retain(|&k| !self.resting[k]);
    }

    /// Per sample of the grid, N: whether the whole arm is at rest or the settings exclude it.
    pub fn resting(&self) -> &[bool] {
        &self.resting
    }

    /// The motion of every period by itself, P N rows at the samples of [`Repeats`]; `None` where the periods are not kept.
    pub fn own_motion(&self) -> Option<Motion> {
        let repeats = self.repeats.as_ref()?;
        // A period is the mean and its deviation, whatever the mean is of.
        let mean = self.of_comparison().motion(&self.q, self.edge);
        // The periods follow each other, and the last does not adjoin the first.
        let mut own = self.comparison_differentiator.aperiodic().motion(&repeats.q, 0);
        let samples = mean.samples();
        for p in 0..repeats.periods.len() {
            for (own, mean) in [(&mut own.q, &mean.q), (&mut own.dq, &mean.dq), (&mut own.ddq, &mean.ddq)] {
                let mut part = own.rows_mut(p * samples, samples);
                part += mean;
            }
        }
        Some(own)
    }

    /// Subtracts from the periods' torque deviations what the deviations of their motion explain by a model: an arm never moves twice alike, and
    /// every period is compared with the model along its own motion. What is left is noise, encoders' noise included, and what the model lacks.
    /// [`Scatter::power`] and [`Experiment::noise`] are then those of that remainder. Nothing where the periods are not kept.
    pub fn follow_own_motion(&mut self, predict: impl Fn(&Motion) -> DMatrix<f64>) {
        let Some(own) = self.own_motion() else { return };
        let edge = self.comparison_differentiator.aperiodic().edge();
        let Some(repeats) = &mut self.repeats else { return };
        let mean = self.comparison_motion.as_ref().unwrap_or(&self.motion);
        let (samples, periods, rows) = (mean.samples(), repeats.periods.len(), repeats.counted.len());
        // The accelerations of the ends depend on what lies outside.
        repeats.counted[..edge].fill(false);
        repeats.counted[rows - edge..].fill(false);
        let (own, mean) = (predict(&own), predict(mean));
        for p in 0..periods {
            let mut part = repeats.tau.rows_mut(p * samples, samples);
            part -= own.rows(p * samples, samples) - &mean;
        }
        repeats.mean -= mean;
        centre(&mut repeats.tau, &repeats.counted, samples);
        self.noise_of_deviations();
    }

    /// Adds the desired motion, N x n \[rad\], at the time stamps of the run \[s\].
    ///
    /// # Errors
    /// Too few rows, a value that is not finite.
    pub fn with_desired(mut self, t: &[f64], q_d: &DMatrix<f64>) -> Result<Experiment, EstimateError> {
        let signal = |source| EstimateError::Signal { run: self.name.clone(), source };
        assert_eq!(q_d.ncols(), self.joints(), "joints of the desired motion");
        let even = resample(t, q_d, Some(self.sampling.dt)).map_err(signal)?;
        let samples = self.q.nrows();
        let short = SignalError::Shape { what: "desired positions", found: even.values.nrows(), expected: samples };
        let end = self.timeline.periods.last().map_or(0, |period| period * samples) + samples;
        if even.values.nrows() < end {
            return Err(signal(short));
        }
        let grid = if self.motion.periodic {
            let rows = self.timeline.periods.iter().flat_map(|period| period * samples..(period + 1) * samples);
            mean(&even.values.select_rows(&rows.collect::<Vec<_>>()), &self.timeline.weights, samples)
        } else {
            even.values.rows(0, samples).into_owned()
        };
        self.desired = Some(self.differentiator.motion(&grid, self.edge));
        Ok(self)
    }

    /// The comparison motion including the cut ends of an aperiodic run, and the number of samples cut off each end. There the accelerations
    /// depend on the extrapolation past the ends.
    pub fn with_ends(&self) -> (Motion, usize) {
        (motion_of(self.of_comparison(), &self.q, self.dq.as_ref(), self.fading.as_ref(), 0), self.edge)
    }

    /// Differentiator of the motion for the comparison with raw torques.
    fn of_comparison(&self) -> &Differentiator {
        if self.comparison_motion.is_some() { &self.comparison_differentiator } else { &self.differentiator }
    }

    /// The motion for perturbed positions: `offset` is added to those of the motion on the whole grid, N x n \[rad\].
    pub fn moved(&self, offset: &DMatrix<f64>) -> Motion {
        let mut moved = motion_of(&self.differentiator, &(&self.q + offset), None, self.fading.as_ref(), self.edge);
        if self.dq.is_some() {
            moved.dq.copy_from(&self.motion.dq);
            moved.ddq.copy_from(&self.motion.ddq);
        }
        moved
    }

    /// The same from the positions with all of their noise.
    pub fn moved_as_measured(&self, offset: &DMatrix<f64>) -> Motion {
        match &self.encoder_noise {
            Some(noise) => self.moved(&(offset + &noise.taken_off)),
            None => self.moved(offset),
        }
    }

    /// Shape of the positions on the whole grid, ends included.
    pub fn grid(&self) -> (usize, usize) {
        self.q.shape()
    }

    /// Standard deviation of the positions' noise, n \[rad\]: of the mean period by the scatter between the periods; without repeats by
    /// the power above the position cut-off, assumed white.
    pub fn noise_of_positions(&self) -> Vec<f64> {
        if let (Some(noise), Some(scatter)) = (&self.position_noise, &self.scatter) {
            return noise.iter().map(|std| std / scatter.averaged.sqrt()).collect();
        }
        let share = 1.0 - 2.0 * self.differentiator.cutoff() * self.sampling.dt;
        let (count, n) = self.motion.q.shape();
        let rest = self.q.rows(self.edge, count) - &self.motion.q;
        (0..n).map(|j| (rest.column(j).norm_squared() / (count as f64 * share)).sqrt()).collect()
    }

    /// Subtracts a torque from the periods' deviations, P N x n at the samples of [`Repeats`]: what is known to differ between the periods is no noise.
    /// The mean is not changed. Nothing where the periods are not kept.
    pub fn take_off_deviations(&mut self, torque: &DMatrix<f64>) {
        let Some(repeats) = &mut self.repeats else { return };
        repeats.tau -= torque;
        let samples = self.motion.samples();
        centre(&mut repeats.tau, &repeats.counted, samples);
        self.noise_of_deviations();
    }

    /// Subtracts what came once from the mean torques, N x n \[Nm\].
    pub fn take_off(&mut self, torque: &DMatrix<f64>) {
        self.tau -= torque;
        self.repeats.iter_mut().for_each(|repeats| repeats.mean -= torque);
    }

    /// Subtracts the torque of a drift from the mean torques, N x n \[Nm\].
    pub fn take_off_drift(&mut self, torque: DMatrix<f64>) {
        self.take_off(&torque);
        self.drift = Some(torque);
    }

    /// The experiment with its drift; `None` where none was taken off.
    pub fn as_recorded(&self) -> Option<Experiment> {
        let drift = self.drift.as_ref()?;
        Some(Experiment { tau: &self.tau + drift, drift: None, ..self.clone() })
    }

    /// [`Scatter::power`] and [`Experiment::noise`] of the periods' deviations as they are.
    fn noise_of_deviations(&mut self) {
        let Some(repeats) = &self.repeats else { return };
        let (samples, dt) = (self.motion.samples(), self.motion.dt);
        if let Some(scatter) = &mut self.scatter {
            scatter.power = Scatter::of(&repeats.tau, &repeats.counted, samples, dt).power;
        }
        self.noise =
            Some(NoiseOfMean::of(&repeats.tau, &repeats.counted, samples, dt, |f| self.filter.zero_phase_gain(f)));
    }

    /// Number of periods that the mean is of, see [`Scatter::averaged`]; 1 without repeats.
    pub fn averaged_periods(&self) -> f64 {
        self.scatter.as_ref().map_or(1.0, |scatter| scatter.averaged)
    }

    /// Scatter of its torques where weights are by frequency.
    pub(crate) fn coloured(&self) -> Option<&Scatter> {
        self.recorded_scatter.as_ref()
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.motion.joints()
    }

    /// Samples of the grid that enter the regression, m of N.
    pub fn kept(&self) -> &[usize] {
        &self.kept
    }

    /// Zero-phase gain of the filter on torques and columns at a frequency \[Hz\].
    pub fn gain(&self, f: f64) -> f64 {
        self.filter.zero_phase_gain(f)
    }

    /// Filters every column of `y` (n N rows at the raw rate, joint by joint) over each joint's block of samples.
    ///
    /// Torques and regressor pass the same filter: a filter on one side alone would resemble friction at reversals.
    pub fn filter(&self, y: &DMatrix<f64>) -> DMatrix<f64> {
        let samples = self.motion.samples();
        assert_eq!(y.nrows() % samples, 0, "whole blocks of samples");
        let mut spectral = Spectral::new(samples, self.motion.dt);
        let mut out = y.clone();
        for mut column in out.column_iter_mut() {
            for block in column.as_mut_slice().chunks_mut(samples) {
                // A link's column is zero in the rows of the joints beyond it.
                if block.iter().all(|&value| value == 0.0) {
                    continue;
                }
                let filtered = if self.motion.periodic {
                    self.filter.zero_phase_periodic(&mut spectral, block)
                } else {
                    self.filter.zero_phase(block)
                };
                block.copy_from_slice(&filtered);
            }
        }
        out
    }

    /// [`Experiment::filter`], then the kept samples: n m rows, joint by joint.
    pub fn band(&self, y: &DMatrix<f64>) -> DMatrix<f64> {
        let samples = self.motion.samples();
        let filtered = self.filter(y);
        let rows: Vec<usize> =
            (0..y.nrows() / samples).flat_map(|block| self.kept.iter().map(move |&k| block * samples + k)).collect();
        filtered.select_rows(&rows)
    }

    /// Torques as one column, n N rows joint by joint.
    pub fn stacked_tau(&self) -> DMatrix<f64> {
        DMatrix::from_column_slice(self.tau.len(), 1, self.tau.as_slice())
    }
}

/// Motion of positions and, where given, measured velocities, without `edge` samples at both ends. Measured velocities pass the filter
/// of the positions, which keeps them aligned. What fading periods add to the derivatives is taken off.
fn motion_of(
    differentiator: &Differentiator,
    q: &DMatrix<f64>,
    dq: Option<&DMatrix<f64>>,
    fading: Option<&Fading>,
    edge: usize,
) -> Motion {
    let mut motion = differentiator.motion(q, edge);
    if let Some(dq) = dq {
        let measured = differentiator.motion(dq, edge);
        (motion.dq, motion.ddq) = (measured.q, measured.dq);
    }
    fading.into_iter().for_each(|fading| fading.take_off(&mut motion, differentiator));
    motion
}

/// Standard deviation of white noise with the power of a record, sampled at `rate` \[Hz\], between half the maximum position cut-off and that
/// cut-off. A smooth motion has negligible power there; jitter of the time stamps causes noise at lower frequencies only.
fn noise_of_aperiodic(x: &[f64], order: usize, rate: f64) -> Result<f64, SignalError> {
    let top = MAX_CUTOFF_HZ.min(MAX_NYQUIST_RATIO * rate / 2.0);
    let [low, high] = [0.5 * top, top].map(|cutoff| Butterworth::new(order, cutoff, rate));
    let (low, high) = (low?.zero_phase(x), high?.zero_phase(x));
    // Without the ends, where the filters extrapolate.
    let inside = x.len() / 10..x.len() - x.len() / 10;
    let squares: f64 = inside.clone().map(|k| (high[k] - low[k]).powi(2)).sum();
    Ok((squares / inside.len().max(1) as f64 * rate / top).sqrt())
}

#[cfg(test)]
mod tests;
