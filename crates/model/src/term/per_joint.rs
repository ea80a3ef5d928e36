//! Terms of the whole arm whose columns each depend on one joint's motion and act on that joint.

use super::{Column, Entry, Expected, FixedTerm, Motion, Sample, Term};
use crate::chain::{Chain, JointKind};
use crate::fast::closed::ClosedForm;
use crate::fast::sign::{SHARPNESS, smooth_signs};
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;
use std::sync::Arc;

/// `tau_j = fv_j dq_j + fc_j tanh(100 dq_j) + ia_j ddq_j + offset_j`, as far as the term has these columns.
pub(super) struct PerJoint {
    id: &'static str,
    physics: &'static str,
    columns: Vec<Column>,
    entries: Vec<Entry>,
    expects: Expected,
}

impl PerJoint {
    /// Without columns.
    pub fn new(id: &'static str, physics: &'static str) -> PerJoint {
        PerJoint { id, physics, columns: Vec::new(), entries: Vec::new(), expects: Expected::Any }
    }

    /// Adds one column per joint, called `name` and the joint's number. `units` are those of a revolute and of a prismatic joint.
    pub fn with(
        mut self,
        chain: &Chain,
        [name, symbol]: [&str; 2],
        units: [&'static str; 2],
        entry: fn(usize) -> Entry,
    ) -> PerJoint {
        for (j, joint) in chain.joints().iter().enumerate() {
            let name = format!("{name}{}", j + 1);
            let unit = units[usize::from(joint.kind == JointKind::Prismatic)];
            let symbol = format!("{symbol}{}", j + 1);
            self.columns.push(Column { symbol, expression: name.clone(), name, joint: j + 1, unit });
            self.entries.push(entry(j));
        }
        self
    }

    /// No parameter can be below zero.
    pub fn not_negative(self) -> PerJoint {
        PerJoint { expects: Expected::NotNegative, ..self }
    }

    pub fn term(self) -> Arc<dyn Term> {
        Arc::new(self)
    }
}

impl Term for PerJoint {
    fn id(&self) -> &'static str {
        self.id
    }

    fn physics(&self) -> &'static str {
        self.physics
    }

    fn columns(&self) -> Vec<Column> {
        self.columns.clone()
    }

    fn fill(&self, _chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        let (samples, height) = (motion.samples(), y.nrows());
        // Column-major: a joint's rows of a column are contiguous.
        let columns = y.as_mut_slice()[first * height..].chunks_exact_mut(height);
        for (column, entry) in columns.zip(&self.entries) {
            match *entry {
                Entry::Velocity { joint } => {
                    column[joint * samples..][..samples].copy_from_slice(motion.dq.column(joint).as_slice());
                }
                Entry::SmoothSign { joint } => {
                    smooth_signs(motion.dq.column(joint).as_slice(), &mut column[joint * samples..][..samples]);
                }
                Entry::Acceleration { joint } => {
                    column[joint * samples..][..samples].copy_from_slice(motion.ddq.column(joint).as_slice());
                }
                Entry::Constant { joint } => column[joint * samples..][..samples].fill(1.0),
                Entry::Link { .. } => {}
            }
        }
    }

    fn expects(&self) -> Expected {
        self.expects
    }

    fn entries(&self) -> Option<Vec<Entry>> {
        Some(self.entries.clone())
    }

    fn fix(&self, _chain: &Chain, _gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        let mut fixed = FixedPerJoint::default();
        for (entry, value) in self.entries.iter().zip(beta) {
            match *entry {
                Entry::Velocity { joint } => fixed.viscous[joint] = *value,
                Entry::SmoothSign { joint } => fixed.coulomb[joint] = *value,
                Entry::Acceleration { joint } => fixed.rotor[joint] = *value,
                Entry::Constant { joint } => fixed.offset[joint] = *value,
                Entry::Link { .. } => {}
            }
        }
        Box::new(fixed)
    }
}

#[derive(Default)]
struct FixedPerJoint {
    viscous: JointVec,
    coulomb: JointVec,
    rotor: JointVec,
    offset: JointVec,
}

impl FixedTerm for FixedPerJoint {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec) {
        for (j, tau) in tau.iter_mut().enumerate() {
            let (dq, sign) = (sample.dq[j], (SHARPNESS * sample.dq[j]).tanh());
            *tau += self.viscous[j] * dq + self.coulomb[j] * sign + self.rotor[j] * sample.ddq[j] + self.offset[j];
        }
    }

    fn join(&self, closed: &mut ClosedForm) -> bool {
        closed.add_friction(&self.viscous, &self.coulomb);
        closed.add_rotors(&self.rotor);
        closed.add_offset(&self.offset);
        true
    }
}
