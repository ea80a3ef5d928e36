//! Viscous and Coulomb friction of every joint.

use super::per_joint::PerJoint;
use super::{Entry, Term};
use crate::chain::Chain;
pub use crate::fast::sign::SHARPNESS;
use std::sync::Arc;

/// Identity of the term.
pub const ID: &str = "friction";

/// `tau_j = fv_j dq_j + fc_j tanh(100 dq_j)` (paper eq. 2). Columns `fv1 .. fvn`, then `fc1 .. fcn`.
pub fn term(chain: &Chain) -> Arc<dyn Term> {
    let physics = "Bearings, seals and gears resist motion with a part proportional to speed and a constant part against its direction.";
    PerJoint::new(ID, physics)
        .with(chain, ["fv", "fv"], ["Nms/rad", "Ns/m"], |joint| Entry::Velocity { joint })
        .with(chain, ["fc", "fc"], ["Nm", "N"], |joint| Entry::SmoothSign { joint })
        .term()
}
