//! Which gravity a record's torque was computed with. A hand-over goes into the loop at once and its first record comes out some cycles later;
//! what comes out in between still has the gravity from before.

use nalgebra::Vector3;
use std::collections::VecDeque;

/// Gravity by cycle \[m/s2\].
#[derive(Clone, Debug)]
pub struct Labels {
    now: Vector3<f64>,
    /// Handed to the loop and not heard of again, in order.
    handed: VecDeque<Vector3<f64>>,
    /// In force from a cycle on, in order.
    from: VecDeque<(u64, Vector3<f64>)>,
}

impl Labels {
    /// Before anything was handed over.
    pub fn new(gravity: Vector3<f64>) -> Labels {
        Labels { now: gravity, handed: VecDeque::new(), from: VecDeque::new() }
    }

    /// A model for `gravity` is on its way into the loop.
    pub fn handed(&mut self, gravity: Vector3<f64>) {
        self.handed.push_back(gravity);
    }

    /// The loop says that the next one handed over is in force from `cycle` on. The ring is first in, first out.
    pub fn serving(&mut self, cycle: u64) {
        if let Some(gravity) = self.handed.pop_front() {
            self.from.push_back((cycle, gravity));
        }
    }

    /// What the record of `cycle` was computed with; cycles go up from call to call.
    pub fn at(&mut self, cycle: u64) -> Vector3<f64> {
        while let Some(&(first, gravity)) = self.from.front()
            && first <= cycle
        {
            self.now = gravity;
            self.from.pop_front();
        }
        self.now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_record_has_the_gravity_of_its_own_cycle() {
        let gravity = |of: f64| Vector3::new(of, 0.0, -9.81);
        let mut labels = Labels::new(gravity(0.0));
        labels.handed(gravity(1.0));
        assert_eq!(labels.at(5), gravity(0.0));
        labels.handed(gravity(2.0));
        labels.serving(8);
        labels.serving(11);
        // Nothing more was handed over.
        labels.serving(12);
        let seen: Vec<f64> = (6..14).map(|cycle| labels.at(cycle).x).collect();
        assert_eq!(seen, [0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0]);
    }

    #[test]
    fn records_that_were_passed_over_change_nothing() {
        let gravity = |of: f64| Vector3::new(of, 0.0, -9.81);
        let mut labels = Labels::new(gravity(0.0));
        (1..4).for_each(|of| labels.handed(gravity(f64::from(of))));
        [3, 4, 90].into_iter().for_each(|cycle| labels.serving(cycle));
        assert_eq!((labels.at(50).x, labels.at(90).x), (2.0, 3.0));
    }
}
