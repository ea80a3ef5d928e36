//! Identification of base parameters and their standard deviations from measured motion.
//!
//! [`Run`] (measured samples) -> [`Experiment`] (averaged, filtered, differentiated) -> [`solve::identify_with`] an estimator ->
//! [`solve::Identification`]. [`validate()`] measures the error of any model on any experiment.
//!
//! | what | items |
//! |---|---|
//! | signal processing | [`Experiment`], [`Settings`], [`signal`] |
//! | estimators: OLS, WLS, Huber, TLS, IV | [`solve`] |
//! | prediction intervals of torques | [`TorqueUncertainty`] |
//! | external torque, contact | [`external`] |
//! | the body on the last link, against a stored model | [`payload`] |
//! | recursive least squares (not used by the program yet) | [`streaming`] |
//! | nearest physically consistent parameters | [`consistency`] |
//! | mounting and direction of gravity from torques | [`cross_check`], [`direction()`] |
//! | plausibility of an offered model | [`plausible`] |
//! | checks of recorded runs before they are fitted | [`check`] |
//!
//! ```
//! use nalgebra::DMatrix;
//! use plumbline_identify::{Experiment, Run, Settings, solve};
//! use plumbline_model::{Chain, Joint, JointKind, Mounting, Placement, Reduction, Structure};
//! use std::f64::consts::TAU;
//!
//! // One joint about the vertical: tau = 0.5 ddq + 0.2 dq.
//! let joint = Joint { kind: JointKind::Revolute, a: 0.0, alpha: 0.0, d: 0.0, theta: 0.0 };
//! let chain = Chain::modified(vec![joint], Placement::identity());
//! let t: Vec<f64> = (0..10_000).map(|k| k as f64 * 1e-3).collect();
//! let (amplitude, omega) = (0.5, TAU / 2.0);
//! let q = |t: f64| amplitude * (omega * t).sin();
//! let tau = |t: f64| -0.5 * amplitude * omega * omega * (omega * t).sin() + 0.2 * amplitude * omega * (omega * t).cos();
//! let run = Run {
//!     name: "sine".into(),
//!     q: DMatrix::from_fn(t.len(), 1, |k, _| q(t[k])),
//!     dq: None,
//!     tau: DMatrix::from_fn(t.len(), 1, |k, _| tau(t[k])),
//!     t,
//!     mounting: Mounting::UPRIGHT,
//!     period: Some(2.0),
//! };
//! let structure = Structure::of(chain.clone(), Reduction::in_mounting(&chain, &Mounting::UPRIGHT), &["friction"])?;
//! let found = solve::identify(&structure, &[Experiment::prepare(&run, &Settings::default())?])?;
//! assert!((found.beta[0] - 0.5).abs() < 1e-3, "{:?}", found.beta);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

pub mod check;
pub mod consistency;
mod covariance;
mod differentiate;
mod direction;
mod essential;
mod even;
mod experiment;
pub mod external;
mod faults;
mod gaps;
mod mounting_check;
pub mod payload;
mod periods;
mod plausibility;
mod prediction;
mod run;
mod settings;
mod settling;
pub mod signal;
pub mod solve;
pub mod streaming;
mod timeline;
mod validate;

pub use covariance::Spread;
pub use direction::{Direction, DirectionError, Pose, direction, wrong_sign};
pub use essential::Dropped;
pub use experiment::{Experiment, Repeats};
pub use mounting_check::{Disagreement, GravitySource, ImpliedGravity, cross_check, implied_gravity};
pub use periods::{NoisePower, Scatter};
pub use plausibility::{Implausible, plausible};
pub use prediction::TorqueUncertainty;
pub use run::Run;
pub use settings::{Derivative, ExcludedSpan, Method, Settings};
pub use timeline::Timeline;
pub use validate::{Modelled, Rms, compare, validate, validate_parameters};

/// Error of preparing runs and identifying parameters.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum EstimateError {
    /// A run's samples could not be processed.
    #[error("run {run}: {source}")]
    Signal { run: String, source: signal::SignalError },
    #[error("run {run}: {found} whole periods of {period} s after leaving out {skipped}: expected at least 1")]
    Periods { run: String, found: usize, skipped: usize, period: f64 },
    #[error("run {run}: period {period} s at a step of {dt} s: expected at least 16 samples a period")]
    Period { run: String, period: f64, dt: f64 },
    /// The run has another number of joints than the model.
    #[error("run {run} has {found} joints, the model {expected}")]
    Joints { run: String, found: usize, expected: usize },
    #[error("{rows} equations after decimation for {columns} parameters")]
    TooFewRows { rows: usize, columns: usize },
    /// Instrumental variables without an instrument.
    #[error("run {run} has neither two periods nor a desired motion (q_d1..q_dn): expected one of them as instrument")]
    NoInstruments { run: String },
    /// A singular value decomposition did not converge; does not occur with finite data.
    #[error("the regressor of {rows} x {columns} has no singular value decomposition (are all samples finite?)")]
    Decomposition { rows: usize, columns: usize },
}
