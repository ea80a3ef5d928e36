//! A base that shakes: `a(t)` of the base bends gravity, and shows in all joints at once.
//!
//!   tau_j = - sum_c a_c(t) G_jc(q),   G_jc = d tau_j / d g_c, the three gravity columns of the known rigid bodies
//!
//! A line in the spectrum of the whole recording that is coherent through these columns is a base motion; its frequency is no multiple of
//! that of the motion, or every period would repeat it.

use super::record::{Record, blocks, mean_of_periods, median};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use plumbline_core::symmetric_eigen;
use plumbline_identify::Experiment;
use plumbline_identify::signal::spectral::Spectral;
use plumbline_model::term::Motion;
use plumbline_model::term::load::Load;
use realfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// Frequencies that are searched \[Hz\].
const BAND_HZ: (f64, f64) = (0.5, 40.0);
/// A line is so many times the median of its neighbours.
const MIN_LINE_POWER_RATIO: f64 = 12.0;
/// Neighbours on either side \[Hz\].
const NEIGHBOURS_HZ: f64 = 0.5;
/// Most lines of one run.
const MAX_LINES: usize = 4;
/// Noise is averaged over frequencies from `f / 1.3` to `1.3 f`.
const SMOOTHING_RATIO: f64 = 1.3;
/// A line explains at least this share of what its joints do at its frequency beyond their noise.
const MIN_EXPLAINED_RATIO: f64 = 0.5;
/// Least squares in units of the noise that a known line takes in another run: of six parameters noise alone takes 22 in one of a thousand.
const MIN_KNOWN_GAIN: f64 = 22.0;
/// Evaluations of the search for a frequency.
const MAX_EVALUATIONS: usize = 16;

/// A line that was found in one run.
#[derive(Clone, Debug, PartialEq)]
pub struct BaseMotion {
    /// Name of the run.
    pub run: String,
    /// Frequency \[Hz\].
    pub frequency: f64,
    /// Amplitude of the base's acceleration along `direction` \[m/s2\].
    pub amplitude: f64,
    /// Its standard deviation \[m/s2\].
    pub std: f64,
    /// Direction of the largest motion in the base frame; its sign means nothing.
    pub direction: Vector3<f64>,
    /// `a(t) = cosine cos(2 pi f t) + sine sin(2 pi f t)`, `t` since the first sample of the run \[m/s2\].
    pub cosine: Vector3<f64>,
    /// See `cosine`.
    pub sine: Vector3<f64>,
    /// Power over the median of its neighbours.
    pub ratio: f64,
    /// Share of what the joints do at this frequency, beyond their noise, that it explains.
    pub explained: f64,
    /// RMS of its torque in each joint \[Nm\].
    pub rms: Vec<f64>,
}

impl BaseMotion {
    /// What it does to the periods of its run along their mean motion, each at the samples of `Repeats`, P N x n \[Nm\]; `None` without repeats.
    pub(super) fn of_periods(&self, experiment: &Experiment, load: &Load) -> Option<DMatrix<f64>> {
        let (motion, repeats) = (&experiment.motion, experiment.repeats.as_ref()?);
        let (samples, gravity) = (motion.samples(), gravity_columns(motion, load));
        let torque = |row: usize, joint: usize| {
            let time = (repeats.periods[row / samples] * samples + row % samples) as f64 * motion.dt;
            let (sin, cos) = (TAU * self.frequency * time).sin_cos();
            gravity[joint].row(row % samples).tr_dot(&(self.cosine * cos + self.sine * sin))
        };
        Some(DMatrix::from_fn(repeats.tau.nrows(), repeats.tau.ncols(), torque))
    }

    /// What it does to the mean of its run's periods, N x n \[Nm\].
    pub(super) fn of_mean(&self, experiment: &Experiment, load: &Load) -> DMatrix<f64> {
        let (motion, angle) = (&experiment.motion, |t: f64| TAU * self.frequency * t);
        let gravity = gravity_columns(motion, load);
        let cosines = experiment.timeline.mean_of(|t| angle(t).cos());
        let sines = experiment.timeline.mean_of(|t| angle(t).sin());
        let torque =
            |k: usize, joint: usize| gravity[joint].row(k).tr_dot(&(self.cosine * cosines[k] + self.sine * sines[k]));
        DMatrix::from_fn(motion.samples(), motion.joints(), torque)
    }
}

