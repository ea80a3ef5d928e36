//! Python package `plumbline`: the client of a controller and the offline work. Its Python part is in `python/plumbline`.
//!
//! | module | what |
//! |---|---|
//! | `model`, `feed_forward`, `guest` | `plumbline_client`, with numpy arrays |
//! | `offline` | `plumbline::offline`, with options as on the command line |
//! | `errors` | exceptions of the same text as the Rust errors |
//!
//! The interpreter's lock is released while something is computed, awaited, read or written.

#![forbid(unsafe_code)]
// The documentation of the package is in the docstrings.
#![allow(missing_docs)]

mod arrays;
mod errors;
mod feed_forward;
mod guest;
mod model;
mod offline;

use pyo3::prelude::*;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// The value of a mutex, also after a panic of another thread: the Python exception of that panic has told about it.
fn locked<T>(value: &Mutex<T>) -> MutexGuard<'_, T> {
    value.lock().unwrap_or_else(PoisonError::into_inner)
}

#[pymodule]
mod _plumbline {
    #[pymodule_export]
    use super::feed_forward::{FeedForward, Torque};
    #[pymodule_export]
    use super::guest::Guest;
    #[pymodule_export]
    use super::model::{Model, Status};
    #[pymodule_export]
    use super::offline::{Motion, compare, diagnose, gravity, identify, plan, predict};
    use pyo3::prelude::*;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        super::errors::add(module)
    }
}
