//! Terms: the parts a torque model is a sum of.
//!
//! A term contributes named columns to the regressor and says in one sentence what it is physically. An effect that diagnosis
//! finds is added by pushing one more term; a new kind of effect is one new file here.

mod all_rows;
pub mod asymmetric_coulomb;
pub mod asymmetric_viscous;
mod backlash;
pub mod base_motion;
mod carried;
mod catalogue;
pub mod contact;
mod delay;
pub mod effect;
mod encoder_eccentricity;
mod encoder_offset;
mod family;
pub mod friction;
mod friction_change;
pub mod friction_drift;
pub mod joint_elasticity;
pub mod load;
mod load_dependent_friction;
#[cfg(feature = "made-up-effect")]
mod made_up;
pub mod mounting;
mod nonlinear_viscous;
pub mod offset_drift;
mod one_row;
mod payload;
mod per_joint;
mod position_dependent_friction;
mod position_error;
pub mod position_ripple;
mod presliding;
mod quantity;
pub mod rigid_body;
mod rotor_inertia;
pub mod spring;
mod stribeck;
pub(crate) mod subset;
mod swing;
mod torque_crosstalk;
mod torque_gain;
pub mod torque_offset;
mod transmission_coupling;

pub use super::motion::{Motion, Sample};
pub use super::parameter::Column;
pub use catalogue::{KNOWN, by_id};

use super::base::Reduction;
use super::chain::Chain;
use super::fast::closed::ClosedForm;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::JointVec;
use std::sync::Arc;

/// A part of the model that contributes named columns to the regressor.
pub trait Term: Send + Sync {
    /// Stable identity, as in the model file: `rigid-body`, `friction`, `torque-offset`.
    fn id(&self) -> &'static str;

    /// What it is physically, in one sentence.
    fn physics(&self) -> &'static str;

    /// Its columns, in order.
    fn columns(&self) -> Vec<Column>;

    /// Writes its columns for a whole motion into `y`, columns `first .. first + columns().len()`.
    ///
    /// `y` has n N rows, joint by joint: joint `j` (from 0), sample `k` is row `j N + k`. Its entries are zero on entry.
    fn fill(&self, chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize);

    /// Whether its columns are as smooth in time as the motion, with no step where a joint turns back.
    fn smooth(&self) -> bool {
        false
    }

    /// Whether it integrates in time with steps of its own, and so may be looked at roughly, at few samples.
    fn integrates(&self) -> bool {
        false
    }

    /// As [`Term::fill`], where it integrates the means of its columns between each sample and the one before.
    fn fill_means(&self, chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        self.fill(chain, motion, y, first);
    }

    /// What its only parameter can be.
    fn expects(&self) -> Expected {
        Expected::Any
    }

    /// Whether the parameter of this column can't be below zero by its physics. A search may pass values below zero; a model that is delivered
    /// has none.
    fn not_negative(&self, _column: usize) -> bool {
        self.expects() == Expected::NotNegative
    }

    /// What its columns are at one sample, in their order; `None` when they depend on more than that sample.
    fn entries(&self) -> Option<Vec<Entry>> {
        None
    }

    /// What tells it from other effects of its family, for a model file; `None` for a term of the whole arm.
    fn spec(&self) -> Option<effect::Spec> {
        None
    }

    /// Which column of the whole term this column is, where some were left out.
    fn original(&self, column: usize) -> usize {
        column
    }

    /// The term with its parameters fixed, for the real-time loop.
    fn fix(&self, chain: &Chain, gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm>;
}

/// What the only parameter of a term can be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Expected {
    /// Any number.
    Any,
    /// None below zero.
    NotNegative,
    /// About the first of its settings, which its column was computed for.
    FirstSetting,
}

/// A column that depends on one sample alone. Joints are counted from 0; all but a link's column have that joint's row alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// A standard parameter of a rigid link, `10 * link + position` in `[Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m]`.
    Link {
        /// That place.
        slot: usize,
    },
    /// `dq_j`.
    Velocity {
        /// The joint.
        joint: usize,
    },
    /// `tanh(100 dq_j)` (paper eq. 2).
    SmoothSign {
        /// The joint.
        joint: usize,
    },
    /// `ddq_j`.
    Acceleration {
        /// The joint.
        joint: usize,
    },
    /// One.
    Constant {
        /// The joint.
        joint: usize,
    },
}

/// A term with known parameters. `torque` neither allocates nor panics.
pub trait FixedTerm: Send {
    /// Adds the term's torque at `sample` to `tau` \[Nm\].
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec);

    /// Samples come every `dt` from now on \[s\]; before the first call, every millisecond.
    fn every(&mut self, _dt: f64) {}

    /// Adds itself to the part of the model that is computed in one pass, and is not called any more. False when it has no such form.
    fn join(&self, _closed: &mut ClosedForm) -> bool {
        false
    }
}