/// The lines of one run, the strongest first. `rest` are its centred deviations, P N x n.
pub(super) fn base_motions(record: &Record, load: &Load, rest: &DMatrix<f64>) -> Vec<BaseMotion> {
    let gravity = gravity_columns(&record.motion, load);
    let (mut rest, mut mean) = (rest.clone(), blocks(&record.repeats.mean, record.step));
    let mut found: Vec<BaseMotion> = Vec::new();
    while found.len() < MAX_LINES {
        let Some(one) = strongest(record, &gravity, &rest, &mean) else { break };
        let torque = torque(record, &gravity, &one);
        mean -= mean_of_periods(&torque, &record.uncounted, record.samples);
        rest -= record.centred_all(torque);
        found.push(one);
    }
    found
}

/// A line of another run in this one, within a resolution of its frequency \[Hz\]; `None` where it is not significant.
pub(super) fn known(record: &Record, load: &Load, frequency: f64) -> Option<BaseMotion> {
    let gravity = gravity_columns(&record.motion, load);
    let (rest, mean) = (record.centred_all(record.tau.clone()), blocks(&record.repeats.mean, record.step));
    let line = Line::of(record, &gravity, &rest, &mean);
    let frequency = line.peak(frequency, 1.0 / (record.tau.nrows() as f64 * record.dt));
    let fitted = line.fit(frequency).filter(|fitted| fitted.gain > MIN_KNOWN_GAIN)?;
    fitted.report(&line, frequency, f64::NAN)
}

/// What these lines do to the deviations of their run, P N x n \[Nm\].
pub(super) fn torques(record: &Record, load: &Load, lines: &[BaseMotion]) -> DMatrix<f64> {
    let mut sum = DMatrix::zeros(record.tau.nrows(), record.joints());
    if !lines.is_empty() {
        let gravity = gravity_columns(&record.motion, load);
        lines.iter().for_each(|line| sum += torque(record, &gravity, line));
    }
    record.centred_all(sum)
}

/// Torques of each joint per unit of acceleration of the base along each of its axes, along a motion: N x 3 for each joint.
pub(super) fn gravity_columns(motion: &Motion, load: &Load) -> Vec<DMatrix<f64>> {
    let still = DMatrix::zeros(motion.samples(), motion.joints());
    let mut columns = vec![DMatrix::zeros(motion.samples(), 3); motion.joints()];
    for c in 0..3 {
        let mut axis = Vector3::zeros();
        // Gravity is the opposite of what it takes to hold against it.
        axis[c] = -1.0;
        let held = Motion { dq: still.clone(), ddq: still.clone(), gravity: axis, ..motion.clone() };
        let tau = load.along(&held);
        for (joint, own) in columns.iter_mut().enumerate() {
            own.set_column(c, &tau.column(joint));
        }
    }
    columns
}

/// The recording in time: a period that was left out is nothing.
fn unrolled(record: &Record, x: &[f64]) -> Vec<f64> {
    let periods = &record.repeats.periods;
    let first = periods.first().copied().unwrap_or(0);
    let count = periods.last().map_or(0, |last| last + 1 - first);
    let mut out = vec![0.0; count * record.samples];
    for (period, values) in periods.iter().zip(x.chunks(record.samples)) {
        out[(period - first) * record.samples..][..record.samples].copy_from_slice(values);
    }
    out
}

