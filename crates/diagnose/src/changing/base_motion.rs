//! A base that shakes: `a(t)` of the base bends gravity, and shows in all joints at once.
//!
//!   tau_j = - sum_c a_c(t) G_jc(q),   G_jc = d tau_j / d g_c, the three gravity columns of the known rigid bodies
//!
//! A line in the spectrum of the whole recording that is coherent through these columns is a base motion. The deviations of the periods have it but for the
//! harmonics of the motion, where every period repeats it; what the plain model leaves of their mean, or of a motion that does not repeat, has all of it, and
//! lines of what the model lacks, too.

mod part;

use super::record::{Record, blocks, max_step, median, on_grid};
use nalgebra::{DMatrix, DVector, Vector3};
use part::{Normal, Part, Rows};
use plumbline_core::symmetric_eigen;
use plumbline_identify::Experiment;
use plumbline_model::term::Motion;
use plumbline_model::term::load::Load;
use std::f64::consts::TAU;

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
/// and at least this share where other runs do not have it: of many frequencies slow noise makes a line of one.
const MIN_EXPLAINED_RATIO_ALONE: f64 = 0.9;
/// Smallest amplitude over its deviation. Near a harmonic of a motion of two periods much of a line's power may tell little of its amplitude.
const MIN_DEVIATIONS: f64 = 4.0;
/// Lines of several runs that are nearer than this are one \[Hz\]. A line of a 100 s recording is known to about a hundredth of it.
const SAME_LINE_HZ: f64 = 0.03;
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
    /// Whether it explains its frequency by an amplitude that is known.
    fn shows(&self) -> bool {
        self.explained > MIN_EXPLAINED_RATIO && self.amplitude > MIN_DEVIATIONS * self.std
    }

    /// Whether another one is the same line.
    pub(super) fn is_same_line(&self, other: &BaseMotion) -> bool {
        (self.frequency - other.frequency).abs() < SAME_LINE_HZ
    }

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

/// Lines of several runs, and of one run alone those that explain nearly all of what the joints do there; of a single run all.
pub(super) fn plausible(lines: &[BaseMotion], runs: usize) -> Vec<BaseMotion> {
    let has = |one: &BaseMotion, other: &BaseMotion| other.run != one.run && other.is_same_line(one);
    let plausible = |one: &&BaseMotion| {
        runs < 2 || one.explained > MIN_EXPLAINED_RATIO_ALONE || lines.iter().any(|other| has(one, other))
    };
    lines.iter().filter(plausible).cloned().collect()
}

/// The lines of one run that repeats, the strongest first, and what they do to its deviations, P N x n. `rest` are its centred deviations, P N x n.
pub(super) fn base_motions(record: &Record, load: &Load, rest: &DMatrix<f64>) -> (Vec<BaseMotion>, DMatrix<f64>) {
    let mut line = Line::of(record, load, rest.clone());
    let found = line.take_off_strongest();
    (found, rest - &line.parts[0].torque)
}

/// The lines of a run without repeats, the strongest first, by what the plain model leaves there, N x n \[Nm\]. Each half of the run has them.
pub(super) fn base_motions_once(experiment: &Experiment, load: &Load, left: &DMatrix<f64>) -> Vec<BaseMotion> {
    Line::once(experiment, load, left).take_off_strongest()
}

/// A line of another run in this one, within a resolution of its frequency \[Hz\]; `None` where it is not significant. `left` is what the plain model
/// leaves of its torques; a run that repeats has that itself.
pub(super) fn known(experiment: &Experiment, load: &Load, left: &DMatrix<f64>, frequency: f64) -> Option<BaseMotion> {
    let record = Record::of(experiment, 0.0);
    let line = match &record {
        Some(record) => Line::of(record, load, record.centred_all(record.tau.clone())),
        None => Line::once(experiment, load, left),
    };
    let frequency = line.peak(frequency, line.parts[0].width());
    let fitted = line.fit(frequency).filter(|fitted| fitted.gain > MIN_KNOWN_GAIN)?;
    fitted.report(line.run, &line.parts[0], frequency, f64::NAN)
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

/// One line in one run.
struct Line<'a> {
    run: &'a str,
    /// The deviations of the periods and their mean, or the only course. Lines are sought in one after the other.
    parts: Vec<Part<'a>>,
}

/// Cosine and sine of the acceleration, with what they explain.
struct Fitted {
    theta: DVector<f64>,
    covariance: DMatrix<f64>,
    /// Squares that go, in units of the noise.
    gain: f64,
}

