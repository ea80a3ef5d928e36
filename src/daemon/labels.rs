//! Which gravity a record's torque was computed with. A hand-over goes into the loop at once and its first record comes out some cycles later;
//! what comes out in between still has the gravity from before.

use nalgebra::Vector3;
use plumbline_rt::Succession;
use std::collections::VecDeque;

/// Gravity by cycle \[m/s2\].
#[derive(Clone, Debug)]
pub struct GravityLabels {
    now: Vector3<f64>,
    /// Models handed to the loop that have not served yet, in order.
    handed: VecDeque<(u64, Vector3<f64>)>,
    /// Those of the model that serves, and of the one behind it.
    models: Succession<Vector3<f64>>,
    /// In force from a cycle on, in order.
    from: VecDeque<(u64, Vector3<f64>)>,
}

impl GravityLabels {
    /// Before anything was handed over.
    pub fn new(gravity: Vector3<f64>) -> GravityLabels {
        GravityLabels { now: gravity, handed: VecDeque::new(), models: Succession::default(), from: VecDeque::new() }
    }

    /// Model `id` for `gravity` is on its way into the loop.
    pub fn handed(&mut self, id: u64, gravity: Vector3<f64>) {
        self.handed.push_back((id, gravity));
    }

    /// By an event of the loop, the next model handed over serves from `cycle` on. The ring is first in, first out.
    pub fn serving(&mut self, cycle: u64) {
        if let Some((id, gravity)) = self.handed.pop_front() {
            self.models.serve(id, gravity);
            self.from.push_back((cycle, gravity));
        }
    }

    /// The serving model broke a limit in `cycle`; the gravity of the one that serves in its place.
    pub fn fell_back(&mut self, cycle: u64) -> Option<Vector3<f64>> {
        self.models.fall_back();
        let gravity = self.models.serving().copied()?;
        self.from.push_back((cycle, gravity));
        Some(gravity)
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
        let mut labels = GravityLabels::new(gravity(0.0));
        labels.handed(7, gravity(1.0));
        assert_eq!(labels.at(5), gravity(0.0));
        labels.handed(8, gravity(2.0));
        labels.serving(8);
        labels.serving(11);
        // Nothing more was handed over.
        labels.serving(12);
        let seen: Vec<f64> = (6..14).map(|cycle| labels.at(cycle).x).collect();
        assert_eq!(seen, [0.0, 0.0, 1.0, 1.0, 1.0, 2.0, 2.0, 2.0]);
        // The model before takes over, with the gravity that it was handed over with.
        assert_eq!(labels.fell_back(15), Some(gravity(1.0)));
        assert_eq!((labels.at(14).x, labels.at(15).x), (2.0, 1.0));
        assert_eq!(labels.fell_back(16), None);
        assert_eq!(labels.at(17).x, 1.0);
    }

    #[test]
    fn records_that_were_passed_over_change_nothing() {
        let gravity = |of: f64| Vector3::new(of, 0.0, -9.81);
        let mut labels = GravityLabels::new(gravity(0.0));
        (1..4u64).for_each(|of| labels.handed(of, gravity(of as f64)));
        [3, 4, 90].into_iter().for_each(|cycle| labels.serving(cycle));
        assert_eq!((labels.at(50).x, labels.at(90).x), (2.0, 3.0));
    }
}
