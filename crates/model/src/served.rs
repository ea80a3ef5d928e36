//! The torque model and the kinematics behind the loop's traits.

use crate::chain::Chain;
use crate::term::Sample;
use crate::torque::{Evaluator, TorqueModel};
use nalgebra::Vector3;
use plumbline_core::{FeedForward, JointVec, Kinematics, Setpoint, Torque};

/// An identified model, evaluated under the true gravity and under the gravity that the arm's controller compensates.
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

/// Replaces a withdrawn model: identity 0 and no torque, as before the first model.
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

/// Forward kinematics for the guard.
pub struct Reach(pub Chain);

impl Kinematics for Reach {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn end_effector(&self, q: &JointVec) -> [f64; 3] {
        self.0.end_effector(q).into()
    }
}
