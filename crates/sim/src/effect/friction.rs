//! Friction of every joint: `fv dq + fc tanh(100 dq)`, the law the paper identifies.

use super::{At, Effect};
use crate::truth::Truth;
use plumbline_core::{JointVec, MAX_JOINTS};

/// Steepness of the Coulomb term's step \[s/rad\] (paper, section II-A).
const SHARPNESS_S_PER_RAD: f64 = 100.0;

/// Smooth sign of a velocity \[rad/s\].
pub(super) fn sign(dq: f64) -> f64 {
    (SHARPNESS_S_PER_RAD * dq).tanh()
}

pub(crate) struct Friction {
    fv: JointVec,
    fc: JointVec,
}

impl Friction {
    /// `replaced(joint)`: whether another effect replaces that joint's Coulomb friction.
    pub fn new(truth: &Truth, replaced: impl Fn(usize) -> bool) -> Friction {
        let mut friction = Friction { fv: [0.0; MAX_JOINTS], fc: [0.0; MAX_JOINTS] };
        for (j, joint) in truth.joints.iter().enumerate() {
            friction.fv[j] = joint.fv;
            friction.fc[j] = if replaced(j) { 0.0 } else { joint.fc };
        }
        friction
    }
}

impl Friction {
    /// Friction of one joint, counted from 0, at a velocity \[Nm\].
    pub fn at(&self, joint: usize, dq: f64) -> f64 {
        self.fv[joint] * dq + self.fc[joint] * sign(dq)
    }
}

impl Effect for Friction {
    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        for (j, tau) in tau[..at.n].iter_mut().enumerate() {
            *tau -= self.at(j, at.dq[j]);
        }
    }
}
