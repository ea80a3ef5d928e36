//! Influence of an error of one joint's position on the torques of all joints.

use super::load::{Load, LoadUnder};
use super::{Motion, Sample};
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};
use std::sync::Arc;

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
    rigid_bodies: Arc<Load>,
    load: LoadUnder,
    along: Option<Arc<SlopesAlong>>,
}

/// Of every sample of a motion the joint's own torque \[Nm\] and the slopes `[K_i, V_i, M_i]` of all torques. A search evaluates a law hundreds
/// of times along the same motion, and none of these depends on its settings. Half of the memory costs the slopes `1e-7` of their value.
#[derive(Debug)]
pub(super) struct SlopesAlong(Vec<(f64, [[f32; MAX_JOINTS]; 3])>);

impl PositionError {
    /// Under a gravity vector in the base frame \[m/s2\].
    pub fn new(joint: usize, load: &Arc<Load>, gravity: &Vector3<f64>) -> PositionError {
        PositionError { joint, rigid_bodies: Arc::clone(load), load: load.under(gravity), along: None }
    }

    /// For the samples of one motion, in any order.
    pub fn follow(&mut self, motion: &Motion) {
        let rigid_bodies = Arc::clone(&self.rigid_bodies);
        self.along = rigid_bodies.slopes(motion, self.joint, |own| {
            let units = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let mut slopes =
                |sample: &Sample| units.map(|unit| self.signature(sample, None, unit).map(|slope| slope as f32));
            SlopesAlong(own.iter().enumerate().map(|(k, own)| (*own, slopes(&motion.sample(k)))).collect())
        });
    }

    fn known(&self, index: Option<usize>) -> Option<(f64, &[[f32; MAX_JOINTS]; 3])> {
        let (own, slopes) = self.along.as_ref()?.0.get(index?)?;
        Some((*own, slopes))
    }

    /// `lin_i(e) = K_i e + V_i e' + M_i e''`, the change of `tau_rb` per `epsilon` when joint i truly is at `q_i + epsilon e(t)`, for
    /// `error = [e, e', e'']` at this sample; `K_i`, `V_i`, `M_i` are the derivatives of `tau_rb` by `q_i`, `dq_i`, `ddq_i`. A central
    /// difference: exact in `V` and `M`, since the torque is quadratic in velocity and linear in acceleration. `index` is the sample's in the
    /// motion that [is followed](Self::follow).
    pub fn signature(&mut self, sample: &Sample, index: Option<usize>, error: [f64; 3]) -> JointVec {
        let [e, de, dde] = error;
        if let Some((_, [k, v, m])) = self.known(index) {
            return std::array::from_fn(|j| f64::from(k[j]) * e + f64::from(v[j]) * de + f64::from(m[j]) * dde);
        }
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
    pub fn own(&mut self, sample: &Sample, index: Option<usize>) -> f64 {
        if let Some((own, _)) = self.known(index) {
            return own;
        }
        let torque = self.load.torque(sample);
        torque.get(self.joint).copied().unwrap_or_default()
    }

    /// `M_ii` where all joints are at zero \[Nm s2/rad\].
    pub fn inertia_at_zero(&mut self) -> f64 {
        let rest = Sample { q: JointVec::default(), dq: JointVec::default(), ddq: JointVec::default() };
        let own = self.own(&rest, None);
        self.inertia(&rest, None, own)
    }

    /// `M_ii`: slope of the joint's torque, here `own`, over its acceleration \[Nm s2/rad\]. Exact, since the torque is linear in it.
    pub fn inertia(&mut self, sample: &Sample, index: Option<usize>, own: f64) -> f64 {
        if let Some((_, [.., m])) = self.known(index) {
            return m.get(self.joint).map_or(0.0, |inertia| f64::from(*inertia));
        }
        let mut faster = *sample;
        if let Some(ddq) = faster.ddq.get_mut(self.joint) {
            *ddq += 1.0;
        }
        self.own(&faster, None) - own
    }
}
