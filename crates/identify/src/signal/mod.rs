//! Zero-phase signal processing: filters, derivatives, even time grids.

pub mod butterworth;
pub mod difference;
pub mod ends;
pub mod polled;
pub mod resample;
pub mod spectral;

/// Why a signal could not be processed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum SignalError {
    /// The order of a Butterworth low-pass must be even, a product of second-order sections.
    #[error("filter order {order}: expected an even number from 2 to 40")]
    Order { order: usize },
    /// The cut-off must lie between 0 and half the sampling rate.
    #[error("cut-off {cutoff} Hz: expected more than 0 and less than {nyquist} Hz, half the sampling rate")]
    Cutoff { cutoff: f64, nyquist: f64 },
    #[error("{samples} samples: expected at least {needed}")]
    TooShort { samples: usize, needed: usize },
    #[error("row {row}, column {column}: {value} is not a finite number")]
    NotFinite { row: usize, column: usize, value: f64 },
    /// Related signals have different lengths.
    #[error("{what}: {found} rows, expected {expected}")]
    Shape { what: &'static str, found: usize, expected: usize },
    #[error("time step {dt} s: expected a positive number")]
    Step { dt: f64 },
}

/// Time from each of `rows` rows, `dt` apart \[s\], to the nearest one that is out; infinite where none is. With `wraps` the first row follows the last.
pub fn time_to_nearest(rows: usize, dt: f64, wraps: bool, out: impl Fn(usize) -> bool) -> Vec<f64> {
    let mut times = vec![f64::INFINITY; rows];
    let turns = if wraps { 2 } else { 1 };
    for backwards in [false, true] {
        let mut since = f64::INFINITY;
        for row in (0..turns * rows).map(|k| if backwards { rows - 1 - k % rows } else { k % rows }) {
            since = if out(row) { 0.0 } else { since + dt };
            times[row] = times[row].min(since);
        }
    }
    times
}

/// Decimation factor: `n_d = 2 pi 0.8 f_m / omega_fp` with `omega_fp = 2 pi f_fp` (paper eq. 16), at least 1.
///
/// `rate` is the measurement frequency `f_m` and `passband` the `f_fp` of the rule, twice the highest frequency of interest or
/// more \[Hz\].
pub fn decimation(rate: f64, passband: f64) -> usize {
    ((0.8 * rate / passband).floor() as usize).max(1)
}

#[cfg(test)]
mod tests {
    #[test]
    fn decimation_is_eq_16() {
        assert_eq!(super::decimation(1000.0, 10.0), 80);
        assert_eq!(super::decimation(100.0, 200.0), 1);
    }
}
