//! Rigid links: inertia, centrifugal and Coriolis torques, gravity.

use super::{Column, Entry, FixedTerm, Motion, Sample, Term};
use crate::base::Reduction;
use crate::chain::Chain;
use crate::expression;
use crate::fast::closed::ClosedForm;
use crate::fast::links::LinkColumns;
use crate::regressor::LINK_COLUMNS;
use crate::rnea::{LinkParameters, rnea};
use nalgebra::{DMatrix, Vector3};
use plumbline_core::{JointVec, MAX_JOINTS};

/// Identity of [`RigidBody`].
pub const ID: &str = "rigid-body";

/// Samples whose columns are computed before they are written.
const BLOCK_SAMPLES: usize = 8;

/// `tau = Y_b(q, dq, ddq, rho, phi) beta` (paper eq. 7): the base columns of a [`Reduction`].
pub struct RigidBody {
    independent: Vec<usize>,
    columns: Vec<Column>,
}

impl RigidBody {
    /// The base parameters of a reduction.
    pub fn new(reduction: &Reduction) -> RigidBody {
        RigidBody { independent: reduction.independent().to_vec(), columns: expression::base_columns(reduction) }
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
        let (n, samples, height) = (motion.joints(), motion.samples(), y.nrows());
        let mut links = LinkColumns::new(chain, &self.independent, &motion.gravity);
        // A joint's rows of a column are contiguous, those of different joints and columns far apart: several samples at a time, so that
        // each piece of memory is visited once per block.
        let mut block = vec![[[0.0; MAX_JOINTS]; BLOCK_SAMPLES]; self.independent.len()];
        let mut one = vec![[0.0; MAX_JOINTS]; self.independent.len()];
        let mut sample = Sample::default();
        let y = y.as_mut_slice();
        for start in (0..samples).step_by(BLOCK_SAMPLES) {
            let count = BLOCK_SAMPLES.min(samples - start);
            for k in 0..count {
                for j in 0..n {
                    let at = (start + k, j);
                    (sample.q[j], sample.dq[j], sample.ddq[j]) = (motion.q[at], motion.dq[at], motion.ddq[at]);
                }
                links.fill(&sample, &mut one);
                block.iter_mut().zip(&one).for_each(|(column, one)| column[k] = *one);
            }
            for ((c, &slot), column) in self.independent.iter().enumerate().zip(&block) {
                // A link moves only the joints up to its own.
                for j in 0..=slot / LINK_COLUMNS {
                    let rows = &mut y[(first + c) * height + j * samples + start..][..count];
                    rows.iter_mut().zip(column).for_each(|(row, lanes)| *row = lanes[j]);
                }
            }
        }
    }

    fn entries(&self) -> Option<Vec<Entry>> {
        Some(self.independent.iter().map(|&slot| Entry::Link { slot }).collect())
    }

    fn fix(&self, chain: &Chain, gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        // Base parameters take the slots of their names; the other slots are zero.
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
    #[cfg_attr(no_panic, no_panic::no_panic)]
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
