//! What the loop asks of a model, in the loop's own terms.

use crate::chain::Chain;
use crate::term::Sample;
use crate::torque::{Evaluator, TorqueModel};
use nalgebra::Vector3;
use plumbline_core::{FeedForward, JointVec, Kinematics, Setpoint, Torque};

/// An identified model, ready for the gravity that acts and for the one that the arm's own controller compensates.
pub struct ServedModel {
    id: u64,
    evaluator: Evaluator,
    vendor: Evaluator,
}

impl ServedModel {
    /// `model` of identity `id` under `gravity`, on an arm that compensates `vendor`, both in the base frame \[m/s2\].
    pub fn new(id: u64, model: &TorqueModel, gravity: &Vector3<f64>, vendor: &Vector3<f64>) -> ServedModel {
        ServedModel { id, evaluator: model.evaluator(gravity), vendor: model.evaluator(vendor) }
    }
}

impl FeedForward for ServedModel {
    fn id(&self) -> u64 {
        self.id
    }

    fn torque(&mut self, desired: &Setpoint) -> Torque {
        let &Setpoint { q, dq, ddq } = desired;
        self.evaluator.torque(&Sample { q, dq, ddq })
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn vendor_torque(&mut self, q: &JointVec) -> Torque {
        self.vendor.rest(q)
    }
}

/// In the place of a model that may not be served any more: identity 0 and no torque, as before the first model.
pub struct NoModel;

impl FeedForward for NoModel {
    fn id(&self) -> u64 {
        0
    }

    fn torque(&mut self, _: &Setpoint) -> Torque {
        Torque::default()
    }

    fn vendor_torque(&mut self, _: &JointVec) -> Torque {
        Torque::default()
    }
}

/// Where the end effector is, for the guard.
pub struct Reach(pub Chain);

impl Kinematics for Reach {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn end_effector(&self, q: &JointVec) -> [f64; 3] {
        self.0.end_effector(q).into()
    }
}
