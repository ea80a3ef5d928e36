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

impl Rivals {
    /// What a course of its own in each joint leaves.
    pub(super) fn left(&self) -> f64 {
        self.joints.iter().map(|(_, left)| left).sum()
    }
}

impl Data<'_> {
    /// Torques of each joint for itself, and a base that moves by its gravity columns over one period.
    pub(super) fn rivals(&self, record: &Record, gravity: &[DMatrix<f64>]) -> Rivals {
        let of_joint = |joint: usize| {
            let alone = Torques {
                tau: self.torques.tau.columns(joint, 1).into_owned(),
                weights: vec![self.torques.weights[joint].clone()],
                hats: self.torques.hats.clone(),
                knots: self.torques.knots,
            };
            let square = alone.square(0);
            let course = alone.fit(&[DMatrix::from_element(self.rows.len(), 1, 1.0)], false);
            (square, course.map_or(square, |course| course.rss))
        };
        let of_base = |gravity: &DMatrix<f64>| {
            DMatrix::from_fn(self.rows.len(), 3, |block, c| gravity[(self.rows[block] % record.samples, c)])
        };
        let columns: Vec<DMatrix<f64>> = gravity.iter().map(of_base).collect();
        // It comes to rest again: its acceleration has a mean of zero.
        let free = self.torques.fit(&columns, true);
        let line = free.as_ref().and_then(|free| self.torques.fit_direction(&columns, free, true));
        let left = |course: Option<Course>| course.map_or(f64::INFINITY, |course| course.rss);
        Rivals { joints: (0..self.chain.len()).map(of_joint).collect(), base: [left(free), left(line)] }
    }

    /// By how much the score of an explanation is better than that of what is no contact.
    /// Score: residual over its noise, and `ln N` for each parameter. The noise is what the explanation leaves, if that is more than
    /// the deviations have elsewhere: a contact is not refused for what it stirs up besides.
    pub(super) fn gap(&self, rivals: &Rivals, one: &Fitted) -> f64 {
        // What swings faster than a course is none of a contact: along a fast motion large forces about an axis would explain that, too.
        let least = |(joint, &(square, left)): (usize, &(f64, f64))| if joint > one.link { square } else { left };
        let left = one.course.rss.max(rivals.joints.iter().enumerate().map(least).sum());
        let dispersion = (left / self.independent).max(1.0);
        let score = |rss: f64, parameters: f64| self.score(rss / dispersion, parameters);
        let knots = self.torques.knots as f64;
        let of_joint = |&(square, rss): &(f64, f64)| score(rss, knots).min(score(square, 0.0));
        let joints = rivals.joints.iter().map(of_joint).sum::<f64>();
        let [free, line] = rivals.base;
        let base = score(free, 3.0 * knots).min(score(line, knots + 2.0));
        joints.min(base) - score(left, one.parameters)
    }

    /// Score of a residual with so many parameters.
    fn score(&self, rss: f64, parameters: f64) -> f64 {
        rss + parameters * self.independent.max(E).ln()
    }
}
