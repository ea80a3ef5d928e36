//! Models on runs that they were not fitted to.

use super::diagnosis::THRESHOLD;
use super::evidence::{Evidence, Trial};
use super::moments::Columns;
use super::outcome::Fitted;
use super::state::{State, mean_square};
use crate::model::structure::Structure;
use crate::model::term::effect::Ground;
use nalgebra::DVector;

/// Columns of a structure and torques of runs.
pub fn columns_of(evidence: &Evidence, structure: &Structure, trials: &[Trial]) -> Columns {
    Columns { m: evidence.regressor(structure, trials), r: evidence.torques(trials) }
}

/// Torques and columns of a state on other runs than those it was fitted to.
pub struct Unseen<'a> {
    /// The runs.
    pub evidence: &'a Evidence,
    columns: Columns,
}

impl<'a> Unseen<'a> {
    /// With the columns of a state.
    pub fn of(
        evidence: &'a Evidence,
        structure: &Structure,
        trials: &[Trial],
        state: &State,
        ground: &Ground,
    ) -> Unseen<'a> {
        let mut columns = columns_of(evidence, structure, trials);
        for item in &state.items {
            if let Ok(term) = item.spec.build(ground) {
                columns.push(&evidence.columns(&*term, item.since));
            }
        }
        Unseen { evidence, columns }
    }

    /// With the columns of a whole model.
    pub fn of_model(evidence: &'a Evidence, fitted: &Fitted, trials: &[Trial]) -> Unseen<'a> {
        Unseen { evidence, columns: columns_of(evidence, &fitted.structure, trials) }
    }

    /// Residual of a joint, divided by the noise there.
    pub fn residual(&self, joint: usize, theta: &DVector<f64>) -> DVector<f64> {
        &self.columns.r[joint] - self.columns.m[joint].columns(0, theta.len()) * theta
    }

    /// Mean square of a joint's residual \[Nm2\].
    pub fn mean_square(&self, joint: usize, theta: &DVector<f64>) -> f64 {
        mean_square(self.evidence, joint, &self.residual(joint, theta))
    }
}

/// What the plain model leaves unmodelled in each joint, over the noise; nothing where the noise is not known.
pub fn shown(unseen: &Unseen, base: &State) -> Vec<Option<f64>> {
    let over = |joint: usize| {
        let floor = unseen.evidence.floor(joint)?;
        Some((unseen.mean_square(joint, &base.fit.theta) / (floor * floor) - 1.0).max(0.0).sqrt())
    };
    (0..unseen.evidence.joints()).map(over).collect()
}

/// Share of what the plain model leaves unmodelled in each joint that the parameters `theta` of all columns take away; `None` where nothing was
/// unmodelled or the noise is not known.
pub fn explained(unseen: &Unseen, base: &State, theta: &DVector<f64>) -> Vec<Option<f64>> {
    let share = |joint: usize| {
        let floor = unseen.evidence.floor(joint)?.powi(2);
        let before = (unseen.mean_square(joint, &base.fit.theta) - floor).max(0.0);
        let after = (unseen.mean_square(joint, theta) - floor).max(0.0);
        (before > (THRESHOLD * THRESHOLD) * floor).then(|| 1.0 - after / before)
    };
    (0..unseen.evidence.joints()).map(share).collect()
}
