//! Measured samples of one run.

use nalgebra::DMatrix;
use plumbline_core::Record;
use plumbline_model::Mounting;

/// Measured samples of one run. Sampling may be uneven; samples may be missing or repeated.
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
    /// Mounting of the arm.
    pub mounting: Mounting,
    /// Period of the motion; `None` when it does not repeat \[s\].
    pub period: Option<f64>,
}

impl Run {
    /// A run from the loop's records, at the time stamps of the arm's own clock. `joints` is at most 8.
    pub fn from_records(
        name: impl Into<String>,
        records: &[Record],
        joints: usize,
        mounting: Mounting,
        period: Option<f64>,
    ) -> Run {
        Run {
            name: name.into(),
            t: records.iter().map(|record| record.state.time).collect(),
            q: DMatrix::from_fn(records.len(), joints, |k, j| records[k].state.q[j]),
            dq: Some(DMatrix::from_fn(records.len(), joints, |k, j| records[k].state.dq[j])),
            tau: DMatrix::from_fn(records.len(), joints, |k, j| records[k].state.tau[j]),
            mounting,
            period,
        }
    }

    /// `samples` samples from `from` on, as a run.
    pub fn part(&self, from: usize, samples: usize) -> Run {
        let rows = |of: &DMatrix<f64>| of.rows(from, samples).into_owned();
        Run {
            name: self.name.clone(),
            t: self.t[from..from + samples].to_vec(),
            q: rows(&self.q),
            dq: self.dq.as_ref().map(rows),
            tau: rows(&self.tau),
            ..*self
        }
    }

    /// Number of samples, N.
    pub fn samples(&self) -> usize {
        self.t.len()
    }

    /// Whole periods; 0 of a motion that does not repeat.
    pub fn periods(&self) -> usize {
        let Some(period) = self.period.filter(|_| self.samples() > 1) else { return 0 };
        let (first, last) = (self.t[0], self.t[self.samples() - 1]);
        // Each sample stands for one sampling interval; clocks drift by less than half of one per period.
        let step = (last - first) / (self.samples() - 1) as f64;
        ((last - first + 1.5 * step) / period) as usize
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.q.ncols()
    }
}
