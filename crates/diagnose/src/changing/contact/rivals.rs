//! What is no contact: a course of torque in each joint, and a base that moves; and by how much a contact is better.

use super::course::{Course, Torques};
use super::{Data, Fitted};
use crate::changing::record::Record;
use nalgebra::DMatrix;
use std::f64::consts::E;

/// What is no contact, fitted to the same event.
pub(super) struct Rivals {
    /// Sum of the squares of each joint's torques, and what a course of its own leaves of it.
    joints: Vec<(f64, f64)>,
    /// What a base that moves leaves, and one that keeps its direction.
    base: [f64; 2],
}

impl Data<'_> {
    /// Torques of each joint for itself, and a base that moves by its gravity columns over one period.
    pub(super) fn rivals(&self, record: &Record, gravity: &[DMatrix<f64>]) -> Rivals {
        let of_joint = |joint: usize| {
            let tau = self.torques.tau.columns(joint, 1).into_owned();
            let square = tau.norm_squared();
            let column = self.visible.column(joint).map(|visible| f64::from(u8::from(visible)));
            let alone = Torques { tau, hats: self.torques.hats.clone(), knots: self.torques.knots };
            let course = alone.fit(&[DMatrix::from_columns(&[column])], false);
            (square, course.map_or(square, |course| course.rss))
        };
        let of_base = |(joint, gravity): (usize, &DMatrix<f64>)| {
            DMatrix::from_fn(self.rows.len(), 3, |block, c| {
                let column = gravity[(self.rows[block] % record.samples, c)] / self.scale[joint];
                if self.visible[(block, joint)] { column } else { 0.0 }
            })
        };
        let columns: Vec<DMatrix<f64>> = gravity.iter().enumerate().map(of_base).collect();
        // It comes to rest again: its acceleration has a mean of zero.
        let free = self.torques.fit(&columns, true);
        let line = free.as_ref().and_then(|free| self.torques.fit_direction(&columns, free, true));
        let left = |course: Option<Course>| course.map_or(f64::INFINITY, |course| course.rss);
        Rivals { joints: (0..self.chain.len()).map(of_joint).collect(), base: [left(free), left(line)] }
    }

    /// Number of joints that a course of their own explains better than nothing.
    pub(super) fn shown_in(&self, rivals: &Rivals) -> usize {
        let knots = self.torques.knots as f64;
        rivals.joints.iter().filter(|&&(square, rss)| self.score(rss, knots) < self.score(square, 0.0)).count()
    }

    /// By how much the score of an explanation is better than that of what is no contact.
    /// Score: residual over its noise, and `ln N` for each parameter. The noise is what the explanation leaves, if that is more than
    /// the deviations have elsewhere: a contact is not refused for what it stirs up besides.
    pub(super) fn gap(&self, rivals: &Rivals, one: &Fitted) -> f64 {
        let dispersion = (one.course.rss / self.independent).max(1.0);
        let score = |rss: f64, parameters: f64| self.score(rss / dispersion, parameters);
        let knots = self.torques.knots as f64;
        let of_joint = |&(square, rss): &(f64, f64)| score(rss, knots).min(score(square, 0.0));
        let joints = rivals.joints.iter().map(of_joint).sum::<f64>();
        let [free, line] = rivals.base;
        let base = score(free, 3.0 * knots).min(score(line, knots + 2.0));
        joints.min(base) - score(one.course.rss, one.parameters)
    }

    /// Score of a residual with so many parameters.
    fn score(&self, rss: f64, parameters: f64) -> f64 {
        rss + parameters * self.independent.max(E).ln()
    }
}