fn strongest(
    record: &Record,
    gravity: &[DMatrix<f64>],
    rest: &DMatrix<f64>,
    mean: &DMatrix<f64>,
) -> Option<BaseMotion> {
    let joints = record.joints();
    let per_joint: Vec<Vec<f64>> =
        (0..joints).map(|j| unrolled(record, &rest.column(j).iter().copied().collect::<Vec<_>>())).collect();
    let length = per_joint.first()?.len();
    let spectral = Spectral::new(length, record.dt);
    let line = Line::of(record, gravity, rest, mean);
    // Spectra of deviation times column, and how strong the columns are.
    let mut spectra: Vec<[Vec<Complex<f64>>; 3]> = Vec::new();
    let mut strength: Vec<Matrix3<f64>> = Vec::new();
    for (x, g) in per_joint.iter().zip(gravity) {
        let times = |c: usize| {
            let product: Vec<f64> = x.iter().enumerate().map(|(row, x)| x * g[(row % record.samples, c)]).collect();
            spectral.transform(&product)
        };
        spectra.push([times(0), times(1), times(2)]);
        let square = g.tr_mul(g) * (rest.nrows() / record.samples) as f64 / 2.0;
        strength.push(square.fixed_view::<3, 3>(0, 0).into_owned());
    }
    let highest = BAND_HZ.1.min(0.4 / record.dt);
    let bins = (0..spectral.bins()).filter(|&bin| (BAND_HZ.0..=highest).contains(&spectral.frequency(bin)));
    let power: Vec<(usize, f64)> = bins
        .map(|bin| {
            let (mut b, mut a) = (Vector3::<Complex<f64>>::zeros(), Matrix3::zeros());
            for (joint, spectra) in spectra.iter().enumerate() {
                let weight = 1.0 / line.noise.at(joint, spectral.frequency(bin));
                for (c, spectrum) in spectra.iter().enumerate() {
                    b[c] += spectrum[bin] * weight;
                }
                a += strength[joint] * weight;
            }
            let inverse = weak_inverse(&a);
            let part = |x: Vector3<f64>| x.dot(&(inverse * x));
            (bin, part(b.map(|value| value.re)) + part(b.map(|value| value.im)))
        })
        .collect();
    // What repeats in every period is no deviation: nothing is left at the harmonics of the motion, and they tell nothing of the noise.
    let own = 1.0 / (record.samples as f64 * record.dt);
    let harmonic =
        |frequency: f64| (frequency / own - (frequency / own).round()).abs() * own < 0.5 / (length as f64 * record.dt);
    let power: Vec<(usize, f64)> = power.into_iter().filter(|(bin, _)| !harmonic(spectral.frequency(*bin))).collect();
    let near = (NEIGHBOURS_HZ * length as f64 * record.dt).round().max(8.0) as usize;
    let ratio = |k: usize| {
        let around = k.saturating_sub(near)..(k + near + 1).min(power.len());
        let mut others: Vec<f64> = around.map(|other| power[other].1).collect();
        power[k].1 / median(&mut others).max(f64::MIN_POSITIVE)
    };
    let lines = (0..power.len()).map(|k| (k, ratio(k)));
    let mut strong: Vec<(usize, f64)> = lines.filter(|(_, ratio)| *ratio > MIN_LINE_POWER_RATIO).collect();
    strong.sort_by(|a, b| power[b.0].1.total_cmp(&power[a.0].1));
    strong.into_iter().take(MAX_LINES).find_map(|(k, ratio)| {
        let width = 1.0 / (length as f64 * record.dt);
        let frequency = line.peak(spectral.frequency(power[k].0), width);
        Some(line.fit(frequency)?.report(&line, frequency, ratio)?)
            .filter(|found| found.explained > MIN_EXPLAINED_RATIO)
    })
}

/// Power of each joint's noise over frequency, of a single sample \[Nm2\].
struct Noise {
    power: DMatrix<f64>,
    width: f64,
}

impl Noise {
    /// Of periods below each other that have so many degrees of freedom together.
    fn of(x: &DMatrix<f64>, record: &Record, freedom: usize) -> Noise {
        let spectral = Spectral::new(record.samples, record.dt);
        let mut power = DMatrix::zeros(spectral.bins(), x.ncols());
        let scale = 1.0 / (record.samples * freedom.max(1)) as f64;
        for (joint, column) in x.column_iter().enumerate() {
            for period in column.iter().copied().collect::<Vec<_>>().chunks(record.samples) {
                for (bin, value) in spectral.transform(period).iter().enumerate() {
                    power[(bin, joint)] += scale * value.norm_sqr();
                }
            }
        }
        Noise { power, width: spectral.frequency(1) }
    }

