//! Offset of a torque sensor.

use super::Entry;
use super::family::*;
use super::per_joint::PerJoint;
use super::subset::of_joint;
use crate::chain::Chain;

/// Identity of the effect and of the term of the whole arm.
pub const ID: &str = "torque-offset";

/// An offset in one joint.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "The torque (or current) sensor reads a constant at zero torque.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = offset_j",
        settings: &[],
        build: |operating_point, site, _| of_joint(term(&operating_point.chain), site),
        in_c: InC::Entries,
        plot_over: PlotOver::Position,
    }],
    stratum: Stratum::Repeatable,
    typical: "0.05 to 0.5 Nm",
    confounded: &[
        confounded("asymmetric-coulomb", STANDSTILL),
        confounded("spring", MOST_OF_RANGE),
        confounded("position-ripple", FULL_TURN),
    ],
    reference: "Gautier, Janot, Vandanjon, IEEE Trans. Control Systems Technology 21 (2013); Gaz et al., IEEE RA-L 4 (2019)",
    rare: Rare { whole_arm: Some(term), in_every_arm: true, may_change: true, comes_at_once: true, ..Rare::NONE },
};

/// `tau_j = offset_j` in every joint. Columns `offset1 .. offsetn`.
pub fn term(chain: &Chain) -> Arc<dyn Term> {
    PerJoint::new(ID, FAMILY.physics)
        .with(chain, ["offset", "offset"], ["Nm", "N"], |joint| Entry::Constant { joint })
        .term()
}
