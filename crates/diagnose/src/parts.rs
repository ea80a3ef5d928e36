//! Effects that are parts of another one.
//!
//! A torque sensor with cross-talk measures a share of another joint's torque, friction included. The column of `torque-crosstalk` is the
//! rigid-body torque alone, so the search finds the rest as friction between the two joints. A family declares this ([`PartOf`]): where the
//! form's first coefficient is the other effect's share of the cause's own friction, both are reported as one effect.

use super::outcome::{Effect, Estimate};
use plumbline_model::term::effect::{PartOf, Site};

/// How many standard deviations a coefficient may be off the share.
const DEVIATIONS: f64 = 4.0;
/// And how much of itself: friction jumps in one of the two columns and passes smoothly through zero in the other.
const FORM: f64 = 0.25;

/// Puts the parts with what they belong to. `friction` gives a joint's Coulomb friction \[Nm\], joints from 0.
pub fn together(effects: Vec<Effect>, friction: impl Fn(usize) -> Option<f64>) -> Vec<Effect> {
    let (parts, mut whole): (Vec<Effect>, Vec<Effect>) =
        effects.into_iter().partition(|effect| effect.in_model && part_of(effect).is_some());
    for part in parts {
        let (Site::Pair { cause, .. }, Some(of)) = (part.spec.site, part_of(&part)) else {
            whole.push(part);
            continue;
        };
        let belongs = |effect: &&mut Effect| {
            let own = effect.in_model && effect.spec.family == of.family && effect.spec.site == part.spec.site;
            own && friction(cause).is_some_and(|fc| is_share(&effect.parameters, &part.parameters, fc))
        };
        match whole.iter_mut().find(belongs) {
            Some(effect) => effect.parameters.extend(part.parameters),
            None => whole.push(part),
        }
    }
    whole.sort_by(|a, b| b.score.total_cmp(&a.score));
    whole
}

/// The declaration of an effect's family that its form may be part of another effect.
fn part_of(effect: &Effect) -> Option<PartOf> {
    effect.spec.family().ok()?.rare.part_of.filter(|part| part.form == effect.spec.form)
}

/// Whether the first coefficient of `coupling` is the share in `crosstalk` of the Coulomb friction `fc` \[Nm\].
fn is_share(crosstalk: &[Estimate], coupling: &[Estimate], fc: f64) -> bool {
    let (Some(share), Some(found)) = (crosstalk.first(), coupling.first()) else { return false };
    let expected = share.value * fc;
    let std = share.std.unwrap_or(0.0) * fc.abs();
    let spread = std.hypot(found.std.unwrap_or(0.0));
    expected * found.value > 0.0 && (found.value - expected).abs() <= DEVIATIONS * spread + FORM * expected.abs()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(value: f64, std: f64) -> Vec<Estimate> {
        vec![Estimate { name: String::new(), value, std: Some(std), unit: "" }]
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
