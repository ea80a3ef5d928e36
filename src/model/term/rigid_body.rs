//! The rigid links: inertia, centrifugal and Coriolis torques, gravity.

use super::{Column, FixedTerm, Motion, Sample, Term};
use crate::joint::{JointVec, MAX_JOINTS};
use crate::model::base::Reduction;
use crate::model::chain::Chain;
use crate::model::expression;
use crate::model::fast::closed::ClosedForm;
use crate::model::regressor::{LINK_COLUMNS, regressor};
use crate::model::rnea::{LinkParameters, rnea};
use nalgebra::{DMatrix, Vector3};

/// Identity of [`RigidBody`].
pub const ID: &str = "rigid-body";

/// `tau = Y_b(q, dq, ddq, rho, phi) beta` (paper eq. 7): the base columns of a [`Reduction`].
pub struct RigidBody {
    independent: Vec<usize>,
    columns: Vec<Column>,
}

impl RigidBody {
    /// The base parameters that a reduction leaves.
    pub fn new(reduction: &Reduction) -> RigidBody {
        RigidBody { independent: reduction.independent().to_vec(), columns: expression::columns(reduction) }
    }
}

impl Term for RigidBody {
    fn id(&self) -> &'static str {
        ID
    }

    fn physics(&self) -> &'static str {
        "The links are rigid bodies that have to be accelerated and held against gravity."
    }

    fn columns(&self) -> Vec<Column> {
        self.columns.clone()
    }

    fn fill(&self, chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        let (n, samples) = (motion.joints(), motion.samples());
        let mut standard = DMatrix::zeros(n, n * LINK_COLUMNS);
        let (mut q, mut dq, mut ddq) = ([0.0; MAX_JOINTS], [0.0; MAX_JOINTS], [0.0; MAX_JOINTS]);
        for k in 0..samples {
            for j in 0..n {
                (q[j], dq[j], ddq[j]) = (motion.q[(k, j)], motion.dq[(k, j)], motion.ddq[(k, j)]);
            }
            regressor(chain, &motion.gravity, &q[..n], &dq[..n], &ddq[..n], &mut standard);
            for (c, &slot) in self.independent.iter().enumerate() {
                // A link moves only the joints up to its own.
                for j in 0..=slot / LINK_COLUMNS {
                    y[(j * samples + k, first + c)] = standard[(j, slot)];
                }
            }
        }
    }

    fn fix(&self, chain: &Chain, gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        // Base parameters go straight into the slots of their names; a slot that is zero costs nothing.
        let mut links = vec![LinkParameters::default(); chain.len()];
        for (&slot, &value) in self.independent.iter().zip(beta) {
            links[slot / LINK_COLUMNS][slot % LINK_COLUMNS] = value;
        }
        Box::new(FixedRigidBody { chain: chain.clone(), links, gravity: *gravity })
    }
}

struct FixedRigidBody {
    chain: Chain,
    links: Vec<LinkParameters>,
    gravity: Vector3<f64>,
}

impl FixedTerm for FixedRigidBody {
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec) {
        let mut own = JointVec::default();
        rnea(&self.chain, &self.links, &self.gravity, &sample.q, &sample.dq, &sample.ddq, &mut own);
        for (tau, own) in tau.iter_mut().zip(&own) {
            *tau += own;
        }
    }

    fn join(&self, closed: &mut ClosedForm) -> bool {
        closed.add_links(&self.chain, &self.links, &self.gravity)
    }
}
