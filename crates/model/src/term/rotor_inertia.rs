//! Rotor inertia of the motors, at the joint's side of the gears.

use super::Entry;
use super::family::*;
use super::per_joint::PerJoint;
use super::subset::of_joint;
use crate::chain::Chain;

/// Identity of the effect and of the term of the whole arm.
pub const ID: &str = "rotor-inertia";

/// The rotor of one joint.
pub static FAMILY: Family = Family {
    id: ID,
    physics: "The motor accelerates its own rotor, whose inertia acts at the joint times the square of the gear ratio.",
    place: Place::Joint,
    forms: &[Form {
        name: "",
        equation: "tau_j = ia_j ddq_j",
        settings: &[],
        build: |operating_point, site, _| of_joint(term(&operating_point.chain), site),
        in_c: InC::Entries,
        plot_over: PlotOver::Acceleration,
    }],
    stratum: Stratum::Repeatable,
    typical: "0.05 to 1 kg m2 at the joint",
    confounded: &[confounded(
        "Lzz of the same link",
        "none is needed on the first joints: the two are one parameter there; further out, accelerate that joint harder",
    )],
    reference: "Khalil, Dombre, Modeling, Identification and Control of Robots (2002), section 9.4",
    rare: Rare { whole_arm: Some(term), ..Rare::NONE },
};

/// `tau_j = ia_j ddq_j`, the rotor's inertia times the gear ratio squared, in the joint's own row. Columns `ia1 .. ian`.
///
/// Torques measured on the motor's side of the gear contain it; those of sensors on the link's side do not. The rigid body
/// absorbs some of them (joints 1 and 2 of most arms): [`crate::structure::Structure::identifiable`] removes those.
/// Gyroscopic effects of the rotor on other joints are neglected, as usual.
pub fn term(chain: &Chain) -> Arc<dyn Term> {
    PerJoint::new(ID, FAMILY.physics)
        .with(chain, ["ia", "Ia"], ["kg m2", "kg"], |joint| Entry::Acceleration { joint })
        .not_negative()
        .term()
}