    fn at(&self, joint: usize, frequency: f64) -> f64 {
        let low = (frequency / SMOOTHING_RATIO / self.width).round() as usize;
        let high =
            ((frequency * SMOOTHING_RATIO / self.width).round() as usize).max(low + 1).min(self.power.nrows() - 1);
        let low = low.min(high);
        let mut values: Vec<f64> = (low..=high).map(|bin| self.power[(bin, joint)]).collect();
        // The median, so that a line does not hide itself.
        median(&mut values).max(1e-12)
    }
}

/// Inverse on the directions in which the arm feels a base motion at all.
fn weak_inverse(a: &Matrix3<f64>) -> Matrix3<f64> {
    let Some(eigen) = symmetric_eigen(*a) else { return Matrix3::zeros() };
    let least = 1e-6 * eigen.eigenvalues.max();
    let values = eigen.eigenvalues.map(|value| if value > least { 1.0 / value } else { 0.0 });
    eigen.eigenvectors * Matrix3::from_diagonal(&values) * eigen.eigenvectors.transpose()
}

/// One line in one run.
struct Line<'a> {
    record: &'a Record<'a>,
    gravity: &'a [DMatrix<f64>],
    rest: &'a DMatrix<f64>,
    /// Mean torques less those of the plain model, N x n.
    mean: &'a DMatrix<f64>,
    noise: Noise,
    /// The same of `mean`; what the model lacks counts as noise there.
    noise_of_mean: Noise,
}

/// Cosine and sine of the acceleration, with what they explain.
struct Fitted {
    theta: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Squares that go, in units of the noise.
    gain: f64,
}

impl<'a> Line<'a> {
    fn of(record: &'a Record, gravity: &'a [DMatrix<f64>], rest: &'a DMatrix<f64>, mean: &'a DMatrix<f64>) -> Line<'a> {
        let (noise, noise_of_mean) = (Noise::of(rest, record, record.periods() - 1), Noise::of(mean, record, 1));
        Line { record, gravity, rest, mean, noise, noise_of_mean }
    }

    /// The frequency near one where most is explained.
    fn peak(&self, frequency: f64, width: f64) -> f64 {
        let ratio = (5.0_f64.sqrt() - 1.0) / 2.0;
        let (mut low, mut high) = (frequency - width, frequency + width);
        let gain = |frequency: f64| self.fit(frequency).map_or(0.0, |fitted| fitted.gain);
        for _ in 0..MAX_EVALUATIONS / 2 {
            let (left, right) = (high - ratio * (high - low), low + ratio * (high - low));
            if gain(left) > gain(right) { high = right } else { low = left }
        }
        0.5 * (low + high)
    }

    /// Least squares of the three columns times cosine and sine, in the deviations and in the mean: of two periods the deviations hardly tell the
    /// amplitude of a line near a harmonic of the motion.
    fn fit(&self, frequency: f64) -> Option<Fitted> {
        let (mut g, mut b) = (DMatrix::zeros(6, 6), DVector::zeros(6));
        for (joint, columns) in self.gravity.iter().enumerate() {
            let weight = 1.0 / self.noise.at(joint, frequency);
            let x = waves(self.record, columns, frequency);
            let of_mean = mean_of_periods(&x, &self.record.uncounted, self.record.samples);
            let weight_of_mean = 1.0 / self.noise_of_mean.at(joint, frequency);
            g += of_mean.tr_mul(&of_mean) * weight_of_mean;
            b += of_mean.tr_mul(&self.mean.column(joint)) * weight_of_mean;
            let x = self.record.centred_all(x);
            g += x.tr_mul(&x) * weight;
            b += x.tr_mul(&self.rest.column(joint)) * weight;
        }
        let scale = g.diagonal().max();
        for k in 0..6 {
            g[(k, k)] += 1e-9 * scale;
        }
        let covariance = g.cholesky()?.inverse();
        let theta = &covariance * &b;
        Some(Fitted { gain: b.dot(&theta), theta, covariance })
    }
}

