//! Effects that are parts of another one.
//!
//! A torque sensor with cross-talk measures a share of another joint's torque, friction included. The column of `torque-crosstalk` is the
//! rigid-body torque alone, so the search finds the rest as friction between the two joints. A family declares this ([`PartOf`]): where the
//! form's first coefficient is the other effect's share of the cause's own friction, both are reported as one effect.
//!
//! A law of friction or of a gear is an approximation, and the search finds what it leaves as a second one of the same joint: one of a small share of the
//! first is reported with it.

use super::outcome::{Effect, Quantity};
use plumbline_model::term::effect::{Form, PartOf, Site, Spec};

/// Largest difference of the coefficient from the share, in standard deviations,
const MAX_DEVIATIONS: f64 = 4.0;
/// plus this share of the coefficient: friction is a step in one column and smooth in the other.
const FORM_ERROR_RATIO: f64 = 0.25;

/// Largest torque of what a law leaves, as a share of the law's.
const MAX_REST_RATIO: f64 = 0.15;

/// An effect with the search's own description of it.
pub struct Named {
    /// What the search found.
    pub spec: Spec,
    /// Its linear parameters.
    pub linear: Vec<Quantity>,
    /// As it stands in files.
    pub effect: Effect,
}

/// Merges parts into the effects that they belong to, the best score first. `friction` gives a joint's Coulomb friction \[Nm\], joints from 0.
pub fn together(effects: Vec<Named>, friction: impl Fn(usize) -> Option<f64>) -> Vec<Effect> {
    let (parts, mut whole): (Vec<Named>, Vec<Named>) =
        effects.into_iter().partition(|one| one.effect.in_model && part_of(&one.spec).is_some());
    for part in parts {
        let (Site::Pair { cause, .. }, Some(of)) = (part.spec.site, part_of(&part.spec)) else {
            whole.push(part);
            continue;
        };
        let belongs = |one: &&mut Named| {
            let own = one.effect.in_model && one.spec.family == of.family && one.spec.site == part.spec.site;
            own && friction(cause).is_some_and(|fc| is_share(&one.linear, &part.linear, fc))
        };
        match whole.iter_mut().find(belongs) {
            Some(one) => one.effect.parameters.0.extend(part.linear),
            None => whole.push(part),
        }
    }
    let is_rest: Vec<bool> = whole.iter().map(|one| whole.iter().any(|of| is_rest_of(one, of))).collect();
    let mut is_rest = is_rest.into_iter();
    let (rests, mut whole): (Vec<Named>, Vec<Named>) =
        whole.into_iter().partition(|_| is_rest.next().unwrap_or_default());
    for rest in rests {
        if let Some(one) = whole.iter_mut().find(|one| is_rest_of(&rest, one)) {
            one.effect.physics += &format!(" What this law leaves there is described by {}.", rest.spec.family);
            one.effect.parameters.0.extend(rest.effect.parameters.0);
        }
    }
    let mut effects: Vec<Effect> = whole.into_iter().map(|one| one.effect).collect();
    effects.sort_by(|a, b| b.evidence.unwrap_or(f64::NAN).total_cmp(&a.evidence.unwrap_or(f64::NAN)));
    effects
}

/// Whether an effect is what the law of another one leaves in their joint.
fn is_rest_of(one: &Named, of: &Named) -> bool {
    let approximate = |own: &Named| {
        let form = own.spec.form();
        form.is_some_and(Form::is_approximate) && own.effect.in_model
    };
    let small = one.effect.torque_rms.zip(of.effect.torque_rms).is_some_and(|(one, of)| one <= MAX_REST_RATIO * of);
    let other_law = one.spec.site == of.spec.site && one.spec.family != of.spec.family;
    small && other_law && approximate(one) && approximate(of)
}

/// The declaration of an effect's family that its form may be part of another effect.
fn part_of(spec: &Spec) -> Option<PartOf> {
    spec.family().ok()?.rare.part_of.filter(|part| part.form == spec.form)
}

/// Whether the first coefficient of `coupling` is the share in `crosstalk` of the Coulomb friction `fc` \[Nm\].
fn is_share(crosstalk: &[Quantity], coupling: &[Quantity], fc: f64) -> bool {
    let (Some(share), Some(found)) = (crosstalk.first(), coupling.first()) else { return false };
    let expected = share.value * fc;
    let std = share.std.unwrap_or(0.0) * fc.abs();
    let spread = std.hypot(found.std.unwrap_or(0.0));
    expected * found.value > 0.0
        && (found.value - expected).abs() <= MAX_DEVIATIONS * spread + FORM_ERROR_RATIO * expected.abs()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::Parameters;

    fn estimate(value: f64, std: f64) -> Vec<Quantity> {
        vec![Quantity { value, std: Some(std), ..Quantity::default() }]
    }

    #[test]
    fn what_a_law_of_friction_leaves_is_reported_with_it() {
        let named = |family, form, joint, settings: &[f64], torque_rms| {
            let spec = Spec { family, form, site: Site::Joint(joint), settings: settings.to_vec() };
            let parameters = Parameters(estimate(torque_rms, 0.0));
            let effect =
                Effect { torque_rms: Some(torque_rms), in_model: true, parameters, ..Effect::of(family, form) };
            Named { spec, linear: Vec::new(), effect }
        };
        let hysteresis = || named("presliding", "", 4, &[1e-3], 1.0);
        let count = |one: Named| {
            let effects = together(vec![one, hysteresis()], |_| None);
            (effects.len(), effects.iter().map(|effect| effect.parameters.0.len()).max().unwrap())
        };
        assert_eq!(count(named("stribeck", "gaussian", 4, &[0.03], 0.14)), (1, 2));
        // Too much, of another joint, of a law that is known, not in the model.
        assert_eq!(count(named("stribeck", "gaussian", 4, &[0.03], 0.16)), (2, 1));
        assert_eq!(count(named("stribeck", "gaussian", 3, &[0.03], 0.14)), (2, 1));
        assert_eq!(count(named("spring", "linear", 4, &[], 0.14)), (2, 1));
        let mut alone = named("stribeck", "gaussian", 4, &[0.03], 0.14);
        alone.effect.in_model = false;
        assert_eq!(count(alone), (2, 1));
    }

    #[test]
    fn a_coupling_is_a_part_where_it_is_the_share_of_the_friction() {
        let share = estimate(0.03, 0.0005);
        assert!(is_share(&share, &estimate(0.014, 0.001), 0.5));
        assert!(is_share(&estimate(-0.03, 0.0005), &estimate(-0.0155, 0.001), 0.5));
        // Four times as much, the other way, and nothing to compare with.
        assert!(!is_share(&share, &estimate(0.06, 0.001), 0.5));
        assert!(!is_share(&share, &estimate(-0.015, 0.001), 0.5));
        assert!(!is_share(&[], &estimate(0.015, 0.001), 0.5));
    }
}
