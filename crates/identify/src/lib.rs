//! Floor 2: from measured samples to base parameters with honest standard deviations.
//!
//! [`run::Run`] (samples as they came) -> [`experiment::Experiment`] (averaged, filtered, differentiated) ->
//! [`solve::identify_with`] an estimator of choice -> [`solve::Identification`]; [`validate::validate`] measures any model on any
//! experiment.

#![forbid(unsafe_code)]

pub mod consistency;
mod covariance;
mod differentiate;
mod direction;
mod essential;
mod experiment;
mod mounting_check;
mod periods;
mod plausibility;
mod run;
mod settings;
pub mod signal;
pub mod solve;
pub mod streaming;
mod validate;

pub use covariance::Spread;
pub use direction::{Direction, DirectionError, Pose, direction, wrong_sign};
pub use essential::Dropped;
pub use experiment::{Experiment, Repeats};
pub use mounting_check::{Disagreement, Implied, Side, cross_check, implied};
pub use periods::Scatter;
pub use plausibility::{Implausible, plausible};
pub use run::Run;
pub use settings::{Derivative, LeftOut, Method, Settings};
pub use validate::{Modelled, Rms, compare, torques, validate, validate_parameters};

/// Why samples could not be turned into parameters.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EstimateError {
    /// A run's samples could not be processed.
    #[error("run {run}: {source}")]
    Signal {
        /// Name of the run.
        run: String,
        /// What was wrong.
        source: signal::SignalError,
    },
    /// The run has fewer whole periods than are needed.
    #[error("run {run}: {found} whole periods of {period} s after leaving out {skipped}: expected at least 1")]
    Periods {
        /// Name of the run.
        run: String,
        /// Whole periods found.
        found: usize,
        /// Periods left out at the start.
        skipped: usize,
        /// The period \[s\].
        period: f64,
    },
    /// The period is no positive number of samples.
    #[error("run {run}: period {period} s at a step of {dt} s: expected at least 16 samples a period")]
    Period {
        /// Name of the run.
        run: String,
        /// The period \[s\].
        period: f64,
        /// Time between samples \[s\].
        dt: f64,
    },
    /// The run is of another arm.
    #[error("run {run} has {found} joints, the model {expected}")]
    Joints {
        /// Name of the run.
        run: String,
        /// Joints of the run.
        found: usize,
        /// Joints of the model.
        expected: usize,
    },
    /// There are fewer equations than parameters.
    #[error("{rows} equations after decimation for {columns} parameters")]
    TooFewRows {
        /// Equations.
        rows: usize,
        /// Parameters.
        columns: usize,
    },
    /// Instrumental variables without an instrument.
    #[error("run {run} has neither two periods nor a desired motion (q_d1..q_dn): expected one of them as instrument")]
    NoInstruments {
        /// Name of the run.
        run: String,
    },
    /// A singular value decomposition did not converge, which finite data does not cause.
    #[error("the regressor of {rows} x {columns} has no singular value decomposition (are all samples finite?)")]
    Decomposition {
        /// Rows.
        rows: usize,
        /// Columns.
        columns: usize,
    },
}
