//! The friction that goes the same way as the rigid bodies' torque: through a gear, into a sensor.

use super::Sample;
use super::effect::Ground;
use super::one_row::smooth_sign;
use crate::joint::{JointVec, MAX_JOINTS};

/// Name of the forms of an effect of a gear for friction that acts behind it, on the link's side, and so goes through it.
pub(super) const LINK_FRICTION: &str = "link-friction";

/// `fv_j dq_j + fc_j tanh(100 dq_j)` of every joint with the numbers of the model that an effect is built upon; 0 where it has none.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CarriedFriction {
    parameters: [[f64; 2]; MAX_JOINTS],
}

impl CarriedFriction {
    /// That of a model.
    pub fn of(ground: &Ground) -> CarriedFriction {
        let mut parameters = [[0.0; 2]; MAX_JOINTS];
        parameters.iter_mut().zip(&ground.friction).for_each(|(own, known)| *own = *known);
        CarriedFriction { parameters }
    }

    /// What of that of a model goes through a gear in a form of its effect: all for [`LINK_FRICTION`], nothing otherwise.
    pub fn through_gear(ground: &Ground, form: &str) -> CarriedFriction {
        if form == LINK_FRICTION { CarriedFriction::of(ground) } else { CarriedFriction::default() }
    }

    /// Of all joints \[Nm\].
    pub fn torques(&self, sample: &Sample) -> JointVec {
        let mut tau = JointVec::default();
        for ((tau, [fv, fc]), dq) in tau.iter_mut().zip(&self.parameters).zip(&sample.dq) {
            *tau = fv * dq + fc * smooth_sign(*dq);
        }
        tau
    }

    /// Of one joint \[Nm\].
    pub fn torque(&self, sample: &Sample, joint: usize) -> f64 {
        let Some(([fv, fc], dq)) = self.parameters.get(joint).zip(sample.dq.get(joint)) else { return 0.0 };
        fv * dq + fc * smooth_sign(*dq)
    }
}
