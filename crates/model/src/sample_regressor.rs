//! The regressor of a whole structure at one sample.

use crate::fast::links::LinkColumns;
use crate::fast::sign::smooth_sign;
use crate::fast::vector_level;
use crate::structure::Structure;
use crate::term::{Entry, Sample};
use fearless_simd::{Level, dispatch};
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};

/// `Y` sample by sample, for structures without terms that depend on earlier samples. Allocates at creation only.
#[derive(Clone, Debug)]
pub struct SampleRegressor {
    level: Level,
    joints: usize,
    links: LinkColumns,
    /// The columns after those of the links.
    others: Vec<Entry>,
    has_sign: bool,
    columns: Vec<[f64; MAX_JOINTS]>,
}

impl SampleRegressor {
    /// The regressor of a structure under `gravity` in the base frame \[m/s2\]. The error is the identity of a term that depends on
    /// more than one sample.
    pub fn new(structure: &Structure, gravity: &Vector3<f64>) -> Result<SampleRegressor, &'static str> {
        let (mut slots, mut others) = (Vec::new(), Vec::new());
        for term in structure.terms() {
            for entry in term.entries().ok_or(term.id())? {
                match entry {
                    Entry::Link { slot } if others.is_empty() => slots.push(slot),
                    // The links' columns are the first of every structure.
                    Entry::Link { .. } => return Err(term.id()),
                    other => others.push(other),
                }
            }
        }
        let links = LinkColumns::new(structure.chain(), &slots, gravity);
        Ok(SampleRegressor {
            level: vector_level(),
            joints: structure.chain().len(),
            has_sign: others.iter().any(|entry| matches!(entry, Entry::SmoothSign { .. })),
            columns: vec![[0.0; MAX_JOINTS]; slots.len() + others.len()],
            links,
            others,
        })
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.joints
    }

    /// Number of columns.
    pub fn len(&self) -> usize {
        self.columns.len()
    }

    /// Whether there is no column.
    pub fn is_empty(&self) -> bool {
        self.columns.is_empty()
    }

    /// `Y` at a sample: element `c` is column `c` of the structure, its entry `j` is joint `j`'s row; entries past the arm's joints are zero.
    pub fn at(&mut self, sample: &Sample) -> &[[f64; MAX_JOINTS]] {
        let (links, others) = self.columns.split_at_mut(self.links.len());
        self.links.fill(sample, links);
        let mut sign = JointVec::default();
        if self.has_sign {
            let level = self.level;
            dispatch!(level, simd => smooth_sign(simd, &sample.dq, &mut sign));
        }
        for (column, entry) in others.iter_mut().zip(&self.others) {
            match *entry {
                Entry::Velocity { joint } => column[joint] = sample.dq[joint],
                Entry::SmoothSign { joint } => column[joint] = sign[joint],
                Entry::Acceleration { joint } => column[joint] = sample.ddq[joint],
                Entry::Constant { joint } => column[joint] = 1.0,
                // Those of the links are in `links`.
                Entry::Link { .. } => {}
            }
        }
        &self.columns
    }
}
