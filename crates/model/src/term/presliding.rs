//! Presliding: elastic friction before sliding, a function of the displacement since the last reversal.

use super::family::*;
use super::one_row::column;
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
    forms: &[
        Form {
            name: "",
            equation: "tau_j = fp_j z, dz/dq_j = (1 - sign(dq_j) z) / delta",
            settings: &[Setting {
                name: "delta",
                what: "displacement over which the contact bends",
                steps: 16,
                ..DELTA
            }],
            build: |_, site, settings| presliding("", site, settings, vec![settings[0]]),
            in_c: IN_C,
            plot_over: PlotOver::Velocity,
        },
        Form {
            name: "spread",
            equation: "tau_j = fp_j (z_1 + z_2 + z_3) / 3, dz_i/dq_j = (1 - sign(dq_j) z_i) / delta_i, delta_i = delta / spread, delta, delta spread",
            settings: &[DELTA, SPREAD],
            build: |_, site, settings| {
                let (delta, spread) = (settings[0], settings[1]);
                presliding("spread", site, settings, vec![delta / spread, delta, delta * spread])
            },
            in_c: IN_C,
            plot_over: PlotOver::Velocity,
        },
    ],
    stratum: Stratum::Repeatable,
    typical: "delta 1 to 50 mrad, fp the Coulomb friction",
    confounded: &[
        confounded("stribeck", SLOW_CONSTANT_SPEEDS),
        confounded("nonlinear-viscous", CONSTANT_SPEEDS),
        confounded("coulomb-slope", SLOW_CONSTANT_SPEEDS),
        confounded("delay", HIGHER_HARMONICS),
    ],
    reference: "Dahl, AIAA Journal 14 (1976); Canudas de Wit et al., IEEE Trans. Automatic Control 40 (1995); of contacts that slide one after the other: Al-Bender, Lampaert, Swevers, the same 50 (2005)",
    rare: Rare { slight_in_every_arm: true, in_bodies: InBodies::CoulombFriction { note: SLIDING }, ..Rare::NONE },
};

const IN_C: InC = InC::Part { columns: |at, _| vec![at.sign.clone()], note: SLIDING };

const DELTA: Setting = Setting {
    name: "delta",
    unit: "rad",
    what: "middle one of the displacements over which the contacts bend",
    low: 3e-5,
    high: 0.1,
    steps: 8,
    scale: Scale::Logarithmic,
};

const SPREAD: Setting = Setting {
    name: "spread",
    unit: "1",
    what: "ratio of these displacements",
    low: 2.0,
    high: 10.0,
    steps: 1,
    scale: Scale::Logarithmic,
};

fn presliding(form: &'static str, site: Site, settings: &[f64], deltas: Vec<f64>) -> Arc<dyn Term> {
    Arc::new(Presliding { form, joint: joint(site), settings: settings.to_vec(), contacts: Contacts::of(deltas) })
}

/// Dahl's law with states that only the position drives: from one sample to the next, with `s = sign(dq)`,
/// `z_i -> s + (z_i - s) exp(-|q - q_before| / delta_i)`, which is exact. A column, the mean of the `z_i`, once the `delta_i` are known.
struct Presliding {
    form: &'static str,
    joint: usize,
    settings: Vec<f64>,
    contacts: Contacts,
}

/// Contacts that bend side by side.
#[derive(Clone)]
struct Contacts {
    /// `delta_i` \[rad\] and `z_i`.
    each: Vec<(f64, f64)>,
}

impl Contacts {
    /// At rest.
    fn of(deltas: Vec<f64>) -> Self {
        Contacts { each: deltas.into_iter().map(|delta| (delta, 0.0)).collect() }
    }

    /// Lets them follow a displacement \[rad\].
    fn step(&mut self, displacement: f64) {
        let s = displacement.signum();
        for (delta, z) in &mut self.each {
            *z = s + (*z - s) * (-displacement.abs() / *delta).exp();
        }
    }

    /// Share of the friction that they carry, -1 to 1.
    fn carried(&self) -> f64 {
        self.each.iter().map(|(_, z)| z).sum::<f64>() / self.each.len() as f64
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
        let form = if self.form.is_empty() { String::new() } else { format!("_{}", self.form) };
        vec![column("fp", Site::Joint(self.joint), &form, "Nm")]
    }

    fn fill(&self, _chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        let samples = motion.samples();
        let q = motion.q.column(self.joint);
        let mut contacts = self.contacts.clone();
        if motion.periodic {
            // The state at the end of the period before.
            (1..samples).for_each(|k| contacts.step(q[k] - q[k - 1]));
            contacts.step(q[0] - q[samples - 1]);
        }
        for k in 0..samples {
            if k > 0 {
                contacts.step(q[k] - q[k - 1]);
            }
            y[(self.joint * samples + k, first)] = contacts.carried();
        }
    }

    fn expects(&self) -> Expected {
        Expected::NotNegative
    }

    fn spec(&self) -> Option<Spec> {
        let (site, settings) = (Site::Joint(self.joint), self.settings.clone());
        Some(Spec { family: FAMILY.id, form: self.form, site, settings })
    }

    fn fix(&self, _chain: &Chain, _gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        Box::new(FixedPresliding { joint: self.joint, fp: beta[0], contacts: self.contacts.clone(), before: None })
    }
}

struct FixedPresliding {
    joint: usize,
    fp: f64,
    contacts: Contacts,
    /// Position at the sample before.
    before: Option<f64>,
}

impl FixedTerm for FixedPresliding {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec) {
        let (Some(&q), Some(tau)) = (sample.q.get(self.joint), tau.get_mut(self.joint)) else { return };
        if let Some(before) = self.before {
            self.contacts.step(q - before);
        }
        self.before = Some(q);
        *tau += self.fp * self.contacts.carried();
    }
}