impl<'a> Line<'a> {
    /// Of a run that repeats. Of two periods the deviations hardly tell the amplitude of a line near a harmonic of the motion, the mean does.
    fn of(record: &'a Record, load: &Load, rest: DMatrix<f64>) -> Line<'a> {
        let gravity = gravity_columns(&record.motion, load);
        let mean = blocks(&record.repeats.mean, record.step);
        let part = |rows, torque| Part::new(rows, gravity.clone(), torque, record.step, record.dt);
        let parts = vec![part(Rows::Deviations(record), rest), part(Rows::Mean(record.experiment), mean)];
        Line { run: &record.experiment.name, parts }
    }

    /// Of a run without repeats, by what the plain model leaves, N x n at the full rate \[Nm\].
    fn once(experiment: &'a Experiment, load: &Load, left: &DMatrix<f64>) -> Line<'a> {
        let step = max_step(&experiment.motion);
        let motion = on_grid(&experiment.motion, step);
        let gravity = gravity_columns(&motion, load);
        let part = Part::new(Rows::Mean(experiment), gravity, blocks(left, step), step, motion.dt);
        Line { run: &experiment.name, parts: vec![part] }
    }

    /// Takes the lines off the parts, the strongest first.
    fn take_off_strongest(&mut self) -> Vec<BaseMotion> {
        let mut found: Vec<BaseMotion> = Vec::new();
        while found.len() < MAX_LINES {
            let Some(one) = self.strongest() else { break };
            self.parts.iter_mut().for_each(|part| part.take_off(&one));
            found.push(one);
        }
        found
    }

    fn strongest(&self) -> Option<BaseMotion> {
        self.parts.iter().find_map(|part| self.strongest_in(part))
    }

    fn strongest_in(&self, part: &Part) -> Option<BaseMotion> {
        let power = part.spectrum();
        let near = (NEIGHBOURS_HZ / part.width()).round().max(8.0) as usize;
        let ratio = |k: usize| {
            let around = k.saturating_sub(near)..(k + near + 1).min(power.len());
            let mut others: Vec<f64> = around.map(|other| power[other].1).collect();
            power[k].1 / median(&mut others).max(f64::MIN_POSITIVE)
        };
        let lines = (0..power.len()).map(|k| (k, ratio(k)));
        let mut strong: Vec<(usize, f64)> = lines.filter(|(_, ratio)| *ratio > MIN_LINE_POWER_RATIO).collect();
        strong.sort_by(|a, b| power[b.0].1.total_cmp(&power[a.0].1));
        strong.into_iter().take(MAX_LINES).find_map(|(k, ratio)| {
            let frequency = self.peak(power[k].0, part.width());
            let found = self.fit(frequency)?.report(self.run, part, frequency, ratio)?;
            (found.shows() && part.goes_on(frequency)).then_some(found)
        })
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

    /// Least squares in all parts.
    fn fit(&self, frequency: f64) -> Option<Fitted> {
        let mut normal = Normal::default();
        self.parts.iter().for_each(|part| part.add_to(&mut normal, frequency, |_| true));
        normal.solved()
    }
}

impl Fitted {
    fn report(&self, run: &str, part: &Part, frequency: f64, ratio: f64) -> Option<BaseMotion> {
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
            run: run.into(),
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
        let tau = part.of_line(&found);
        found.rms = tau.column_iter().map(|own| (own.norm_squared() / own.len() as f64).sqrt()).collect();
        found.explained = part.explained(frequency, &part.centred(tau));
        Some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_that_no_other_run_has_explains_nearly_all_of_its_frequency() {
        let line = |run: &str, frequency: f64, explained: f64| BaseMotion {
            run: run.into(),
            frequency,
            explained,
            amplitude: 0.05,
            std: 0.005,
            direction: Vector3::x(),
            cosine: Vector3::x(),
            sine: Vector3::zeros(),
            ratio: 20.0,
            rms: Vec::new(),
        };
        let (weak, other, clear) = (line("a", 0.62, 0.74), line("b", 0.63, 0.6), line("b", 5.0, 0.95));
        let kept = |lines: &[&BaseMotion], runs: usize| {
            plausible(&lines.iter().map(|&one| one.clone()).collect::<Vec<_>>(), runs)
        };
        assert_eq!(kept(&[&weak, &clear], 3), vec![clear.clone()]);
        assert_eq!(kept(&[&weak, &other], 3), vec![weak.clone(), other]);
        assert_eq!(kept(&[&weak, &line("a", 0.61, 0.8)], 3), Vec::new(), "twice in one run");
        assert_eq!(kept(&[&weak], 1), vec![weak.clone()], "no other run could have it");
        assert!(weak.shows() && !BaseMotion { std: 0.013, ..weak.clone() }.shows(), "an amplitude that is not known");
        assert!(!BaseMotion { explained: 0.4, ..weak }.shows());
    }
}
