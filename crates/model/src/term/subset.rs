//! A term without some of its columns.

use super::family::{Site, Spec, joint};
use super::{Column, Entry, Expected, FixedTerm, Motion, Term};
use crate::chain::Chain;
use nalgebra::{DMatrix, Vector3};
use std::sync::Arc;

/// Another term without some columns, whose parameters are zero.
pub struct Subset {
    inner: Arc<dyn Term>,
    kept: Vec<usize>,
}

impl Subset {
    /// The columns of `inner` for which `keep` holds; `inner` itself when that is all of them, `None` when it is none.
    pub fn of(inner: Arc<dyn Term>, keep: impl Fn(&Column) -> bool) -> Option<Arc<dyn Term>> {
        let columns = inner.columns();
        let kept: Vec<usize> = (0..columns.len()).filter(|&c| keep(&columns[c])).collect();
        if kept.is_empty() {
            None
        } else if kept.len() == columns.len() {
            Some(inner)
        } else {
            Some(Arc::new(Subset { inner, kept }))
        }
    }
}

impl Term for Subset {
    fn id(&self) -> &'static str {
        self.inner.id()
    }

    fn physics(&self) -> &'static str {
        self.inner.physics()
    }

    fn columns(&self) -> Vec<Column> {
        let columns = self.inner.columns();
        self.kept.iter().map(|&c| columns[c].clone()).collect()
    }

    fn fill(&self, chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        let mut all = DMatrix::zeros(y.nrows(), self.inner.columns().len());
        self.inner.fill(chain, motion, &mut all, 0);
        for (to, &from) in self.kept.iter().enumerate() {
            y.column_mut(first + to).copy_from(&all.column(from));
        }
    }

    fn smooth(&self) -> bool {
        self.inner.smooth()
    }

    fn entries(&self) -> Option<Vec<Entry>> {
        let entries = self.inner.entries()?;
        Some(self.kept.iter().map(|&c| entries[c]).collect())
    }

    fn expects(&self) -> Expected {
        self.inner.expects()
    }

    fn spec(&self) -> Option<Spec> {
        self.inner.spec()
    }

    fn original(&self, column: usize) -> usize {
        self.inner.original(self.kept[column])
    }

    fn fix(&self, chain: &Chain, gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        let mut all = vec![0.0; self.inner.columns().len()];
        for (&c, value) in self.kept.iter().zip(beta) {
            all[c] = *value;
        }
        self.inner.fix(chain, gravity, &all)
    }
}

/// One joint's column of a term that has one per joint.
pub(super) fn of_joint(term: Arc<dyn Term>, site: Site) -> Arc<dyn Term> {
    let joint = joint(site) + 1;
    let own = Subset::of(Arc::clone(&term), |column| column.joint == joint);
    own.unwrap_or(term)
}
