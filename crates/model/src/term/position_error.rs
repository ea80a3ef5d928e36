//! Influence of an error of one joint's position on the torques of all joints.

use super::Sample;
use super::load::LoadUnder;
use plumbline_core::JointVec;

/// Step of the difference quotient, times the size of the error \[rad\]: its truncation is 4e-10 of the largest harmonic of the
/// torque over the angle, its rounding 2e-12.
const STEP_RAD: f64 = 1e-4;

/// Largest position error that an encoder's columns are meant for \[rad, or m\]: at twice as much, the second order is a twentieth of the first. Joints that are
/// off by degrees are seen with the eye, and noise along such a column is no encoder.
pub(super) const MAX_POSITION_ERROR: f64 = 0.05;

/// Rigid bodies with one joint whose true position differs from the measured one.
pub(super) struct PositionError {
    /// The joint.
    pub joint: usize,
    /// The rigid bodies.
    pub load: LoadUnder,
}

impl PositionError {
    /// `lin_i(e) = K_i e + V_i e' + M_i e''`, the change of `tau_rb` per `epsilon` when joint i truly is at `q_i + epsilon e(t)`, for
    /// `error = [e, e', e'']` at this sample; `K_i`, `V_i`, `M_i` are the derivatives of `tau_rb` by `q_i`, `dq_i`, `ddq_i`. A central
    /// difference: exact in `V` and `M`, since the torque is quadratic in velocity and linear in acceleration.
    pub fn signature(&mut self, sample: &Sample, error: [f64; 3]) -> JointVec {
        let [e, de, dde] = error;
        let step = STEP_RAD / (1.0 + e.abs());
        let above = self.shifted(sample, [step * e, step * de, step * dde]);
        let below = self.shifted(sample, [-step * e, -step * de, -step * dde]);
        std::array::from_fn(|j| (above[j] - below[j]) / (2.0 * step))
    }

    fn shifted(&mut self, sample: &Sample, by: [f64; 3]) -> JointVec {
        let mut sample = *sample;
        for (values, by) in [&mut sample.q, &mut sample.dq, &mut sample.ddq].into_iter().zip(by) {
            if let Some(value) = values.get_mut(self.joint) {
                *value += by;
            }
        }
        self.load.torque(&sample)
    }

    /// The joint's own rigid-body torque \[Nm\].
    pub fn own(&mut self, sample: &Sample) -> f64 {
        let torque = self.load.torque(sample);
        torque.get(self.joint).copied().unwrap_or_default()
    }

    /// `M_ii` where all joints are at zero \[Nm s2/rad\].
    pub fn inertia_at_zero(&mut self) -> f64 {
        let rest = Sample { q: JointVec::default(), dq: JointVec::default(), ddq: JointVec::default() };
        let own = self.own(&rest);
        self.inertia(&rest, own)
    }

    /// `M_ii`: slope of the joint's torque, here `own`, over its acceleration \[Nm s2/rad\]. Exact, since the torque is linear in it.
    pub fn inertia(&mut self, sample: &Sample, own: f64) -> f64 {
        let mut faster = *sample;
        if let Some(ddq) = faster.ddq.get_mut(self.joint) {
            *ddq += 1.0;
        }
        self.own(&faster) - own
    }
}
