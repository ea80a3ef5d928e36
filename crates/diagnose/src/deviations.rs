//! Standard deviations of an effect's parameters, linear and nonlinear, with all of them free at once.
//!
//! Around the estimate the torque is linear in every parameter. With `B` the columns of base parameters and effects, `s_k` the nonlinear parameters
//! (settings) and `c_k` the columns of the effect that has setting `k`,
//!
//!   A = [B, d(c_1 beta_1)/ds_1, d(c_2 beta_2)/ds_2, ...],   C = (A' W A)^-1
//!
//! is their covariance (Gauss and Newton). A linear parameter's deviation with the settings held is too small: friction and the displacement over
//! which it builds up share an error.

use super::evidence::Rows;
use super::fit::inverse;
use super::library::Candidate;
use super::select::{Search, inside};
use super::state::State;
use nalgebra::DMatrix;
use plumbline_model::term::effect::Spec;

/// Half the step of a derivative, as a ratio of the distance between two start values of a setting.
const STEP_RATIO: f64 = 0.05;

/// Deviations of all parameters of a state's effects.
pub(super) struct Deviations {
    covariance: DMatrix<f64>,
    /// First column of the settings of each effect.
    first: Vec<usize>,
}

impl Deviations {
    /// Of a fitted state; a setting whose derivative can't be computed is held.
    pub fn of(search: &Search, state: &State) -> Deviations {
        let mut columns = state.columns.clone();
        let mut first = Vec::new();
        let mut next = state.fit.theta.len();
        for (index, item) in state.items.iter().enumerate() {
            first.push(next);
            for setting in 0..item.spec.settings.len() {
                let slope = slope(search, state, index, setting);
                columns.push(&slope.unwrap_or(Rows { width: 1, parts: Vec::new() }));
                next += 1;
            }
        }
        let evidence = search.problem.evidence;
        let information = search.problem.information(&columns.moments(evidence), &state.fit.weights);
        Deviations { covariance: inverse(&information), first }
    }

    /// Of a setting of an effect; `None` where the data does not determine it.
    pub fn of_setting(&self, item: usize, setting: usize) -> Option<f64> {
        let column = self.first[item] + setting;
        let variance = self.covariance[(column, column)];
        (variance > 0.0).then(|| variance.sqrt())
    }

    /// Ratio of a linear parameter's deviation to that with the settings held; 1 or more.
    pub fn growth(&self, state: &State, column: usize) -> f64 {
        let held = state.fit.h[(column, column)];
        if held > 0.0 { (self.covariance[(column, column)] / held).max(1.0).sqrt() } else { 1.0 }
    }
}

/// Change of an effect's torque with one of its settings, as a column.
fn slope(search: &Search, state: &State, index: usize, which: usize) -> Option<Rows> {
    let item = &state.items[index];
    let form = item.spec.family().ok()?.form(item.spec.form)?;
    let setting = &form.settings[which];
    let share = setting.share(item.spec.settings[which]);
    let step = STEP_RATIO * setting.spacing();
    let [low, high] = [share - step, share + step].map(|share| inside(setting, share));
    let beta = state.fit.theta.rows(state.range(index).start, item.rows.width);
    let torque = |value: f64| {
        let mut settings = item.spec.settings.clone();
        settings[which] = value;
        let spec = Spec { settings, ..item.spec.clone() };
        let moved = Candidate::of(search.problem.evidence, search.operating_point, spec, item.span)?;
        Some(moved.rows.parts.into_iter().map(|(joint, part)| (joint, part * beta)).collect::<Vec<_>>())
    };
    let (below, above) = (torque(low)?, torque(high)?);
    let parts = below.into_iter().zip(above).map(|((joint, below), (_, above))| {
        let slope = (above - below) / (high - low);
        (joint, DMatrix::from_column_slice(slope.len(), 1, slope.as_slice()))
    });
    Some(Rows { width: 1, parts: parts.collect() })
}
