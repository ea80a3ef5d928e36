//! Standard deviations of an effect's parameters, linear and nonlinear, with all of them free at once.
//!
//! Around the estimate the torque is linear in every parameter. With `B` the columns of base parameters and effects, `s_k` the nonlinear parameters
//! (settings) and `c_k` the columns of the effect that has setting `k`,
//!
//!   A = [B, d(c_1 beta_1)/ds_1, d(c_2 beta_2)/ds_2, ...],   C = (A' W A)^-1
//!
//! is their covariance (Gauss and Newton). A linear parameter's deviation with the settings held is too small: friction and the displacement over
//! which it builds up share an error.
//!
//! What the model lacks is no noise that averages out. Where trajectories disagree by more than their noise the deviation is theirs, of the estimates
//! `beta_i` from `n` trajectories less the i-th (jackknife, Efron and Stein, Annals of Statistics 9, 1981):
//!
//!   s^2 = (n - 1) / n sum_i (beta_i - mean beta_i)^2.

use super::evidence::Evidence;
use super::fit::{MIN_FOLDS, inverse};
use super::library::Candidate;
use super::proposals::inside;
use super::rows::Rows;
use super::select::Search;
use super::state::State;
use nalgebra::{DMatrix, DVector};
use plumbline_model::term::effect::{OperatingPoint, Spec};

/// Half the step of a derivative, as a ratio of the distance between two start values of a setting.
const STEP_RATIO: f64 = 0.05;

/// Deviations of all parameters of a state's effects.
pub(super) struct Deviations {
    covariance: DMatrix<f64>,
    /// First column of the settings of each effect.
    first: Vec<usize>,
    /// Deviation of each linear parameter by how trajectories disagree; 0 where few are known.
    jackknife: Vec<f64>,
}

impl Deviations {
    /// Of a fitted state.
    pub fn of(search: &Search, state: &State) -> Deviations {
        let evidence = search.problem.evidence;
        let mut columns = state.columns.clone();
        let mut first = Vec::new();
        let mut next = state.fit.theta.len();
        for (index, item) in state.items.iter().enumerate() {
            first.push(next);
            next += item.spec.settings.len();
            let beta = state.fit.theta.rows(state.range(index).start, item.rows.width);
            columns.push(&slopes(evidence, search.operating_point, item, beta.as_slice()));
        }
        let information = search.problem.information(&columns.moments(evidence), &state.fit.weights);
        let left_out = search.problem.left_out(state.moments(evidence), &state.fit.weights);
        let jackknife = (0..state.fit.theta.len()).map(|column| jackknife(&left_out, column)).collect();
        Deviations { covariance: inverse(&information), first, jackknife }
    }

    /// Of a setting of an effect; `None` where the data does not determine it.
    pub fn of_setting(&self, state: &State, item: usize, setting: usize) -> Option<f64> {
        let column = self.first[item] + setting;
        let variance = self.covariance[(column, column)];
        // Trajectories disagree about it as about the parameters that it belongs to.
        let ratio = |column: usize| self.jackknife[column] / self.covariance[(column, column)].sqrt();
        let disagreement = state.range(item).map(ratio).filter(|ratio| ratio.is_finite()).fold(1.0, f64::max);
        (variance > 0.0).then(|| variance.sqrt() * disagreement)
    }

    /// Of a linear parameter whose deviation by noise is `std` with the settings held.
    pub fn of_linear(&self, state: &State, column: usize, std: f64) -> f64 {
        let held = state.fit.h[(column, column)];
        let growth = if held > 0.0 { (self.covariance[(column, column)] / held).max(1.0).sqrt() } else { 1.0 };
        growth * std.max(self.jackknife[column])
    }
}

/// Deviation of a parameter by its estimates without each trajectory in turn.
fn jackknife(left_out: &[DVector<f64>], column: usize) -> f64 {
    let count = left_out.len() as f64;
    if left_out.len() < MIN_FOLDS {
        return 0.0;
    }
    let mean = left_out.iter().map(|theta| theta[column]).sum::<f64>() / count;
    let squares = left_out.iter().map(|theta| (theta[column] - mean).powi(2)).sum::<f64>();
    ((count - 1.0) / count * squares).sqrt()
}

/// Change of an effect's torque with each of its settings, one column per setting; zero where it can't be computed, which holds that setting.
pub(super) fn slopes(
    evidence: &Evidence,
    operating_point: &OperatingPoint,
    item: &Candidate,
    parameters: &[f64],
) -> Rows {
    let beta = DVector::from_column_slice(parameters);
    let width = item.spec.settings.len();
    let mut parts: Vec<(usize, DMatrix<f64>)> = Vec::new();
    let Some(form) = item.spec.form() else {
        return Rows::new(width, parts);
    };
    for (which, setting) in form.settings.iter().enumerate() {
        let share = setting.share(item.spec.settings[which]);
        let step = STEP_RATIO * setting.spacing();
        let [low, high] = [share - step, share + step].map(|share| inside(setting, share));
        let torque = |value: f64| {
            let mut settings = item.spec.settings.clone();
            settings[which] = value;
            let spec = Spec { settings, ..item.spec.clone() };
            let moved = Candidate::of(evidence, operating_point, spec, item.span)?;
            let of = |joint: usize| Some((joint, &*moved.rows.of(joint)? * &beta));
            Some(moved.rows.joints().filter_map(of).collect::<Vec<_>>())
        };
        let (Some(below), Some(above)) = (torque(low), torque(high)) else { continue };
        for ((joint, below), (_, above)) in below.into_iter().zip(above) {
            let at = parts.iter().position(|(own, _)| *own == joint).unwrap_or_else(|| {
                parts.push((joint, DMatrix::zeros(below.len(), width)));
                parts.len() - 1
            });
            parts[at].1.set_column(which, &((above - below) / (high - low)));
        }
    }
    Rows::new(width, parts)
}
