//! Viscous and Coulomb friction of every joint.

use super::{Column, Entry, FixedTerm, Motion, Sample, Term, padded, per_joint};
use crate::chain::{Chain, JointKind};
use crate::fast::closed::ClosedForm;
pub use crate::fast::sign::SHARPNESS;
use crate::fast::sign::smooth_signs;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;

/// Identity of [`Friction`].
pub const ID: &str = "friction";

/// `tau_j = fv_j dq_j + fc_j tanh(100 dq_j)` (paper eq. 2). Columns `fv1 .. fvn`, then `fc1 .. fcn`.
pub struct Friction {
    columns: Vec<Column>,
}

impl Friction {
    /// Friction in every joint.
    pub fn new(chain: &Chain) -> Friction {
        let mut columns = per_joint(chain, "fv", "fv", |kind| match kind {
            JointKind::Revolute => "Nms/rad",
            JointKind::Prismatic => "Ns/m",
        });
        columns.extend(per_joint(chain, "fc", "fc", |kind| match kind {
            JointKind::Revolute => "Nm",
            JointKind::Prismatic => "N",
        }));
        Friction { columns }
    }
}

impl Term for Friction {
    fn id(&self) -> &'static str {
        ID
    }

    fn physics(&self) -> &'static str {
        "Bearings, seals and gears resist motion with a part proportional to speed and a constant part against its direction."
    }

    fn columns(&self) -> Vec<Column> {
        self.columns.clone()
    }

    fn fill(&self, _chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        let (n, samples) = (motion.joints(), motion.samples());
        for j in 0..n {
            let (dq, rows) = (motion.dq.column(j), j * samples..(j + 1) * samples);
            y.view_mut((rows.start, first + j), (samples, 1)).copy_from(&dq);
            // One column is one piece of memory.
            let height = y.nrows();
            let column = &mut y.as_mut_slice()[(first + n + j) * height..][..height];
            smooth_signs(dq.as_slice(), &mut column[rows]);
        }
    }

    fn entries(&self) -> Option<Vec<Entry>> {
        let n = self.columns.len() / 2;
        let signs = (0..n).map(|joint| Entry::SmoothSign { joint });
        Some((0..n).map(|joint| Entry::Velocity { joint }).chain(signs).collect())
    }

    fn fix(&self, _chain: &Chain, _gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        let (fv, fc) = beta.split_at(self.columns.len() / 2);
        Box::new(FixedFriction { fv: padded(fv), fc: padded(fc) })
    }
}

struct FixedFriction {
    fv: JointVec,
    fc: JointVec,
}

impl FixedTerm for FixedFriction {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec) {
        for (j, tau) in tau.iter_mut().enumerate() {
            *tau += self.fv[j] * sample.dq[j] + self.fc[j] * (SHARPNESS * sample.dq[j]).tanh();
        }
    }

    fn join(&self, closed: &mut ClosedForm) -> bool {
        closed.add_friction(&self.fv, &self.fc);
        true
    }
}
