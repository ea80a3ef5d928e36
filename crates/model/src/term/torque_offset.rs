//! A constant torque in every joint's measurement.

use super::family::{Confounded, Family, Form, InBodies, InC, Place, PlotOver, Rare, Stratum};
use super::subset::of_joint;
use super::{Column, Entry, FixedTerm, Motion, Sample, Term, padded, per_joint};
use crate::chain::{Chain, JointKind};
use crate::fast::closed::ClosedForm;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;
use std::sync::Arc;

/// Identity of [`TorqueOffset`].
pub const ID: &str = "torque-offset";

const PHYSICS: &str = "The torque sensor (or current sensor) reads a constant when the torque is zero.";

/// An offset in one joint.
pub static FAMILY: Family = Family {
    id: ID,
    physics: PHYSICS,
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = offset_j",
        settings: &[],
        build: |operating_point, site, _| of_joint(Arc::new(TorqueOffset::new(&operating_point.chain)), site),
        in_c: InC::Entries,
        plot_over: PlotOver::Position,
    }],
    stratum: Stratum::Repeatable,
    served: true,
    typical: "0.05 to 0.5 Nm",
    confounded: &[
        Confounded { with: "asymmetric-coulomb", decided_by: "hold the joint still for some seconds in several poses" },
        Confounded { with: "spring", decided_by: "move the joint through more than 60 % of its range" },
        Confounded { with: "position-ripple", decided_by: "move the joint through a full turn, or as far as it goes" },
    ],
    reference: "Gautier, Janot, Vandanjon, IEEE Trans. Control Systems Technology 21 (2013); Gaz et al., IEEE RA-L 4 (2019)",
    in_bodies: InBodies::Nothing,
    rare: Rare {
        whole_arm: Some(|chain| Arc::new(TorqueOffset::new(chain))),
        in_every_arm: true,
        may_change: true,
        ..Rare::NONE
    },
};

/// `tau_j = offset_j`. Columns `offset1 .. offsetn`.
pub struct TorqueOffset {
    columns: Vec<Column>,
}

impl TorqueOffset {
    /// An offset in every joint.
    pub fn new(chain: &Chain) -> TorqueOffset {
        let columns = per_joint(chain, "offset", "offset", |kind| match kind {
            JointKind::Revolute => "Nm",
            JointKind::Prismatic => "N",
        });
        TorqueOffset { columns }
    }
}

impl Term for TorqueOffset {
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
            y.view_mut((j * samples, first + j), (samples, 1)).fill(1.0);
        }
    }

    fn entries(&self) -> Option<Vec<Entry>> {
        Some((0..self.columns.len()).map(|joint| Entry::Constant { joint }).collect())
    }

    fn fix(&self, _chain: &Chain, _gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        Box::new(FixedOffset(padded(beta)))
    }
}

struct FixedOffset(JointVec);

impl FixedTerm for FixedOffset {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn torque(&mut self, _sample: &Sample, tau: &mut JointVec) {
        for (tau, offset) in tau.iter_mut().zip(&self.0) {
            *tau += offset;
        }
    }

    fn join(&self, closed: &mut ClosedForm) -> bool {
        closed.add_offset(&self.0);
        true
    }
}