/// Columns times cosine, then times sine, along the mean motion of a run: P N x 6.
fn waves(record: &Record, columns: &DMatrix<f64>, frequency: f64) -> DMatrix<f64> {
    let rows = record.tau.nrows();
    let mut x = DMatrix::zeros(rows, 6);
    // Samples of the grid are means over a block.
    let angle = PI * frequency * record.dt;
    let block = if record.step > 1 { angle.sin() / angle } else { 1.0 };
    for row in 0..rows {
        let (sin, cos) = (TAU * frequency * record.time(row)).sin_cos();
        for c in 0..3 {
            let column = columns[(row % record.samples, c)] * block;
            (x[(row, c)], x[(row, 3 + c)]) = (column * cos, column * sin);
        }
    }
    x
}

fn torque(record: &Record, gravity: &[DMatrix<f64>], line: &BaseMotion) -> DMatrix<f64> {
    let theta = DVector::from_iterator(6, line.cosine.iter().chain(line.sine.iter()).copied());
    let columns: Vec<DVector<f64>> = gravity.iter().map(|own| waves(record, own, line.frequency) * &theta).collect();
    DMatrix::from_columns(&columns)
}

impl Fitted {
    fn report(&self, line: &Line, frequency: f64, ratio: f64) -> Option<BaseMotion> {
        let cosine = Vector3::new(self.theta[0], self.theta[1], self.theta[2]);
        let sine = Vector3::new(self.theta[3], self.theta[4], self.theta[5]);
        // The largest axis of the ellipse that the base runs through.
        let eigen = symmetric_eigen(cosine * cosine.transpose() + sine * sine.transpose())?;
        let axis = eigen.eigenvalues.imax();
        let direction: Vector3<f64> = eigen.eigenvectors.column(axis).into();
        let amplitude = eigen.eigenvalues[axis].sqrt();
        let (along_cosine, along_sine) = (cosine.dot(&direction) / amplitude, sine.dot(&direction) / amplitude);
        let weights = DVector::from_fn(6, |k, _| direction[k % 3] * if k < 3 { along_cosine } else { along_sine });
        let variance = (&self.covariance * &weights).dot(&weights);
        let mut found = BaseMotion {
            run: line.record.experiment.name.clone(),
            frequency,
            amplitude,
            std: variance.sqrt(),
            direction,
            cosine,
            sine,
            ratio,
            explained: 0.0,
            rms: Vec::new(),
        };
        let tau = torque(line.record, line.gravity, &found);
        found.rms = tau.column_iter().map(|own| (own.norm_squared() / own.len() as f64).sqrt()).collect();
        found.explained = explained(line, frequency, &line.record.centred_all(tau));
        Some(found)
    }
}

/// Share of the squares near a frequency, beyond the noise, that go with a torque: the arm's motion spreads a line over its harmonics.
fn explained(line: &Line, frequency: f64, tau: &DMatrix<f64>) -> f64 {
    let record = line.record;
    let length = unrolled(record, tau.column(0).into_owned().as_slice()).len();
    let spectral = Spectral::new(length, record.dt);
    let near = |bin: &usize| (spectral.frequency(*bin) - frequency).abs() < NEIGHBOURS_HZ;
    let bins: Vec<usize> = (0..spectral.bins()).filter(near).collect();
    let (mut before, mut after) = (0.0, 0.0);
    for joint in 0..record.joints() {
        let noise = line.noise.at(joint, frequency);
        let square = |x: &[f64]| {
            let spectrum = spectral.transform(&unrolled(record, x));
            bins.iter().map(|&bin| spectrum[bin].norm_sqr() / (length as f64 * noise)).sum::<f64>() - bins.len() as f64
        };
        let own: Vec<f64> = line.rest.column(joint).iter().copied().collect();
        let less: Vec<f64> = own.iter().zip(tau.column(joint).iter()).map(|(a, b)| a - b).collect();
        (before, after) = (before + square(&own), after + square(&less).max(0.0));
    }
    (1.0 - after / before.max(f64::MIN_POSITIVE)).clamp(0.0, 1.0)
}
