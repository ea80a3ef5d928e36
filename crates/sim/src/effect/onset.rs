//! An effect that begins at a given time.

use super::{At, Effect, External, Reading, sign};
use crate::spatial::Inertia;
use crate::truth::Truth;
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};

/// Disables an effect until `from` \[s\].
pub(super) struct Onset {
    from: f64,
    effect: Box<dyn Effect>,
    /// Coulomb friction that the effect replaces from then on \[Nm\].
    replaced_fc: JointVec,
}

impl Onset {
    pub fn new(effect: Box<dyn Effect>, from: f64, truth: &Truth) -> Onset {
        let mut replaced_fc = [0.0; MAX_JOINTS];
        for (j, joint) in truth.joints.iter().enumerate().filter(|(j, _)| effect.replaces_coulomb(*j)) {
            replaced_fc[j] = joint.fc;
        }
        Onset { from, effect, replaced_fc }
    }
}

impl Effect for Onset {
    fn states(&self) -> usize {
        self.effect.states()
    }

    fn replaces_coulomb(&self, joint: usize) -> bool {
        self.effect.replaces_coulomb(joint)
    }

    fn twists(&self, joint: usize) -> bool {
        self.effect.twists(joint)
    }

    fn repeats(&self, _period: f64) -> bool {
        false
    }

    fn inertia(&self, t: f64) -> Option<(usize, Inertia)> {
        if t >= self.from { self.effect.inertia(t) } else { None }
    }

    fn armature(&self, t: f64, joint: usize) -> f64 {
        if t >= self.from { self.effect.armature(t, joint) } else { 0.0 }
    }

    fn gravity(&self, t: f64, gravity: &mut Vector3<f64>) {
        if t >= self.from {
            self.effect.gravity(t, gravity);
        }
    }

    fn begin_step(&mut self, at: &At) {
        self.effect.begin_step(at);
    }

    fn torque(&self, at: &At, x: &[f64], dx: &mut [f64], tau: &mut JointVec) {
        if at.t >= self.from {
            return self.effect.torque(at, x, dx, tau);
        }
        for (j, fc) in self.replaced_fc.iter().enumerate() {
            tau[j] -= fc * sign(at.dq[j]);
        }
    }

    fn wrench(&self, at: &At) -> Option<External> {
        if at.t >= self.from { self.effect.wrench(at) } else { None }
    }

    fn encoder(&self, at: &At, x: &[f64], dx: &mut [f64], q: &mut JointVec, dq: &mut JointVec) {
        if at.t >= self.from {
            self.effect.encoder(at, x, dx, q, dq);
        }
    }

    fn sense(&mut self, at: &At, reading: &mut Reading) {
        if at.t >= self.from {
            self.effect.sense(at, reading);
        }
    }
}
