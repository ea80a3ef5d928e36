//! Terms: the parts a torque model is a sum of.
//!
//! A term has named columns of the regressor and one sentence on its physics. Each effect that diagnosis finds is one more term.
//! A new kind of effect is one new file here.

mod all_rows;
pub mod asymmetric_coulomb;
pub mod asymmetric_viscous;
mod backlash;
pub mod base_motion;
mod carried;
mod catalogue;
pub mod contact;
mod coulomb_slope;
mod delay;
pub mod effect;
pub mod empirical;
mod encoder_eccentricity;
pub mod encoder_offset;
mod family;
pub mod friction;
pub mod friction_change;
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
pub mod payload;
mod per_joint;
mod position_dependent_friction;
mod position_error;
pub mod position_ripple;
mod presliding;
mod quantity;
pub mod rigid_body;
pub mod rotor_inertia;
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

    /// Its physics, in one sentence.
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

    /// Whether it integrates in time with its own steps, so that a coarse evaluation at few samples is possible.
    fn integrates(&self) -> bool {
        false
    }

    /// As [`Term::fill`]; a term that integrates writes the mean of each column since the sample before.
    fn fill_means(&self, chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        self.fill(chain, motion, y, first);
    }

    /// Values that physics allows its parameters. A term that expects a sign or a setting has one parameter, or one per joint.
    fn expects(&self) -> Expected {
        Expected::Any
    }

    /// Its columns as functions of one sample, in order; `None` for other columns than those of [`Entry`].
    fn entries(&self) -> Option<Vec<Entry>> {
        None
    }

    /// Family, form, site and settings, for a model file; `None` for a term of the whole arm.
    fn spec(&self) -> Option<effect::Spec> {
        None
    }

    /// Index of this column in the complete term, where some columns were left out.
    fn original(&self, column: usize) -> usize {
        column
    }

    /// The term with its parameters fixed, for the real-time loop.
    fn fix(&self, chain: &Chain, gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm>;
}

/// Possible values of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Expected {
    /// Any number.
    Any,
    /// 0 or more.
    NotNegative,
    /// 0 or less.
    NotPositive,
    /// Near the first setting, at which the column was computed.
    FirstSetting,
    /// At most this, without its sign: the column is the derivative at 0.
    AtMost(f64),
}

/// A column that depends on one sample. Joints are counted from 0. Every column but a link's is nonzero in its joint's row only.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Entry {
    /// A standard parameter of a rigid link.
    Link {
        /// `10 * link + position` in `[Lxx Lxy Lxz Lyy Lyz Lzz lx ly lz m]`.
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

    /// Sets the sample period \[s\]; 1 ms before the first call.
    fn every(&mut self, _dt: f64) {}

    /// Adds the term to the closed form, which then replaces it; false when the term has no closed form.
    fn join(&self, _closed: &mut ClosedForm) -> bool {
        false
    }
}
