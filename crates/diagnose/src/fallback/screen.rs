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
    /// The residual, in parts that are left out in turn.
    residual: Vec<DVector<f64>>,
}

/// Sums of products of functions `C` and a residual `r` over a part of the data.
pub struct Part {
    /// `C'C`.
    pub g: DMatrix<f64>,
    /// `C'r`.
    pub b: DVector<f64>,
}

impl Part {
    /// Of functions and a residual.
    pub fn of(c: &DMatrix<f64>, r: &DVector<f64>) -> Part {
        Part { g: transposed_product(c, c), b: c.tr_mul(r) }
    }

    /// Of `width` functions and no data.
    pub fn zero(width: usize) -> Part {
        Part { g: DMatrix::zeros(width, width), b: DVector::zeros(width) }
    }
}

impl std::ops::Add<&Part> for Part {
    type Output = Part;

    fn add(self, other: &Part) -> Part {
        Part { g: self.g + &other.g, b: self.b + &other.b }
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
        let mut screen = Screen { evidence, joint, weighed, spread: m * &state.fit.h, residual: Vec::new() };
        let residual = DMatrix::from_columns(&[state.residual(joint)]);
        screen.residual = parts(evidence, &residual).iter().map(|part| part.column(0).into_owned()).collect();
        screen
    }

    /// Share of the residual's square, in units of the noise, that a combination of functions predicts where it was not fitted; below
    /// zero when it makes things worse. `functions` are given at the samples of each experiment, as [`Evidence::project`] wants them.
    pub fn predicted(&self, functions: &[DMatrix<f64>]) -> f64 {
        self.predicted_of(functions, std::slice::from_ref(&self.residual))[0]
    }

    /// The same of each of several residuals.
    pub fn predicted_of(&self, functions: &[DMatrix<f64>], residuals: &[Vec<DVector<f64>>]) -> Vec<f64> {
        let mut c = self.evidence.project(self.joint, functions);
        let scale = DVector::from_iterator(c.ncols(), c.column_iter().map(|column| column.norm().max(1e-12)));
        let absorbed = &self.spread * (&self.weighed * &c);
        c -= absorbed;
        for (mut column, scale) in c.column_iter_mut().zip(&scale) {
            column /= *scale;
        }
        let c = parts(self.evidence, &c);
        let share = |residual: &Vec<DVector<f64>>| {
            let parts: Vec<Part> = c.iter().zip(residual).map(|(c, r)| Part::of(c, r)).collect();
            let width = parts.first().map_or(0, |part| part.b.len());
            let whole = parts.iter().fold(Part::zero(width), |sum, part| sum + part);
            let total: f64 = residual.iter().map(DVector::norm_squared).sum();
            let ridge = |ridge: f64| {
                let penalty = DMatrix::identity(width, width) * ridge;
                let left: Option<f64> = parts.iter().map(|part| gained(&whole, part, &penalty)).sum();
                left.map_or(f64::NEG_INFINITY, |gained| gained / total)
            };
            RIDGE_RATIOS.into_iter().map(ridge).fold(f64::NEG_INFINITY, f64::max)
        };
        residuals.iter().map(share).collect()
    }

    /// The residual with its parts moved round to where other parts of the motion are, also in the opposite order: as much noise, as slow, that
    /// depends on nothing.
    pub fn elsewhere(&self) -> Vec<Vec<DVector<f64>>> {
        let count = self.residual.len();
        let moved = |place: &dyn Fn(usize) -> usize| -> Vec<DVector<f64>> {
            let part = |(k, own): (usize, &DVector<f64>)| {
                self.residual[place(k) % count].clone().resize_vertically(own.len(), 0.0)
            };
            self.residual.iter().enumerate().map(part).collect()
        };
        let forwards = (1..count).map(|by| moved(&|k| k + by));
        let backwards = (0..count).map(|by| moved(&|k| 2 * count - 1 - k + by));
        forwards.chain(backwards).collect()
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

/// How much of the square of a part goes when the functions, fitted to all others with a penalty `c' P c` on their coefficients, are taken off it;
/// `None` where they can't be fitted.
pub fn gained(whole: &Part, part: &Part, penalty: &DMatrix<f64>) -> Option<f64> {
    let gamma = (&whole.g - &part.g + penalty).cholesky()?.solve(&(&whole.b - &part.b));
    Some(2.0 * part.b.dot(&gamma) - (&part.g * &gamma).dot(&gamma))
}
