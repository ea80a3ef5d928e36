//! All of a model that has a closed form, in one pass.

use super::sign::SHARPNESS;
use super::torque::{RigidTorque, Workspace};
use super::trig::tanh;
use super::{Lanes, vector_level};
use crate::chain::Chain;
use crate::motion::Sample;
use crate::rnea::LinkParameters;
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f64x8};
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};

/// `tau = Y_b beta + fv dq + fc tanh(100 dq) + ia ddq + offset`: terms with fixed parameters add themselves to it
/// ([`crate::term::FixedTerm::join`]), and one call computes them all.
///
/// Sizes are those of a [`JointVec`]. Nothing is allocated after the terms have joined, and nothing panics.
#[derive(Clone, Debug)]
pub struct ClosedForm {
    level: Level,
    rigid: Option<RigidTorque>,
    work: Workspace,
    viscous: Lanes,
    coulomb: Lanes,
    rotor: Lanes,
    offset: Lanes,
    /// Whether any of the last four is not zero.
    per_joint: bool,
}

impl Default for ClosedForm {
    /// No term yet: no torque.
    fn default() -> ClosedForm {
        ClosedForm {
            level: vector_level(),
            rigid: None,
            work: Workspace::default(),
            viscous: Lanes::default(),
            coulomb: Lanes::default(),
            rotor: Lanes::default(),
            offset: Lanes::default(),
            per_joint: false,
        }
    }
}

impl ClosedForm {
    /// Adds rigid links under `gravity` in the base frame \[m/s2\]. False, and nothing is added, when a joint is prismatic or there are
    /// links already.
    pub fn add_links(&mut self, chain: &Chain, links: &[LinkParameters], gravity: &Vector3<f64>) -> bool {
        if self.rigid.is_some() {
            return false;
        }
        self.rigid = RigidTorque::new(chain, links, gravity);
        self.rigid.is_some()
    }

    /// Puts the links under another `gravity` in the base frame \[m/s2\].
    pub fn set_gravity(&mut self, gravity: &Vector3<f64>) {
        if let Some(rigid) = &mut self.rigid {
            rigid.set_gravity(gravity);
        }
    }

    /// Adds `viscous_j dq_j + coulomb_j tanh(100 dq_j)`.
    pub fn add_friction(&mut self, viscous: &JointVec, coulomb: &JointVec) {
        self.viscous.add(viscous);
        self.coulomb.add(coulomb);
        self.per_joint = true;
    }

    /// Adds `rotor_j ddq_j`.
    pub fn add_rotors(&mut self, rotor: &JointVec) {
        self.rotor.add(rotor);
        self.per_joint = true;
    }

    /// Adds a constant torque in every joint.
    pub fn add_offset(&mut self, offset: &JointVec) {
        self.offset.add(offset);
        self.per_joint = true;
    }

    /// The torque of all that joined at a sample \[Nm\].
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn torque(&mut self, sample: &Sample) -> JointVec {
        let mut tau = [0.0; MAX_JOINTS];
        let level = self.level;
        dispatch!(level, simd => self.torque_with(simd, sample, &mut tau));
        tau
    }

    #[inline(always)]
    fn torque_with<S: Simd>(&mut self, simd: S, sample: &Sample, tau: &mut JointVec) {
        if self.per_joint {
            let load = |values: &JointVec| f64x8::from_slice(simd, values);
            let dq = load(&sample.dq);
            let friction = tanh(simd, dq * SHARPNESS).mul_add(load(&self.coulomb.0), dq * load(&self.viscous.0));
            let inertia = load(&sample.ddq).mul_add(load(&self.rotor.0), load(&self.offset.0));
            (friction + inertia).store_slice(tau);
        }
        if let Some(rigid) = &self.rigid {
            rigid.torque(simd, &mut self.work, sample, tau);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::levels;
    use super::*;
    use crate::chain::{Joint, JointKind, Placement};
    use crate::rnea::rnea;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use std::f64::consts::{FRAC_PI_2, PI};

    /// The other test of this identity (`crates/model/tests/model/fast.rs`) runs at the level of its CPU only.
    #[test]
    fn every_level_computes_the_torque_of_the_plain_recursion() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        for n in 1..=8 {
            let joints = (0..n).map(|i| {
                let alpha = [0.0, FRAC_PI_2, -FRAC_PI_2, PI, 0.7][rng.random_range(0..5)];
                let (a, d) = if i % 2 == 0 { (0.0, 0.4) } else { (rng.random_range(-0.5..0.5), 0.0) };
                Joint { kind: JointKind::Revolute, a, alpha, d, theta: rng.random_range(-1.0..1.0) }
            });
            let chain = Chain::modified(joints.collect(), Placement::identity());
            let links: Vec<LinkParameters> = (0..n).map(|_| [(); 10].map(|()| rng.random_range(-1.0..1.0))).collect();
            let gravity = Vector3::new(1.0, -3.0, 9.0);
            for _ in 0..20 {
                let mut draw = || [(); MAX_JOINTS].map(|()| rng.random_range(-2.0..2.0));
                let (sample, fv, fc) = (Sample { q: draw(), dq: draw(), ddq: draw() }, draw(), draw());
                let mut expected = JointVec::default();
                rnea(&chain, &links, &gravity, &sample.q, &sample.dq, &sample.ddq, &mut expected);
                for j in 0..MAX_JOINTS {
                    expected[j] += fv[j] * sample.dq[j] + fc[j] * (SHARPNESS * sample.dq[j]).tanh();
                }
                let scale = expected.iter().fold(0.0_f64, |most, tau| most.max(tau.abs()));
                for level in levels() {
                    let mut closed = ClosedForm { level, ..ClosedForm::default() };
                    assert!(closed.add_links(&chain, &links, &gravity));
                    closed.add_friction(&fv, &fc);
                    for (found, expected) in closed.torque(&sample).iter().zip(&expected) {
                        assert!((found - expected).abs() < 1e-13 * scale, "{level:?}, {n} joints: {found} {expected}");
                    }
                }
            }
        }
    }
}
