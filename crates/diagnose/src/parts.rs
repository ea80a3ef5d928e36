//! Effects that are parts of another one.
//!
//! A law of friction or of a gear is an approximation, and the search finds what it leaves as a second one of the same joint: one of a small share of the
//! first is reported with it.

use super::outcome::Effect;
use plumbline_model::term::effect::{Form, Spec};

/// Largest torque of what a law leaves, as a share of the law's.
const MAX_REST_RATIO: f64 = 0.15;

/// An effect with the search's own description of it.
pub struct Named {
    /// What the search found.
    pub spec: Spec,
    /// As it stands in files.
    pub effect: Effect,
}

/// Effects with what their laws leave, the best score first.
pub fn together(effects: Vec<Named>) -> Vec<Effect> {
    let is_rest: Vec<bool> = effects.iter().map(|one| effects.iter().any(|of| is_rest_of(one, of))).collect();
    let mut is_rest = is_rest.into_iter();
    let (rests, mut whole): (Vec<Named>, Vec<Named>) =
        effects.into_iter().partition(|_| is_rest.next().unwrap_or_default());
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
    let law = |own: &Named| (own.spec.family, own.spec.form);
    let other_law = one.spec.site == of.spec.site && law(one) != law(of);
    small && other_law && approximate(one) && approximate(of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::outcome::{Parameters, Quantity};
    use plumbline_model::term::effect::Site;

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
            Named { spec, effect }
        };
        let hysteresis = || named("presliding", "", 4, &[1e-3], 1.0);
        let count = |one: Named| {
            let effects = together(vec![one, hysteresis()]);
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
}
