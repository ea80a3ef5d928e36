//! `Model` and `Status`.

use crate::arrays::{States, vector};
use crate::{errors, locked};
use numpy::PyArrayDyn;
use plumbline_client::{Expected, Fault};
use plumbline_core::Validity;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use std::path::PathBuf;
use std::sync::Mutex;
use std::time::Duration;

type Array<'py> = PyResult<Bound<'py, PyArrayDyn<f64>>>;

/// Identity, validity and age of a model.
#[pyclass(frozen, get_all, module = "plumbline")]
pub struct Status {
    /// Identity of the model that the next call uses, 0 for none.
    model: u64,
    /// "none", "valid", "hand-over", "withdrawn" or "doubtful".
    validity: &'static str,
    /// Time since the daemon was last found running [s]; 0 for a file.
    age: f64,
}

#[pymethods]
impl Status {
    fn __repr__(&self) -> String {
        format!("Status(model={:#018x}, validity='{}', age={:.3})", self.model, self.validity, self.age)
    }
}

/// A validity in words.
pub fn words(validity: Validity) -> &'static str {
    match validity {
        Validity::None => "none",
        Validity::Valid => "valid",
        Validity::HandOver => "hand-over",
        Validity::Withdrawn => "withdrawn",
        Validity::Doubtful => "doubtful",
    }
}

/// A time in seconds.
///
/// # Errors
/// `ValueError` for what is none.
pub fn seconds(name: &str, value: f64) -> PyResult<Duration> {
    Duration::try_from_secs_f64(value)
        .map_err(|_| PyValueError::new_err(format!("{name} is {value}, expected a time in s, 0 or more")))
}

/// The identified model of an arm's torques, evaluated at the caller's states.
///
/// States are arrays of n values, or one state per row. Angles in rad, torques in Nm (prismatic joints: m, N).
///
/// Terms with a memory (presliding, backlash, delay, elasticity) take every state of `torque` as the next sample, one `period` after the
/// one before. For states that are not the arm's make a second Model.
#[pyclass(frozen, module = "plumbline")]
pub struct Model(Mutex<plumbline_client::Model>);

