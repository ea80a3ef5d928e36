//! States as numpy arrays: n values, or one state per row.

use crate::{errors, locked};
use numpy::{AllowTypeChange, IntoPyArray, PyArrayDyn, PyArrayLikeDyn, PyArrayMethods};
use plumbline_client::Fault;
use pyo3::prelude::*;
use std::sync::Mutex;

/// Arrays of one shape, copied: (n,) or (rows, n).
pub struct States {
    arrays: Vec<Vec<f64>>,
    /// `None` for one state.
    rows: Option<usize>,
    n: usize,
}

impl States {
    /// Converts what numpy converts to an array of floats.
    ///
    /// # Errors
    /// `LengthError` for other shapes; numpy's errors.
    pub fn of(inputs: &[(&str, &Bound<'_, PyAny>)]) -> PyResult<States> {
        let mut arrays = Vec::with_capacity(inputs.len());
        let mut first: Option<Vec<usize>> = None;
        for (name, input) in inputs {
            let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = input.extract()?;
            let array = array.as_array();
            let shape = array.shape().to_vec();
            let expected = match &first {
                None if matches!(shape.len(), 1 | 2) => None,
                None => Some("(n,) or (rows, n)".to_string()),
                Some(first) if *first == shape => None,
                Some(first) => Some(format!("{first:?} as {}", inputs[0].0)),
            };
            if let Some(expected) = expected {
                return Err(errors::LengthError::new_err(format!("{name} has shape {shape:?}, expected {expected}")));
            }
            arrays.push(array.iter().copied().collect());
            first.get_or_insert(shape);
        }
        let shape = first.unwrap_or_default();
        let rows = (shape.len() == 2).then(|| shape[0]);
        Ok(States { arrays, rows, n: shape.last().copied().unwrap_or(0) })
    }

    /// `call` of `value` for every state in turn: its arrays, and where to write a result of `shape`. Shape (rows, ..) for more than one state.
    /// `value` is locked once: no other thread's state gets between them.
    ///
    /// # Errors
    /// The first fault, with the number of its row.
    pub fn evaluate<'py, T: Send>(
        &self,
        py: Python<'py>,
        value: &Mutex<T>,
        shape: &[usize],
        mut call: impl FnMut(&mut T, &[&[f64]], &mut [f64]) -> Result<(), Fault> + Send,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        let size: usize = shape.iter().product();
        let mut result = vec![0.0; size * self.rows.unwrap_or(1)];
        let done = py.detach(|| {
            let mut value = locked(value);
            let mut state: Vec<&[f64]> = Vec::with_capacity(self.arrays.len());
            // Faults of the length are the call's own.
            let (n, size) = (self.n.max(1), size.max(1));
            for (row, to) in result.chunks_exact_mut(size).enumerate() {
                state.clear();
                state.extend(
                    self.arrays
                        .iter()
                        .map(|array| &array[(row * n).min(array.len())..((row + 1) * n).min(array.len())]),
                );
                call(&mut value, &state, to).map_err(|fault| (row, fault))?;
            }
            Ok(())
        });
        done.map_err(|(row, fault): (usize, Fault)| {
            errors::fault(fault, &self.rows.map_or(String::new(), |_| format!("row {row}: ")))
        })?;
        let shape: Vec<usize> = self.rows.into_iter().chain(shape.iter().copied()).collect();
        result.into_pyarray(py).reshape(shape)
    }
}

impl States {
    /// The arrays of one state.
    ///
    /// # Errors
    /// `LengthError` where there are several.
    pub fn one<const N: usize>(&self) -> PyResult<[&[f64]; N]> {
        let several = || errors::LengthError::new_err(format!("{:?} states, expected one of shape (n,)", self.rows));
        if self.rows.is_some() {
            return Err(several());
        }
        let arrays: Vec<&[f64]> = self.arrays.iter().map(Vec::as_slice).collect();
        arrays.try_into().map_err(|_| several())
    }
}

/// Three values of a vector.
///
/// # Errors
/// `LengthError` for another number of values; numpy's errors.
pub fn vector(name: &str, input: &Bound<'_, PyAny>) -> PyResult<[f64; 3]> {
    let array: PyArrayLikeDyn<'_, f64, AllowTypeChange> = input.extract()?;
    let values: Vec<f64> = array.as_array().iter().copied().collect();
    let found = values.len();
    values
        .try_into()
        .map_err(|_| errors::LengthError::new_err(format!("{name} has {found} values, expected 3 (m/s2, base frame)")))
}
