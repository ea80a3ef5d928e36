//! How well a residual is predicted by smooth functions of some variables, on trajectories that they were not fitted to.
//!
//! A disturbance `C gamma` in one joint would have left `(C - M H M' W C) gamma` there after the model with the columns `M`, weights `W`
//! and `H = (M' W M)^-1` was fitted. These are the columns that the residual is regressed on, `C` having gone through the same map to
//! the band as the torques: what the model absorbs explains nothing, and a step that the band has smoothed is still a step.

use crate::evidence::{BAND_EDGES_HZ, Evidence};
use crate::fit::group;
use crate::state::State;
use nalgebra::{DMatrix, DVector};
use plumbline_core::transposed_product;

/// Ridges that are tried, as shares of the mean square of a function.
const RIDGE_RATIOS: [f64; 4] = [1e-4, 1e-3, 1e-2, 1e-1];
/// Stretches of time that a single trajectory is cut into.
const STRETCH_COUNT: usize = 6;
/// Samples per coefficient in which it is cut.
const SAMPLES_PER_ROW: f64 = 1.3;

/// One joint's residual with what is needed to regress it.
pub(super) struct Screen<'a> {
    evidence: &'a Evidence,
    joint: usize,
    /// `M' W` of the joint.
    weighed: DMatrix<f64>,
    /// `M H` of the joint.
    spread: DMatrix<f64>,
    /// The residual, one column in parts that are left out in turn.
    residual: Vec<DMatrix<f64>>,
}

/// Sums of products of functions `C` and residuals `R`, one per column, over a part of the data.
pub struct Part {
    /// `C'C`.
    pub g: DMatrix<f64>,
    /// `C'R`.
    pub b: DMatrix<f64>,
}

impl Part {
    /// Of functions and residuals.
    pub fn of(c: &DMatrix<f64>, r: &DMatrix<f64>) -> Part {
        Part { g: transposed_product(c, c), b: c.tr_mul(r) }
    }

    /// The sum of parts.
    pub fn whole(parts: &[Part]) -> Part {
        let [width, residuals] = parts.first().map_or([0; 2], |part| [part.b.nrows(), part.b.ncols()]);
        let zero = Part { g: DMatrix::zeros(width, width), b: DMatrix::zeros(width, residuals) };
        parts.iter().fold(zero, |sum, part| Part { g: sum.g + &part.g, b: sum.b + &part.b })
    }
}

impl Screen<'_> {
    /// Of one joint of a fitted model.
    pub fn of<'a>(evidence: &'a Evidence, state: &'a State, joint: usize) -> Screen<'a> {
        let m = &state.columns.m[joint];
        let mut weighed = m.clone();
        for cell in evidence.cells().iter().filter(|cell| cell.joint == joint) {
            let weight = 1.0 / state.fit.phi[group(joint, cell.band.min(BAND_EDGES_HZ.len() - 1))];
            weighed.rows_mut(cell.rows.start, cell.rows.len()).scale_mut(weight);
        }
        let weighed = weighed.transpose();
        let residual = parts(evidence, &DMatrix::from_columns(&[state.residual(joint)]));
        Screen { evidence, joint, weighed, spread: m * &state.fit.h, residual }
    }

    /// Share of the residual's square, in units of the noise, that a combination of functions predicts where it was not fitted; below
    /// zero when it makes things worse. `functions` are given at the samples of each experiment, as [`Evidence::project`] wants them.
    pub fn predicted(&self, functions: &[DMatrix<f64>]) -> f64 {
        self.predicted_of(functions, &self.residual)[0]
    }

    /// The same of each of several residuals, which are columns.
    pub fn predicted_of(&self, functions: &[DMatrix<f64>], residuals: &[DMatrix<f64>]) -> DVector<f64> {
        let mut c = self.evidence.project(self.joint, functions);
        let scale = DVector::from_iterator(c.ncols(), c.column_iter().map(|column| column.norm().max(1e-12)));
        let absorbed = &self.spread * (&self.weighed * &c);
        c -= absorbed;
        for (mut column, scale) in c.column_iter_mut().zip(&scale) {
            column /= *scale;
        }
        let parts: Vec<Part> = parts(self.evidence, &c).iter().zip(residuals).map(|(c, r)| Part::of(c, r)).collect();
        let whole = Part::whole(&parts);
        let squares = |residuals: &DMatrix<f64>| residuals.map(|value| value * value).row_sum_tr();
        let total: DVector<f64> = residuals.iter().map(squares).sum();
        let mut best = DVector::from_element(total.len(), f64::NEG_INFINITY);
        for ridge in RIDGE_RATIOS {
            let penalty = DMatrix::identity(c.ncols(), c.ncols()) * ridge;
            let gains: Option<DVector<f64>> = parts.iter().map(|part| gained(&whole, part, &penalty)).sum();
            let shares = gains.map(|gains| gains.component_div(&total));
            best.iter_mut().zip(shares.iter().flatten()).for_each(|(best, share)| *best = best.max(*share));
        }
        best
    }

    /// The residual with its parts moved round to where other parts of the motion are, also in the opposite order, a column each: as much noise, as
    /// slow, that depends on nothing.
    pub fn elsewhere(&self) -> Vec<DMatrix<f64>> {
        let count = self.residual.len();
        let part = |(k, own): (usize, &DMatrix<f64>)| {
            let moved = (1..count).map(|by| k + by).chain((0..count).map(|by| 2 * count - 1 - k + by));
            let at =
                |place: usize| self.residual[place % count].column(0).into_owned().resize_vertically(own.nrows(), 0.0);
            DMatrix::from_columns(&moved.map(at).collect::<Vec<_>>())
        };
        self.residual.iter().enumerate().map(part).collect()
    }
}

/// Rows of each fold; of a single one, its samples in stretches of time.
pub fn parts(evidence: &Evidence, rows: &DMatrix<f64>) -> Vec<DMatrix<f64>> {
    let folds = evidence.folds();
    if folds.len() > 1 {
        return folds.iter().map(|fold| rows.rows(fold.rows.start, fold.rows.len()).into_owned()).collect();
    }
    let samples = evidence.thinned(0).len();
    let step = (samples as f64 / (SAMPLES_PER_ROW * rows.nrows() as f64)).floor().max(1.0) as usize;
    let scale = (step as f64).sqrt();
    let signals: Vec<Vec<f64>> =
        rows.column_iter().map(|column| evidence.signal(0, column.into_owned().as_slice())).collect();
    let count = samples / step;
    let stretch = |part: usize| {
        let (first, last) = (part * count / STRETCH_COUNT, (part + 1) * count / STRETCH_COUNT);
        DMatrix::from_fn(last - first, rows.ncols(), |k, c| scale * signals[c][(first + k) * step])
    };
    (0..STRETCH_COUNT).map(stretch).collect()
}

/// How much of the square of each residual in a part goes when the functions, fitted to all others with a penalty `c' P c` on their coefficients, are
/// taken off it; `None` where they can't be fitted.
pub fn gained(whole: &Part, part: &Part, penalty: &DMatrix<f64>) -> Option<DVector<f64>> {
    let gamma = (&whole.g - &part.g + penalty).cholesky()?.solve(&(&whole.b - &part.b));
    Some((2.0 * &part.b - &part.g * &gamma).component_mul(&gamma).row_sum_tr())
}