#[pymethods]
impl Model {
    /// The model of a file under `gravity`, 3 values in the base frame [m/s2]: `plumbline.gravity("upright")`.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf, gravity: &Bound<'_, PyAny>) -> PyResult<Model> {
        let gravity = vector("gravity", gravity)?;
        let loaded = py.detach(|| plumbline_client::Model::load(&path, gravity));
        loaded.map(|model| Model(Mutex::new(model))).map_err(|error| errors::client(py, &error))
    }

    /// The model that the daemon of `robot` (key `serve.id` of its job) serves, followed by a thread until this object is deleted.
    ///
    /// Waits up to `timeout` seconds for daemon and model. A model of another robot than `expected_robot`, or with a gravity more than one
    /// degree from `expected_gravity` [m/s2], is refused.
    #[staticmethod]
    #[pyo3(signature = (robot, *, expected_robot=None, expected_gravity=None, timeout=5.0))]
    fn follow(
        py: Python<'_>,
        robot: &str,
        expected_robot: Option<String>,
        expected_gravity: Option<&Bound<'_, PyAny>>,
        timeout: f64,
    ) -> PyResult<Model> {
        let gravity = expected_gravity.map(|gravity| vector("expected_gravity", gravity)).transpose()?;
        let (expected, timeout) = (Expected { robot: expected_robot, gravity }, seconds("timeout", timeout)?);
        let followed = py.detach(|| plumbline_client::Model::follow(robot, expected, timeout));
        followed.map(|model| Model(Mutex::new(model))).map_err(|error| errors::client(py, &error))
    }

    /// Raises what following the daemon has last failed at.
    fn check_daemon(&self, py: Python<'_>) -> PyResult<()> {
        let trouble = py.detach(|| locked(&self.0).trouble());
        trouble.map_or(Ok(()), |error| Err(errors::client(py, &error)))
    }

    /// Identity and validity of the model, and time since the daemon was found running.
    fn status(&self, py: Python<'_>) -> Status {
        let now = py.detach(|| locked(&self.0).status());
        Status { model: now.model, validity: words(now.validity), age: now.age_ns as f64 * 1e-9 }
    }

    /// Number of joints.
    #[getter]
    fn joints(&self, py: Python<'_>) -> PyResult<usize> {
        self.sized(py, |_, _| Vec::new()).map(|(n, _)| n)
    }

    /// Number of columns of the regressor.
    #[getter]
    fn columns(&self, py: Python<'_>) -> PyResult<usize> {
        self.sized(py, |_, p| vec![p]).map(|(_, shape)| shape[0])
    }

    /// Sets the period of the calls of `torque` [s]; 1 ms unless set.
    fn set_period(&self, py: Python<'_>, period: f64) -> PyResult<()> {
        if !(period.is_finite() && period > 0.0) {
            return Err(PyValueError::new_err(format!("period is {period}, expected a time in s above 0")));
        }
        py.detach(|| locked(&self.0).set_period(period));
        Ok(())
    }

    /// Torque that the arm needs: all terms of the model [Nm]. `gravity` is the model's own unless 3 values are given [m/s2].
    #[pyo3(signature = (q, dq, ddq, gravity=None))]
    fn torque<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        dq: &Bound<'py, PyAny>,
        ddq: &Bound<'py, PyAny>,
        gravity: Option<&Bound<'py, PyAny>>,
    ) -> Array<'py> {
        let gravity = gravity.map(|gravity| vector("gravity", gravity)).transpose()?;
        self.at(
            py,
            &[("q", q), ("dq", dq), ("ddq", ddq)],
            |n, _| vec![n],
            move |model, state, tau| model.torque(state[0], state[1], state[2], gravity, tau),
        )
    }

    /// Torque of gravity on links and payload at rest at `q` [Nm].
    fn gravity<'py>(&self, py: Python<'py>, q: &Bound<'py, PyAny>) -> Array<'py> {
        self.at(py, &[("q", q)], |n, _| vec![n], |model, state, tau| model.gravity(state[0], tau))
    }

    /// Centrifugal and Coriolis torques [Nm].
    fn coriolis<'py>(&self, py: Python<'py>, q: &Bound<'py, PyAny>, dq: &Bound<'py, PyAny>) -> Array<'py> {
        self.at(
            py,
            &[("q", q), ("dq", dq)],
            |n, _| vec![n],
            |model, state, tau| model.coriolis(state[0], state[1], tau),
        )
    }

    /// Viscous and Coulomb friction [Nm].
    fn friction<'py>(&self, py: Python<'py>, dq: &Bound<'py, PyAny>) -> Array<'py> {
        self.at(py, &[("dq", dq)], |n, _| vec![n], |model, state, tau| model.friction(state[0], tau))
    }

    /// Joint-space inertia matrix of links, payload and rotors, n x n [kg m2].
    fn inertia<'py>(&self, py: Python<'py>, q: &Bound<'py, PyAny>) -> Array<'py> {
        self.at(py, &[("q", q)], |n, _| vec![n, n], |model, state, matrix| model.inertia(state[0], matrix))
    }

    /// Regressor Y under the model's own gravity, n x p: torque = Y beta with the parameters of the model file.
    fn regressor<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        dq: &Bound<'py, PyAny>,
        ddq: &Bound<'py, PyAny>,
    ) -> Array<'py> {
        let mut columns = Vec::new();
        self.at(
            py,
            &[("q", q), ("dq", dq), ("ddq", ddq)],
            |n, p| vec![n, p],
            move |model, state, y| {
                columns.resize(y.len(), 0.0);
                model.regressor(state[0], state[1], state[2], &mut columns)?;
                let n = state[0].len();
                let p = y.len() / n.max(1);
                for (j, row) in y.chunks_exact_mut(p.max(1)).enumerate() {
                    row.iter_mut().enumerate().for_each(|(c, value)| *value = columns[c * n + j]);
                }
                Ok(())
            },
        )
    }

    /// Standard deviation of the torque by the covariance of the parameters [Nm].
    fn torque_std<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        dq: &Bound<'py, PyAny>,
        ddq: &Bound<'py, PyAny>,
    ) -> Array<'py> {
        self.at(
            py,
            &[("q", q), ("dq", dq), ("ddq", ddq)],
            |n, _| vec![n],
            |model, state, std| model.torque_std(state[0], state[1], state[2], std),
        )
    }
}

impl Model {
    /// Number of joints, and a shape from the numbers of joints and columns.
    fn sized(
        &self,
        py: Python<'_>,
        shape: impl FnOnce(usize, usize) -> Vec<usize> + Send,
    ) -> PyResult<(usize, Vec<usize>)> {
        let sizes = py.detach(move || {
            let mut model = locked(&self.0);
            let n = model.joints()?;
            Ok((n, shape(n, model.columns()?)))
        });
        sizes.map_err(|fault| errors::fault(fault, ""))
    }

    /// `call` at every state.
    fn at<'py>(
        &self,
        py: Python<'py>,
        inputs: &[(&str, &Bound<'py, PyAny>)],
        shape: impl FnOnce(usize, usize) -> Vec<usize> + Send,
        call: impl FnMut(&mut plumbline_client::Model, &[&[f64]], &mut [f64]) -> Result<(), Fault> + Send,
    ) -> Array<'py> {
        let states = States::of(inputs)?;
        let (_, shape) = self.sized(py, shape)?;
        states.evaluate(py, &self.0, &shape, call)
    }
}
