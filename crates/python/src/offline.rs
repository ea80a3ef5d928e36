//! The offline work, with options as on the command line: `python/plumbline/offline.py` has the functions that users call.

use crate::errors;
use clap::Args;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArrayMethods};
use plumbline::Failure;
use plumbline::config::units::parse_mounting;
use plumbline::offline::plan::{Planned, Purpose};
use plumbline::offline::{self, predict::Prediction};
use plumbline::store::{load_plan, save_plan};
use plumbline_core::BadInput;
use plumbline_excite::{Fourier, Plan, plan_text};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use std::ffi::OsString;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// Interval at which a search looks for Ctrl-C.
const INTERRUPT_INTERVAL: Duration = Duration::from_millis(20);

/// Options from arguments; what the command line prints of a bad one becomes an `InputError`.
fn options<O: Args>(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<O> {
    offline::options(arguments).map_err(|error| {
        let text = error.render().to_string();
        let text = text.split("\n\nUsage:").next().unwrap_or("").trim_start_matches("error: ").to_string();
        errors::bad_input(py, &BadInput::new("the call", "options", text, "an option as on the command line"))
    })
}

/// `work` without the interpreter's lock.
fn released<T: Send>(py: Python<'_>, work: impl FnOnce() -> Result<T, Failure> + Send) -> PyResult<T> {
    py.detach(work).map_err(|failed| errors::failure(py, &failed))
}

/// Identifies and writes the results.
#[pyfunction]
pub fn identify(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<()> {
    let options = options(py, arguments)?;
    released(py, || offline::identify::identify(&options).map(|_| ()))
}

/// Diagnoses and writes the results.
#[pyfunction]
pub fn diagnose(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<()> {
    let options = options(py, arguments)?;
    released(py, || offline::diagnose::diagnose(&options).map(|_| ()))
}

/// Compares and writes the results.
#[pyfunction]
pub fn compare(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<()> {
    let options = options(py, arguments)?;
    released(py, || offline::compare::compare(&options).map(|_| ()))
}

/// The torques of a model along a motion, by name.
#[pyfunction]
pub fn predict(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Bound<'_, PyDict>> {
    let options = options(py, arguments)?;
    let Prediction { run, predicted, external, chain, warnings } =
        released(py, || offline::predict::predict(&options))?;
    let coverage = predicted.coverage(&run.data.tau);
    let (rows, n) = predicted.torques.shape();
    let matrix = |value: &dyn Fn(usize, usize) -> f64| -> PyResult<Bound<'_, PyArray2<f64>>> {
        let values: Vec<f64> = (0..rows).flat_map(|k| (0..n).map(move |j| value(k, j))).collect();
        values.into_pyarray(py).reshape([rows, n])
    };
    let torques = &predicted.torques;
    let found = PyDict::new(py);
    found.set_item("t", run.data.t.as_slice().to_vec().into_pyarray(py))?;
    found.set_item("tau", matrix(&|k, j| torques[(k, j)])?)?;
    found.set_item("at_end", predicted.at_end.clone().into_pyarray(py))?;
    let half = predicted.half_widths.as_ref();
    found.set_item("low", half.map(|half| matrix(&|k, j| torques[(k, j)] - half[(k, j)])).transpose()?)?;
    found.set_item("high", half.map(|half| matrix(&|k, j| torques[(k, j)] + half[(k, j)])).transpose()?)?;
    let list = |values: &Vec<f64>| values.clone().into_pyarray(py);
    found.set_item("rms_raw", predicted.rms.as_ref().map(|rms| list(&rms.raw)))?;
    found.set_item("rms_filtered", predicted.rms.as_ref().map(|rms| list(&rms.filtered)))?;
    found.set_item("coverage", coverage.as_ref().map(list))?;
    found.set_item("warnings", warnings)?;
    let Some(external) = external else { return Ok(found) };
    let samples: Vec<_> = run.data.t.iter().map(|&t| external.at(t)).collect();
    found.set_item("tau_ext", matrix(&|k, j| samples[k].tau[j])?)?;
    found.set_item("tau_ext_low", matrix(&|k, j| samples[k].tau[j] - samples[k].half_width[j])?)?;
    found.set_item("tau_ext_high", matrix(&|k, j| samples[k].tau[j] + samples[k].half_width[j])?)?;
    found.set_item("contact", samples.iter().map(|sample| sample.contact).collect::<Vec<_>>().into_pyarray(py))?;
    let contacts = external.contacts().into_iter();
    let contacts = contacts.map(|one| (one.span[0], one.span[1], one.torque.into_pyarray(py), one.joints));
    found.set_item("contacts", contacts.collect::<Vec<_>>())?;
    found.set_item("thresholds", external.thresholds().into_pyarray(py))?;
    let wrench = external.wrench_thresholds(|q| chain.jacobian(q));
    found.set_item("wrench_thresholds", wrench.map(|wrench| wrench.to_vec().into_pyarray(py)))?;
    found.set_item("delay", external.delay())?;
    Ok(found)
}

/// Searches motions. Ctrl-C ends the search and raises KeyboardInterrupt.
#[pyfunction]
pub fn plan(py: Python<'_>, arguments: Vec<OsString>) -> PyResult<Vec<Motion>> {
    let options: offline::plan::Options = options(py, arguments)?;
    let stop = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let search = scope.spawn(|| {
            let mut motions = Vec::new();
            offline::plan::plan(&options, &|| stop.load(Ordering::Relaxed), &mut |planned| {
                let Planned { plan, purpose, .. } = planned;
                motions.push(Motion::new(plan, matches!(purpose, Purpose::Validate { .. }))?);
                Ok(())
            })?;
            Ok(motions)
        });
        let mut interrupt = Ok(());
        while !search.is_finished() {
            py.detach(|| std::thread::sleep(INTERRUPT_INTERVAL));
            if interrupt.is_ok() {
                interrupt = py.check_signals();
                stop.store(interrupt.is_err(), Ordering::Relaxed);
            }
        }
        let found = search.join().unwrap_or_else(|_| Err(Failure::job("the search has panicked")));
        interrupt?;
        found.map_err(|failed| errors::failure(py, &failed))
    })
}

/// Gravitational acceleration in the base frame of a mounting [m/s2]: "upright", "wall", "ceiling", or "RHO,PHI" with units such as "60 deg,0 deg".
#[pyfunction]
pub fn gravity<'py>(py: Python<'py>, mounting: &str) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let mounting = parse_mounting("mounting", mounting).map_err(|bad| errors::bad_input(py, &bad))?;
    Ok(mounting.gravity().as_slice().to_vec().into_pyarray(py))
}

