//! Columns of one value per joint that the program reads beside `t`, `q`, `dq` and `tau`.

use super::Run;
use nalgebra::DMatrix;

/// A quantity in the columns `STEM1` to `STEMn`.
#[derive(Debug)]
pub struct JointColumns {
    pub stem: &'static str,
    pub unit: &'static str,
    pub purpose: &'static str,
    /// Whether an identification can depend on it; then it is part of [`super::Dataset::content_hash`].
    pub identifies: bool,
}

pub const DESIRED_POSITIONS: JointColumns =
    JointColumns { stem: "q_d", unit: "rad", purpose: "desired positions, used by `--estimator iv`", identifies: true };
pub const SERVED_TORQUES: JointColumns = JointColumns {
    stem: "tau_ff",
    unit: "Nm",
    purpose: "feed-forward torques that were served, compared with the measured ones in the report",
    identifies: false,
};

pub const ALL: [&JointColumns; 2] = [&DESIRED_POSITIONS, &SERVED_TORQUES];

impl JointColumns {
    /// The quantity in a run, N x n; `None` where the run has no such columns.
    pub fn of(&self, run: &Run) -> Option<DMatrix<f64>> {
        let columns: Option<Vec<&[f64]>> =
            (1..=run.joints()).map(|joint| run.extra(&format!("{}{joint}", self.stem))).collect();
        columns.map(|columns| DMatrix::from_fn(run.samples(), columns.len(), |k, j| columns[j][k]))
    }
}
