//! `FeedForward` and `Torque`.

use crate::model::{seconds, words};
use crate::{errors, locked};
use numpy::{IntoPyArray, PyArray1};
use plumbline_client::{FeedForwardClient, FeedForwardSettings, Latest, Presence, RobotId};
use plumbline_core::Phase;
use pyo3::prelude::*;
use std::sync::Mutex;

/// Feed-forward torque of the daemon's own motion in one cycle.
#[pyclass(frozen, module = "plumbline")]
pub struct Torque(Latest);

#[pymethods]
impl Torque {
    /// Feed-forward torque [Nm].
    #[getter]
    fn tau<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.values(py, &self.0.message.tau_ff)
    }

    /// Part of it that the arm's own controller adds [Nm]: send `tau - tau_vendor`.
    #[getter]
    fn tau_vendor<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.values(py, &self.0.message.tau_vendor)
    }

    /// Desired position [rad].
    #[getter]
    fn q_d<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.values(py, &self.0.message.q_d)
    }

    /// Desired velocity [rad/s].
    #[getter]
    fn dq_d<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.values(py, &self.0.message.dq_d)
    }

    /// Gravitational acceleration in the base frame [m/s2].
    #[getter]
    fn gravity<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.0.message.gravity.to_vec().into_pyarray(py)
    }

    /// Gravitational acceleration that the arm's own controller compensates [m/s2].
    #[getter]
    fn gravity_vendor<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        self.0.message.gravity_vendor.to_vec().into_pyarray(py)
    }

    /// Number of the value since the daemon's start, from 1.
    #[getter]
    fn sequence(&self) -> u64 {
        self.0.message.sequence
    }

    /// Identity of the daemon's start.
    #[getter]
    fn epoch(&self) -> u64 {
        self.0.message.epoch
    }

    /// Identity of the served model, 0 for none.
    #[getter]
    fn model(&self) -> u64 {
        self.0.message.model
    }

    /// "none", "valid", "hand-over", "withdrawn" or "doubtful".
    #[getter]
    fn validity(&self) -> &'static str {
        words(self.0.message.validity().unwrap_or_default())
    }

    /// "hold", "approach", "excite", "return", "stop" or "stopped".
    #[getter]
    fn phase(&self) -> &'static str {
        match self.0.message.phase().unwrap_or_default() {
            Phase::Hold => "hold",
            Phase::Approach => "approach",
            Phase::Excite => "excite",
            Phase::Return => "return",
            Phase::Stop => "stop",
            Phase::Stopped => "stopped",
        }
    }

    /// Time from the arm's state to the call that returned this value [s]; of a daemon on another machine, the part beyond the fastest transit of
    /// the last 5 to 10 s of values.
    #[getter]
    fn age(&self) -> f64 {
        self.0.age_ns as f64 * 1e-9
    }

    /// Whether it is older than `stale_after`.
    #[getter]
    fn stale(&self) -> bool {
        self.0.stale
    }

    /// Whether the torque may be used: not stale, and a model is served.
    #[getter]
    fn usable(&self) -> bool {
        self.0.usable
    }

    fn __repr__(&self) -> String {
        let (message, age) = (&self.0.message, self.age());
        let tau: Vec<String> = message.torque().iter().map(|tau| format!("{tau:.4}")).collect();
        let (validity, model) = (self.validity(), message.model);
        let sequence = message.sequence;
        format!(
            "Torque(sequence={sequence}, age={age:.6}, model={model:#018x}, validity='{validity}', tau=[{}])",
            tau.join(", ")
        )
    }
}

impl Torque {
    fn values<'py>(&self, py: Python<'py>, values: &[f64]) -> Bound<'py, PyArray1<f64>> {
        values[..self.0.message.torque().len()].to_vec().into_pyarray(py)
    }
}

/// Client of the feed-forward torque of the daemon's own motion.
#[pyclass(frozen, module = "plumbline")]
pub struct FeedForward(Mutex<FeedForwardClient>);

#[pymethods]
impl FeedForward {
    /// Connects to the daemon of `robot` (key `serve.id` of its job), waiting up to `timeout` seconds for it. A value older than `stale_after`
    /// seconds (rounded up to milliseconds) is stale.
    #[new]
    #[pyo3(signature = (robot, *, stale_after=0.005, timeout=5.0))]
    fn new(py: Python<'_>, robot: &str, stale_after: f64, timeout: f64) -> PyResult<FeedForward> {
        let id = RobotId::parse("the call", "robot", robot).map_err(|bad| errors::bad_input(py, &bad))?;
        let stale_after = seconds("stale_after", stale_after)?;
        let settings = FeedForwardSettings { stale_after_ms: stale_after.as_micros().div_ceil(1000) as u64 };
        let timeout = seconds("timeout", timeout)?;
        let connected = py.detach(|| FeedForwardClient::connect(&id, settings, timeout).map(Mutex::new));
        connected.map(FeedForward).map_err(|error| errors::ipc(&error))
    }

    /// The latest value with its present age, None before the first, and before the second of a daemon on another machine. The same value is returned until a newer one arrives.
    fn latest(&self, py: Python<'_>) -> PyResult<Option<Torque>> {
        let latest = py.detach(|| locked(&self.0).latest());
        latest.map(|latest| latest.map(Torque)).map_err(|error| errors::ipc(&error))
    }

    /// Whether the daemon's process (on another machine: the tunnel's) runs. Reads files.
    #[getter]
    fn running(&self, py: Python<'_>) -> bool {
        py.detach(|| locked(&self.0).daemon() == Presence::Running)
    }
}
