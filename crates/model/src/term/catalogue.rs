//! The registry of terms and effects. A new effect is one line of [`FAMILIES`].

use super::family::Family;
use super::*;

/// Terms of the whole arm: identity, and the term with all of its columns.
type WholeArm = (&'static str, fn(&Chain, &Reduction) -> Arc<dyn Term>);

const WHOLE_ARM: [WholeArm; 4] = [
    (rigid_body::ID, |_, reduction| Arc::new(rigid_body::RigidBody::new(reduction))),
    (friction::ID, |chain, _| friction::term(chain)),
    (torque_offset::ID, |chain, _| torque_offset::term(chain)),
    (rotor_inertia::ID, |chain, _| rotor_inertia::term(chain)),
];

/// Identity of every term of the whole arm.
pub const KNOWN: [&str; 4] = [WHOLE_ARM[0].0, WHOLE_ARM[1].0, WHOLE_ARM[2].0, WHOLE_ARM[3].0];

/// The term of that identity for an arm, with all of its columns; `None` when it is not one of [`KNOWN`].
pub fn by_id(id: &str, chain: &Chain, reduction: &Reduction) -> Option<Arc<dyn Term>> {
    let (_, build) = WHOLE_ARM.iter().find(|(own, _)| *own == id)?;
    Some(build(chain, reduction))
}

/// Every kind of effect.
pub static FAMILIES: &[&Family] = &[
    &torque_offset::FAMILY,
    &torque_gain::FAMILY,
    &asymmetric_coulomb::FAMILY,
    &asymmetric_viscous::FAMILY,
    &stribeck::FAMILY,
    &coulomb_slope::FAMILY,
    &nonlinear_viscous::FAMILY,
    &load_dependent_friction::FAMILY,
    &friction_drift::FAMILY,
    &offset_drift::FAMILY,
    &presliding::FAMILY,
    &rotor_inertia::FAMILY,
    &joint_elasticity::FAMILY,
    &position_ripple::FAMILY,
    &position_dependent_friction::FAMILY,
    &spring::FAMILY,
    &payload::FAMILY,
    &friction_change::FAMILY,
    &mounting::FAMILY,
    &base_motion::FAMILY,
    &torque_crosstalk::FAMILY,
    &transmission_coupling::FAMILY,
    &delay::FAMILY,
    &contact::FAMILY,
    &encoder_offset::FAMILY,
    &encoder_eccentricity::FAMILY,
    &backlash::FAMILY,
    &empirical::FAMILY,
    #[cfg(feature = "made-up-effect")]
    &made_up::FAMILY,
];

/// The family of that identity.
pub fn family(id: &str) -> Option<&'static Family> {
    FAMILIES.iter().copied().find(|family| family.id == id)
}
