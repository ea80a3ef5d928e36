//! Stacked equations `tau = W beta` of all experiments, filtered and decimated.

use crate::EstimateError;
use crate::experiment::Experiment;
use nalgebra::{DMatrix, DVector};
use plumbline_core::{parallel, threads};
use plumbline_model::Structure;
use plumbline_model::term::Motion;
use std::ops::Range;

/// The stacked equations. Rows are joint by joint, within a joint experiment by experiment, within that in time.
#[derive(Clone, Debug)]
pub struct Stack {
    /// Regressor `W`, n m x p.
    pub w: DMatrix<f64>,
    /// Torques, n m \[Nm\].
    pub tau: DVector<f64>,
    /// Number of joints, n.
    pub joints: usize,
    /// Rows of one joint in each experiment; their sum is m.
    pub spans: Vec<usize>,
}

impl Stack {
    /// Stacks experiments. Every column is computed at the raw rate, filtered as the torque, then decimated.
    ///
    /// # Errors
    /// Experiments of another arm, fewer equations than parameters.
    pub fn of(structure: &Structure, experiments: &[Experiment]) -> Result<Stack, EstimateError> {
        let motions: Vec<&Motion> = experiments.iter().map(|experiment| &experiment.motion).collect();
        let w = regressor(structure, experiments, &motions, 0)?;
        let joints = structure.chain().len();
        let m = w.nrows() / joints;
        let mut tau = DVector::zeros(w.nrows());
        let mut before = 0;
        for experiment in experiments {
            let count = experiment.kept().len();
            let measured = experiment.band(&experiment.stacked_tau());
            for j in 0..joints {
                tau.rows_mut(j * m + before, count).copy_from(&measured.rows(j * count, count));
            }
            before += count;
        }
        Ok(Stack { w, tau, joints, spans: experiments.iter().map(|experiment| experiment.kept().len()).collect() })
    }

    /// The equations of a structure with more terms after the `before` ones of this: only their columns are computed.
    ///
    /// # Errors
    /// As [`Stack::of`].
    pub fn extended(
        &self,
        structure: &Structure,
        experiments: &[Experiment],
        before: usize,
    ) -> Result<Stack, EstimateError> {
        let motions: Vec<&Motion> = experiments.iter().map(|experiment| &experiment.motion).collect();
        let added = regressor(structure, experiments, &motions, before)?;
        let own = self.w.ncols();
        let mut w = self.w.clone().resize_horizontally(own + added.ncols(), 0.0);
        w.columns_mut(own, added.ncols()).copy_from(&added);
        Ok(Stack { w, tau: self.tau.clone(), joints: self.joints, spans: self.spans.clone() })
    }

    /// Rows of one joint, m.
    pub fn per_joint(&self) -> usize {
        self.tau.len() / self.joints
    }

    /// Measured minus modelled torque \[Nm\].
    pub fn residual(&self, beta: &DVector<f64>) -> DVector<f64> {
        &self.tau - &self.w * beta
    }

    /// The equations restricted to some of the columns; the parameters of the others are zero.
    pub fn columns(&self, kept: &[usize]) -> Stack {
        Stack { w: self.w.select_columns(kept), tau: self.tau.clone(), joints: self.joints, spans: self.spans.clone() }
    }

    /// Rows of each experiment within a joint.
    pub fn ranges(&self) -> impl Iterator<Item = Range<usize>> + '_ {
        self.spans.iter().scan(0, |before, &count| {
            let range = *before..*before + count;
            *before = range.end;
            Some(range)
        })
    }
}

/// Stacked columns of a structure's terms from `first` on along given motions, one per experiment, filtered and decimated as the experiments.
///
/// # Errors
/// Experiments of another arm, fewer equations than parameters.
pub fn regressor(
    structure: &Structure,
    experiments: &[Experiment],
    motions: &[&Motion],
    first: usize,
) -> Result<DMatrix<f64>, EstimateError> {
    let (n, columns) = (structure.chain().len(), structure.columns().len());
    if let Some(other) = experiments.iter().find(|experiment| experiment.joints() != n) {
        return Err(EstimateError::Joints { run: other.name.clone(), found: other.joints(), expected: n });
    }
    assert_eq!(motions.len(), experiments.len(), "one motion per experiment");
    let m: usize = experiments.iter().map(|experiment| experiment.kept().len()).sum();
    if n * m < columns {
        return Err(EstimateError::TooFewRows { rows: n * m, columns });
    }
    let each: Vec<_> = experiments.iter().zip(motions).collect();
    let of = |(experiment, motion): &(&Experiment, &&Motion)| experiment.band(&structure.regressor_from(first, motion));
    let banded = parallel(&each, threads(), of);
    let mut w = DMatrix::zeros(n * m, banded.first().map_or(0, DMatrix::ncols));
    let mut before = 0;
    for (experiment, y) in experiments.iter().zip(banded) {
        let count = experiment.kept().len();
        for j in 0..n {
            w.rows_mut(j * m + before, count).copy_from(&y.rows(j * count, count));
        }
        before += count;
    }
    Ok(w)
}
