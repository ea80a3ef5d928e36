//! One run as it was measured.

use nalgebra::{DMatrix, Vector3};
use plumbline_core::Record;

/// Samples of one run, as they came: sampling may be uneven, samples may be missing or repeated.
#[derive(Clone, Debug)]
pub struct Run {
    /// Name for errors and reports.
    pub name: String,
    /// Time stamps, N \[s\].
    pub t: Vec<f64>,
    /// Measured joint positions, N x n \[rad\].
    pub q: DMatrix<f64>,
    /// Measured joint velocities, N x n, where there are any \[rad/s\].
    pub dq: Option<DMatrix<f64>>,
    /// Measured joint torques, gravity included, N x n \[Nm\].
    pub tau: DMatrix<f64>,
    /// Gravitational acceleration in the base frame \[m/s2\].
    pub gravity: Vector3<f64>,
    /// Period of the motion; `None` when it does not repeat \[s\].
    pub period: Option<f64>,
}

impl Run {
    /// A run from the loop's records, at the time stamps of the arm's own clock. `joints` is at most 8.
    pub fn from_records(
        name: impl Into<String>,
        records: &[Record],
        joints: usize,
        gravity: Vector3<f64>,
        period: Option<f64>,
    ) -> Run {
        Run {
            name: name.into(),
            t: records.iter().map(|record| record.state.time).collect(),
            q: DMatrix::from_fn(records.len(), joints, |k, j| records[k].state.q[j]),
            dq: Some(DMatrix::from_fn(records.len(), joints, |k, j| records[k].state.dq[j])),
            tau: DMatrix::from_fn(records.len(), joints, |k, j| records[k].state.tau[j]),
            gravity,
            period,
        }
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.q.ncols()
    }
}
