//! External torque of an arm: measured less modelled torque, with its interval and a flag for contact.
//!
//!   tau_ext = F(tau_J - tau_model(q, dq, ddq))
//!
//! with `F` a causal low-pass of second order ([`Residue`]). It is the torque that the arm exerts beyond its model: a force `f` **on** the arm at a point
//! with Jacobian `J` gives `tau_ext = -J' f`.
//!
//! | way | how | source |
//! |---|---|---|
//! | [`Way::Momentum`] | `F(tau_J - tau_model(q, dq, 0) + Mdot dq) - F(dp/dt)`, `p = M dq`; `F d/dt` is one proper filter, so that no acceleration is formed | generalised momentum observer: De Luca, Mattone, ICRA 2005; Haddadin, De Luca, Albu-Schaeffer, T-RO 33(6), 2017 |
//! | [`Way::Acceleration`] | `F(tau_J) - tau_model(F q, F dq, F d/dt dq)`: all signals late alike | the same survey, "direct estimation" |
//!
//! The two differ where the model is not linear in the motion within the delay: friction that reverses is filtered by the first, and stepped by the second.
//!
//! **Interval.** The variance is `y C y' + s^2`: `y` the joint's row of the regressor, `C` the covariance of the parameters, `s^2` the power of the
//! identification's own residual behind the same filter ([`ResidualSpectrum`]): torque and velocity noise and all that the model lacks.
//!
//! **Contact** is flagged where a joint exceeds `u` standard deviations, with `u` from the rate of false alarms over all joints that is accepted (Rice
//! 1945). The rate holds for a Gaussian residual of the spectrum of the identification.

mod filter;
mod spectrum;

pub use filter::{Memory, Residue};
pub use spectrum::{Noise, ResidualSpectrum};

use crate::differentiate::Differentiator;
use crate::even::Even;
use crate::prediction::TorqueUncertainty;
use crate::signal::SignalError;
use crate::{Derivative, EstimateError, Run, Settings, Spread};
use nalgebra::{DMatrix, Vector3};
use plumbline_core::{JointVec, MAX_JOINTS, Torque};
use plumbline_model::term::Sample;
use plumbline_model::{Evaluator, LoopRegressor, ModelError, TorqueModel};

/// Step of the differences of the inertia matrix along the motion \[s\].
const STEP_S: f64 = 1e-4;
/// Quantile of the normal distribution for an interval of 95 %.
const NORMAL_975: f64 = 1.959_963_984_540_054;
/// Position cut-off for velocities of a recording without any \[Hz\].
const DERIVED_CUTOFF_HZ: f64 = 20.0;
/// Maximum ratio of that cut-off to the sampling rate.
const MAX_RATE_RATIO: f64 = 0.4;
/// Length of a recording that the spectrum is computed from \[s\].
const MAX_RECORDING_S: f64 = 60.0;
/// Seconds of an hour.
const HOUR_S: f64 = 3600.0;

/// How the external torque is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Way {
    /// Generalised momentum: no acceleration is formed.
    #[default]
    Momentum,
    /// From accelerations: differences of the velocities, behind the same low-pass.
    Acceleration,
}

/// Settings of an observer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObserverSettings {
    /// How the external torque is found.
    pub way: Way,
    /// Half-power frequency of the low-pass \[Hz\].
    pub bandwidth: f64,
    /// Accepted false alarms an hour, over all joints.
    pub false_alarms: f64,
    /// Period of the calls \[s\].
    pub dt: f64,
}

impl Default for ObserverSettings {
    /// By momentum, 20 Hz (11 ms late), one false alarm in ten hours, 1 kHz.
    fn default() -> ObserverSettings {
        ObserverSettings { way: Way::Momentum, bandwidth: 20.0, false_alarms: 0.1, dt: plumbline_core::PERIOD_S }
    }
}

impl ObserverSettings {
    /// The low-pass of these settings.
    ///
    /// # Errors
    /// Settings out of range.
    pub fn check(&self) -> Result<Residue, ObserverError> {
        if !(self.false_alarms > 0.0 && self.false_alarms.is_finite()) {
            return Err(ObserverError::FalseAlarms(self.false_alarms));
        }
        Ok(Residue::new(self.bandwidth, self.dt)?)
    }
}

