//! Friction that acts together with the rigid-body torque, on a gear and on a sensor, and the rotor that a sensor before the gear sees, too.

use super::Sample;
use super::friction::SHARPNESS;
use super::load::OperatingPoint;
use crate::fast::trig::tanh_of_one;
use plumbline_core::{JointVec, MAX_JOINTS};

/// `fv_j dq_j + fc_j tanh(100 dq_j)` of every joint with the coefficients of the operating point; 0 where it has none.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct CarriedFriction {
    parameters: [[f64; 2]; MAX_JOINTS],
}

impl CarriedFriction {
    /// Friction of an operating point.
    pub fn of(operating_point: &OperatingPoint) -> CarriedFriction {
        let mut parameters = [[0.0; 2]; MAX_JOINTS];
        parameters.iter_mut().zip(&operating_point.friction).for_each(|(own, known)| *own = *known);
        CarriedFriction { parameters }
    }

    /// Of all joints \[Nm\].
    pub fn torques(&self, sample: &Sample) -> JointVec {
        let mut tau = JointVec::default();
        for (joint, (tau, dq)) in tau.iter_mut().zip(&sample.dq).enumerate() {
            *tau = self.at(*dq, joint);
        }
        tau
    }

    /// Of one joint \[Nm\].
    pub fn torque(&self, sample: &Sample, joint: usize) -> f64 {
        sample.dq.get(joint).map_or(0.0, |dq| self.at(*dq, joint))
    }

    /// Of one joint at a velocity \[Nm\].
    pub fn at(&self, dq: f64, joint: usize) -> f64 {
        self.with_slope(dq, joint).0
    }

    /// The same, and its slope over the velocity \[Nms/rad\].
    pub fn with_slope(&self, dq: f64, joint: usize) -> (f64, f64) {
        let sign = tanh_of_one(SHARPNESS * dq);
        let both = |[fv, fc]: &[f64; 2]| (fv * dq + fc * sign, fv + fc * SHARPNESS * (1.0 - sign * sign));
        self.parameters.get(joint).map_or((0.0, 0.0), both)
    }
}

/// What the torque of each joint has beside the rigid body's: friction, and `ia_j ddq_j` of its rotor where the torques contain it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Drives {
    friction: CarriedFriction,
    rotors: JointVec,
}

impl Drives {
    /// Of an operating point.
    pub fn of(operating_point: &OperatingPoint) -> Drives {
        let mut rotors = JointVec::default();
        rotors.iter_mut().zip(&operating_point.rotor_inertias).for_each(|(own, known)| *own = *known);
        Drives { friction: CarriedFriction::of(operating_point), rotors }
    }

    /// Of all joints \[Nm\].
    pub fn torques(&self, sample: &Sample) -> JointVec {
        let mut tau = self.friction.torques(sample);
        tau.iter_mut().zip(&self.rotors).zip(&sample.ddq).for_each(|((tau, rotor), ddq)| *tau += rotor * ddq);
        tau
    }

    /// Of one joint at a velocity and an acceleration \[Nm\].
    pub fn at(&self, dq: f64, ddq: f64, joint: usize) -> f64 {
        self.friction.at(dq, joint) + self.rotors.get(joint).map_or(0.0, |rotor| rotor * ddq)
    }
}
