//! Inertia of the motors' rotors, seen through the gears.

use super::family::{Confounded, Family, Form, InBodies, InC, Place, PlotOver, Rare, Stratum};
use super::subset::of_joint;
use super::{Column, Entry, FixedTerm, Motion, Sample, Term, padded, per_joint};
use crate::chain::{Chain, JointKind};
use crate::fast::closed::ClosedForm;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;
use std::sync::Arc;

/// Identity of [`RotorInertia`].
pub const ID: &str = "rotor-inertia";

const PHYSICS: &str =
    "The motor has to accelerate its own rotor, whose inertia the gear multiplies by the square of its ratio.";

/// The rotor of one joint.
pub static FAMILY: Family = Family {
    id: ID,
    physics: PHYSICS,
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = ia_j ddq_j",
        settings: &[],
        build: |operating_point, site, _| of_joint(Arc::new(RotorInertia::new(&operating_point.chain)), site),
        in_c: InC::Entries,
        plot_over: PlotOver::Acceleration,
    }],
    stratum: Stratum::Repeatable,
    served: true,
    typical: "0.05 to 1 kg m2 at the joint",
    confounded: &[Confounded {
        with: "Lzz of the same link",
        decided_by: "none is needed on the first joints: the two are one parameter there; further out, accelerate that joint harder",
    }],
    reference: "Khalil, Dombre, Modeling, Identification and Control of Robots (2002), section 9.4",
    in_bodies: InBodies::Nothing,
    rare: Rare { whole_arm: Some(|chain| Arc::new(RotorInertia::new(chain))), ..Rare::NONE },
};

/// `tau_j = ia_j ddq_j`, the rotor's inertia times the gear ratio squared, in the joint's own row. Columns `ia1 .. ian`.
///
/// Torques measured on the motor's side of the gear hold it; joint torque sensors on the link's side do not. The rigid body
/// absorbs some of them (joints 1 and 2 of most arms): [`crate::structure::Structure::identifiable`] takes those out.
/// Gyroscopic effects of the rotor on other joints are left out, as usual.
pub struct RotorInertia {
    columns: Vec<Column>,
}

impl RotorInertia {
    /// A rotor in every joint.
    pub fn new(chain: &Chain) -> RotorInertia {
        let columns = per_joint(chain, "ia", "Ia", |kind| match kind {
            JointKind::Revolute => "kg m2",
            JointKind::Prismatic => "kg",
        });
        RotorInertia { columns }
    }
}

impl Term for RotorInertia {
    fn id(&self) -> &'static str {
        ID
    }

    fn physics(&self) -> &'static str {
        PHYSICS
    }

    fn columns(&self) -> Vec<Column> {
        self.columns.clone()
    }

    fn fill(&self, _chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        let samples = motion.samples();
        for j in 0..motion.joints() {
            y.view_mut((j * samples, first + j), (samples, 1)).copy_from(&motion.ddq.column(j));
        }
    }

    fn not_negative(&self, _column: usize) -> bool {
        true
    }

    fn entries(&self) -> Option<Vec<Entry>> {
        Some((0..self.columns.len()).map(|joint| Entry::Acceleration { joint }).collect())
    }

    fn fix(&self, _chain: &Chain, _gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        Box::new(FixedRotors(padded(beta)))
    }
}

struct FixedRotors(JointVec);

impl FixedTerm for FixedRotors {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec) {
        for ((tau, ia), ddq) in tau.iter_mut().zip(&self.0).zip(&sample.ddq) {
            *tau += ia * ddq;
        }
    }

    fn join(&self, closed: &mut ClosedForm) -> bool {
        closed.add_rotors(&self.0);
        true
    }
}
