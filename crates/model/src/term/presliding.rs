//! Presliding: elastic friction before sliding, a function of the displacement since the last reversal.

use super::family::*;
use super::{Column, Expected, FixedTerm, Motion, Sample};
use crate::chain::Chain;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;

/// The part in formats without memory.
const SLIDING: &str = "is held as the Coulomb friction that it is in sliding; its memory, which tells where a joint that turns back was, is \
                       left out";

/// Presliding in one joint.
pub static FAMILY: Family = Family {
    id: "presliding",
    physics: "After a reversal the contacts of gears, bearings and seals deform elastically before they slide.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = fp_j z, dz/dq_j = (1 - sign(dq_j) z) / delta",
        settings: &[Setting {
            name: "delta",
            unit: "rad",
            what: "displacement over which the contact bends",
            low: 3e-5,
            high: 0.1,
            steps: 16,
            scale: Scale::Logarithmic,
        }],
        build,
        in_c: InC::Part { columns: |at, _| vec![at.sign.clone()], note: SLIDING },
        plot_over: PlotOver::Velocity,
    }],
    stratum: Stratum::Repeatable,
    typical: "delta 1 to 50 mrad, fp the Coulomb friction",
    confounded: &[
        confounded("stribeck", SLOW_CONSTANT_SPEEDS),
        confounded("nonlinear-viscous", CONSTANT_SPEEDS),
        confounded("coulomb-slope", SLOW_CONSTANT_SPEEDS),
        confounded("delay", HIGHER_HARMONICS),
    ],
    reference: "Dahl, AIAA Journal 14 (1976); Canudas de Wit et al., IEEE Trans. Automatic Control 40 (1995)",
    rare: Rare { slight_in_every_arm: true, in_bodies: InBodies::CoulombFriction { note: SLIDING }, ..Rare::NONE },
};

fn build(_operating_point: &OperatingPoint, site: Site, settings: &[f64]) -> Arc<dyn Term> {
    Arc::new(Presliding { joint: joint(site), delta: settings[0] })
}

/// Dahl's law with a state that only the position drives: from one sample to the next, with `s = sign(dq)`,
/// `z -> s + (z - s) exp(-|q - q_before| / delta)`, which is exact. A column once `delta` is known.
pub struct Presliding {
    joint: usize,
    delta: f64,
}

impl Presliding {
    /// The state after a displacement \[rad\].
    fn step(z: f64, displacement: f64, delta: f64) -> f64 {
        let s = displacement.signum();
        s + (z - s) * (-displacement.abs() / delta).exp()
    }
}

impl Term for Presliding {
    fn id(&self) -> &'static str {
        FAMILY.id
    }

    fn physics(&self) -> &'static str {
        FAMILY.physics
    }

    fn columns(&self) -> Vec<Column> {
        let name = format!("fp{}", self.joint + 1);
        let expression = name.clone();
        vec![Column { symbol: name.clone(), name, joint: self.joint + 1, unit: "Nm", expression }]
    }

    fn fill(&self, _chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        let samples = motion.samples();
        let q = motion.q.column(self.joint);
        let mut z = 0.0;
        if motion.periodic {
            // The state at the end of the period before.
            for k in 1..samples {
                z = Presliding::step(z, q[k] - q[k - 1], self.delta);
            }
            z = Presliding::step(z, q[0] - q[samples - 1], self.delta);
        }
        for k in 0..samples {
            if k > 0 {
                z = Presliding::step(z, q[k] - q[k - 1], self.delta);
            }
            y[(self.joint * samples + k, first)] = z;
        }
    }

    fn expects(&self) -> Expected {
        Expected::NotNegative
    }

    fn spec(&self) -> Option<Spec> {
        Some(Spec { family: FAMILY.id, form: "", site: Site::Joint(self.joint), settings: vec![self.delta] })
    }

    fn fix(&self, _chain: &Chain, _gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        Box::new(FixedPresliding { joint: self.joint, delta: self.delta, fp: beta[0], z: 0.0, before: None })
    }
}

struct FixedPresliding {
    joint: usize,
    delta: f64,
    fp: f64,
    z: f64,
    /// Position at the sample before.
    before: Option<f64>,
}

impl FixedTerm for FixedPresliding {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec) {
        let (Some(&q), Some(tau)) = (sample.q.get(self.joint), tau.get_mut(self.joint)) else { return };
        if let Some(before) = self.before {
            self.z = Presliding::step(self.z, q - before, self.delta);
        }
        self.before = Some(q);
        *tau += self.fp * self.z;
    }
}