/// External torque of one sample; entries past the arm's joints are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct External {
    /// Torque that the arm exerts beyond its model \[Nm\].
    pub tau: JointVec,
    /// Half the width of its 95 % interval \[Nm\].
    pub half_width: JointVec,
    /// Torque beyond which a joint's contact is flagged \[Nm\].
    pub threshold: JointVec,
    /// Whether the filter has settled. Before, no contact is flagged.
    pub settled: bool,
    /// Whether a joint is beyond its threshold.
    pub contact: bool,
}

/// Why a model has no observer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum ObserverError {
    #[error(transparent)]
    Model(#[from] ModelError),
    #[error(transparent)]
    Signal(#[from] SignalError),
    #[error(transparent)]
    Run(#[from] EstimateError),
    #[error("the model file has no [uncertainty] with a residual spectrum; identify again with this version")]
    NoSpectrum,
    #[error("{0} false alarms an hour: expected a number above 0")]
    FalseAlarms(f64),
}

/// The external torque, sample by sample. [`ExternalObserver::next`] neither allocates, locks nor panics.
pub struct ExternalObserver {
    settings: ObserverSettings,
    joints: usize,
    /// All terms of the model; their memories are this observer's own.
    torque: Evaluator,
    /// The part with inertia under no gravity.
    weightless: Evaluator,
    regressor: LoopRegressor,
    parameters: Spread,
    spectrum: ResidualSpectrum,
    filter: Residue,
    noise: [Noise; MAX_JOINTS],
    /// Thresholds in standard deviations.
    levels: JointVec,
    seen: u64,
    residue: [Memory; MAX_JOINTS],
    /// Of position, velocity and acceleration, which the variance and [`Way::Acceleration`] are computed at.
    smooth: [[Memory; MAX_JOINTS]; 3],
}

impl ExternalObserver {
    /// The observer of `model` under `gravity` in the base frame \[m/s2\].
    ///
    /// # Errors
    /// A model without a spectrum of its residual, settings out of range, terms that cannot be evaluated.
    pub fn new(
        model: &TorqueModel,
        uncertainty: &TorqueUncertainty,
        gravity: &Vector3<f64>,
        settings: ObserverSettings,
    ) -> Result<ExternalObserver, ObserverError> {
        let spectrum = uncertainty.residual_spectrum.as_ref().ok_or(ObserverError::NoSpectrum)?;
        ExternalObserver::with_noise(model, &uncertainty.parameters, spectrum, gravity, settings)
    }

    fn with_noise(
        model: &TorqueModel,
        parameters: &Spread,
        spectrum: &ResidualSpectrum,
        gravity: &Vector3<f64>,
        settings: ObserverSettings,
    ) -> Result<ExternalObserver, ObserverError> {
        let mut observer = ExternalObserver {
            settings,
            joints: model.structure().chain().len(),
            torque: model.evaluator(gravity),
            weightless: model.inertial()?.evaluator(&Vector3::zeros()),
            regressor: LoopRegressor::new(model, gravity)?,
            parameters: parameters.clone(),
            spectrum: spectrum.clone(),
            filter: settings.check()?,
            noise: [Noise::default(); MAX_JOINTS],
            levels: JointVec::default(),
            seen: 0,
            residue: Default::default(),
            smooth: Default::default(),
        };
        observer.configure(settings)?;
        Ok(observer)
    }

    /// Other settings; begins anew. Neither allocates nor panics.
    ///
    /// # Errors
    /// Settings out of range; those before stay.
    pub fn configure(&mut self, settings: ObserverSettings) -> Result<(), ObserverError> {
        self.filter = settings.check()?;
        self.settings = settings;
        self.noise = self.spectrum.behind(&self.filter);
        let rate = settings.false_alarms / HOUR_S / self.joints.max(1) as f64;
        self.levels = self.noise.map(|noise| noise.threshold(rate));
        self.torque.every(settings.dt);
        self.regressor.every(settings.dt);
        self.seen = 0;
        Ok(())
    }

    /// Delay of the external torque \[s\].
    pub fn delay(&self) -> f64 {
        self.filter.delay()
    }

    /// Its settings.
    pub fn settings(&self) -> &ObserverSettings {
        &self.settings
    }

    /// Noise of each joint behind the filter, without the uncertainty of the parameters.
    pub fn noise(&self) -> &[Noise] {
        self.noise.get(..self.joints).unwrap_or_default()
    }

    /// The external torque at the next sample: measured position \[rad\], velocity \[rad/s\] and torque \[Nm\].
    pub fn next(&mut self, q: &JointVec, dq: &JointVec, tau: &JointVec) -> External {
        let first = self.seen == 0;
        let [u, p] = match self.settings.way {
            Way::Momentum => self.momentum(q, dq, tau),
            Way::Acceleration => [*tau, JointVec::default()],
        };
        let mut found = External::default();
        let mut late = Sample::default();
        for j in 0..self.joints.min(MAX_JOINTS) {
            let filter = self.filter;
            if first {
                self.residue[j] = match self.settings.way {
                    Way::Momentum => filter.at_rest(p[j]),
                    Way::Acceleration => filter.settled_at(u[j]),
                };
                // As if it had been at this place and speed before.
                self.smooth[0][j] = filter.settled_at(q[j]);
                self.smooth[1][j] = filter.settled_at(dq[j]);
                self.smooth[2][j] = filter.at_rest(-dq[j]);
            }
            found.tau[j] = filter.next(&mut self.residue[j], u[j], p[j]);
            late.q[j] = filter.next(&mut self.smooth[0][j], q[j], 0.0);
            late.dq[j] = filter.next(&mut self.smooth[1][j], dq[j], 0.0);
            late.ddq[j] = filter.next(&mut self.smooth[2][j], 0.0, -dq[j]);
        }
        if self.settings.way == Way::Acceleration {
            let Torque(model) = self.torque.torque(&late);
            found.tau.iter_mut().zip(&model).for_each(|(tau, model)| *tau -= model);
        }
        self.seen += 1;
        found.settled = self.seen > self.filter.settling();
        let variance = self.parameters.variance(self.regressor.at(&late));
        for (j, variance) in variance.iter().enumerate().take(self.joints) {
            let std = (variance + self.noise[j].std.powi(2)).sqrt();
            found.half_width[j] = NORMAL_975 * std;
            found.threshold[j] = self.levels[j] * std;
            found.contact |= found.settled && found.tau[j].abs() > found.threshold[j];
        }
        found
    }

    /// `tau - (tau_model(q, dq, 0) - Mdot dq)` and the generalised momentum `M dq`.
    fn momentum(&mut self, q: &JointVec, dq: &JointVec, tau: &JointVec) -> [JointVec; 2] {
        let Torque(rest) = self.torque.torque(&Sample { q: *q, dq: *dq, ..Sample::default() });
        let mut along = |step: f64| {
            let mut sample = Sample { q: *q, ddq: *dq, ..Sample::default() };
            sample.q.iter_mut().zip(dq).for_each(|(q, dq)| *q += step * dq);
            self.weightless.torque(&sample).0
        };
        let [before, p, after] = [along(-STEP_S), along(0.0), along(STEP_S)];
        let mut u = JointVec::default();
        for (j, u) in u.iter_mut().enumerate() {
            *u = tau[j] - rest[j] + (after[j] - before[j]) / (2.0 * STEP_S);
        }
        [u, p]
    }
}

/// Spectrum of what a model leaves over along recordings of free motion, for [`TorqueUncertainty::residual_spectrum`]; `None` where no recording can be
/// processed.
///
/// The residual is that of [`Way::Momentum`] before its low-pass, at measured velocities; where a run has none, at those of its positions behind a
/// zero-phase low-pass of 20 Hz, without the noise that measured ones would have. Spans that `settings` exclude are left out. Runs with another
/// sampling rate than the first are left out; of each run the first minute is used.
pub fn residual_spectrum(model: &TorqueModel, runs: &[&Run], settings: &Settings) -> Option<ResidualSpectrum> {
    let (mut parts, mut step) = (Vec::new(), None);
    for run in runs {
        let Ok((dt, residuals)) = residuals(model, run, settings) else { continue };
        if (*step.get_or_insert(dt) / dt - 1.0).abs() < 1e-3 {
            parts.extend(residuals);
        }
    }
    ResidualSpectrum::of(&parts, 1.0 / step?)
}

/// The external torque along a recording of a whole motion, on its even grid, as a controller would have had it.
#[derive(Clone, Debug)]
pub struct Observed {
    /// Time of the first sample \[s\], and the step of the grid \[s\].
    pub start: f64,
    /// See `start`.
    pub dt: f64,
    /// Delay of the external torque \[s\].
    pub delay: f64,
    /// Measured positions, N x n \[rad\].
    pub q: DMatrix<f64>,
    /// The external torque of every sample, N.
    pub samples: Vec<External>,
}

/// The external torque along a recording at its own sampling rate, which replaces `settings.dt`. Velocities are the measured ones where the run has some
/// and they are asked for, else those of the positions behind a zero-phase low-pass of 20 Hz.
///
/// # Errors
/// As [`ExternalObserver::new`]; samples that can't be processed.
pub fn observe(
    model: &TorqueModel,
    uncertainty: &TorqueUncertainty,
    run: &Run,
    measured_velocities: bool,
    settings: ObserverSettings,
) -> Result<Observed, ObserverError> {
    let Signals { dt, q, dq, tau, .. } = Signals::of(run, measured_velocities)?;
    let settings = ObserverSettings { dt, ..settings };
    let mut observer = ExternalObserver::new(model, uncertainty, &run.mounting.gravity(), settings)?;
    let samples = (0..q.nrows()).map(|k| observer.next(&row(&q, k), &row(&dq, k), &row(&tau, k))).collect();
    Ok(Observed { start: run.t.first().copied().unwrap_or_default(), dt, delay: observer.delay(), q, samples })
}

/// Samples of a recording on an even grid, N x n each.
struct Signals {
    dt: f64,
    q: DMatrix<f64>,
    dq: DMatrix<f64>,
    tau: DMatrix<f64>,
    /// Samples that were lost or spoiled in stretches too long for what was put there to be the signal, N.
    lost: Vec<bool>,
}

impl Signals {
    fn of(run: &Run, measured_velocities: bool) -> Result<Signals, ObserverError> {
        let n = run.joints();
        let as_recorded = Run { period: None, ..run.clone() };
        let even = Even::of(&as_recorded, &Settings { measured_velocities, ..Settings::default() })?;
        let (values, dt) = (even.values, even.sampling.dt);
        let q = values.columns(0, n).into_owned();
        let dq = if values.ncols() > 2 * n {
            values.columns(2 * n, n).into_owned()
        } else {
            let cutoff = DERIVED_CUTOFF_HZ.min(MAX_RATE_RATIO / dt);
            Differentiator::new(4, cutoff, Derivative::Central, false, dt, run.mounting.gravity())?.motion(&q, 0).dq
        };
        Ok(Signals { dt, q, dq, tau: values.columns(n, n).into_owned(), lost: even.long_lines })
    }
}

fn row(of: &DMatrix<f64>, k: usize) -> JointVec {
    let mut row = JointVec::default();
    row.iter_mut().zip(of.row(k).iter()).for_each(|(to, value)| *to = *value);
    row
}

/// An uninterrupted part of a recording: the residuals of each joint.
type Part = Vec<Vec<f64>>;

/// Residuals of one run in the mean of two samples, part by part and joint by joint, and the step of its grid \[s\].
fn residuals(model: &TorqueModel, run: &Run, settings: &Settings) -> Result<(f64, Vec<Part>), ObserverError> {
    let Signals { dt, q, dq, tau, lost: mut out } = Signals::of(run, true)?;
    settings.left_out(&run.name).for_each(|span| span.mark(&mut out, 0, dt));
    let n = run.joints();
    let none = ResidualSpectrum { rate: 1.0 / dt, power: vec![Vec::new(); n] };
    // The low-pass is not used.
    let usual = ObserverSettings { bandwidth: MAX_RATE_RATIO / dt, dt, ..ObserverSettings::default() };
    let parameters = Spread::zero(model.structure().columns().len());
    let mut observer = ExternalObserver::with_noise(model, &parameters, &none, &run.mounting.gravity(), usual)?;
    let mut parts: Vec<Part> = Vec::new();
    let mut last: Option<[JointVec; 2]> = None;
    for (k, out) in out.iter().enumerate().take((MAX_RECORDING_S / dt) as usize) {
        let [u, p] = observer.momentum(&row(&q, k), &row(&dq, k), &row(&tau, k));
        if *out {
            last = None;
            continue;
        }
        match (last.replace([u, p]), parts.last_mut()) {
            (Some([u0, p0]), Some(part)) => {
                for (j, residual) in part.iter_mut().enumerate() {
                    residual.push(0.5 * (u[j] + u0[j]) - (p[j] - p0[j]) / dt);
                }
            }
            _ => parts.push(vec![Vec::new(); n]),
        }
    }
    Ok((dt, parts))
}

#[cfg(test)]
mod tests;
