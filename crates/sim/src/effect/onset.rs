//! An effect that acts in a part of the time.

use super::{At, Effect, External, Reading, sign};
use crate::spatial::Inertia;
use crate::truth::Truth;
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};
use std::ops::Range;

/// Disables an effect outside `during` \[s\].
pub(super) struct Onset {
    during: Range<f64>,
    effect: Box<dyn Effect>,
    /// Coulomb friction that the effect replaces then \[Nm\].
    replaced_fc: JointVec,
}

impl Onset {
    pub fn new(effect: Box<dyn Effect>, during: Range<f64>, truth: &Truth) -> Onset {
        let mut replaced_fc = [0.0; MAX_JOINTS];
        for (j, joint) in truth.joints.iter().enumerate().filter(|(j, _)| effect.replaces_coulomb(*j)) {
            replaced_fc[j] = joint.fc;
        }
        Onset { during, effect, replaced_fc }
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
        if self.during.contains(&t) { self.effect.inertia(t) } else { None }
    }

    fn armature(&self, t: f64, joint: usize) -> f64 {
        if self.during.contains(&t) { self.effect.armature(t, joint) } else { 0.0 }
    }

    fn gravity(&self, t: f64, gravity: &mut Vector3<f64>) {
        if self.during.contains(&t) {
            self.effect.gravity(t, gravity);
        }
    }

    fn begin_step(&mut self, at: &At) {
        self.effect.begin_step(at);
    }

    fn torque(&self, at: &At, x: &[f64], dx: &mut [f64], tau: &mut JointVec) {
        if self.during.contains(&at.t) {
            return self.effect.torque(at, x, dx, tau);
        }
        for (j, fc) in self.replaced_fc.iter().enumerate() {
            tau[j] -= fc * sign(at.dq[j]);
        }
    }

    fn wrench(&self, at: &At) -> Option<External> {
        if self.during.contains(&at.t) { self.effect.wrench(at) } else { None }
    }

    fn encoder(&self, at: &At, x: &[f64], dx: &mut [f64], q: &mut JointVec, dq: &mut JointVec) {
        if self.during.contains(&at.t) {
            self.effect.encoder(at, x, dx, q, dq);
        }
    }

    fn sense(&mut self, at: &At, reading: &mut Reading) {
        if self.during.contains(&at.t) {
            self.effect.sense(at, reading);
        }
    }
}
