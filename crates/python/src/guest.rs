//! `Guest`.

use crate::arrays::States;
use crate::{errors, locked};
use pyo3::prelude::*;
use std::sync::Mutex;

/// Publishes the states of one arm that the caller controls; needs no daemon. Deleting it sends what is queued.
#[pyclass(frozen, module = "plumbline")]
pub struct Guest(Mutex<plumbline_client::Guest>);

#[pymethods]
impl Guest {
    /// Opens the publisher of `robot` (key `serve.id` of the daemon's job, or the robot's name) with `joints` joints.
    #[new]
    fn new(py: Python<'_>, robot: &str, joints: usize) -> PyResult<Guest> {
        let opened = py.detach(|| plumbline_client::Guest::open(robot, joints));
        opened.map(|guest| Guest(Mutex::new(guest))).map_err(|error| errors::client(py, &error))
    }

    /// Publishes the state of one cycle, stamped with the present time: measured position [rad], velocity [rad/s] and torque with gravity [Nm],
    /// and desired position [rad].
    fn publish(
        &self,
        q: &Bound<'_, PyAny>,
        dq: &Bound<'_, PyAny>,
        tau: &Bound<'_, PyAny>,
        q_d: &Bound<'_, PyAny>,
    ) -> PyResult<()> {
        let states = States::of(&[("q", q), ("dq", dq), ("tau", tau), ("q_d", q_d)])?;
        let [q, dq, tau, q_d] = states.one()?;
        locked(&self.0).publish(q, dq, tau, q_d).map_err(|fault| errors::fault(fault, ""))
    }

    /// Samples lost on this side so far.
    #[getter]
    fn lost(&self) -> u64 {
        locked(&self.0).lost()
    }
}