/// A planned motion, periodic (Fourier series).
#[pyclass(frozen, module = "plumbline")]
pub struct Motion {
    plan: Plan,
    fourier: Fourier,
    /// Whether it is to validate with, and not to identify from.
    #[pyo3(get)]
    validates: bool,
}

#[pymethods]
impl Motion {
    /// The motion of a plan file.
    #[staticmethod]
    fn load(py: Python<'_>, path: PathBuf) -> PyResult<Motion> {
        released(py, || Motion::new(load_plan(&path)?, false))
    }

    /// Writes a plan file.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        released(py, || save_plan(&self.plan, &path).map_err(Failure::job))
    }

    /// The text of the plan file.
    #[getter]
    fn toml(&self, py: Python<'_>) -> PyResult<String> {
        released(py, || plan_text(&self.plan).map_err(Failure::job))
    }

    /// The content of the plan file.
    #[getter]
    fn report<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let text = serde_json::to_string(&self.plan).map_err(|error| errors::JobError::new_err(error.to_string()))?;
        py.import("json")?.call_method1("loads", (text,))
    }

    /// Period [s].
    #[getter]
    fn period(&self) -> f64 {
        self.plan.period
    }

    /// Positions [rad], velocities [rad/s] and accelerations [rad/s2] at times `t` [s], one row per time.
    fn at<'py>(&self, py: Python<'py>, t: &Bound<'py, PyAny>) -> PyResult<[Bound<'py, PyArray2<f64>>; 3]> {
        let states =
            crate::arrays::States::of(&[("t", t)]).map_err(|_| PyTypeError::new_err("t is an array of times"))?;
        let [t] = states.one()?;
        let n = self.fourier.joints();
        let points: Vec<_> = t.iter().flat_map(|&t| (0..n).map(move |j| self.fourier.at(j, t))).collect();
        let table = |of: fn(&plumbline_excite::Point) -> f64| -> PyResult<Bound<'py, PyArray2<f64>>> {
            points.iter().map(of).collect::<Vec<f64>>().into_pyarray(py).reshape([t.len(), n])
        };
        Ok([table(|point| point.q)?, table(|point| point.dq)?, table(|point| point.ddq)?])
    }
}

impl Motion {
    fn new(plan: Plan, validates: bool) -> Result<Motion, Failure> {
        let fourier = plan.fourier().map_err(Failure::job)?;
        Ok(Motion { plan, fourier, validates })
    }
}
