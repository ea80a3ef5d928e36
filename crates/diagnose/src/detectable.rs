//! How small an effect could be and still be found, so that "nothing" is a number.

use super::fit::least_independence;
use super::library::Candidate;
use super::outcome::{self, MinimumDetectable, NotIdentifiable};
use super::select::Search;
use super::state::{State, mean_square};
use std::collections::BTreeMap;

/// An effect is found with high probability when what re-identification leaves of it is this share of the noise of the mean period.
const FOUND_FLOOR_RATIO: f64 = 0.75;

/// Every effect of the library once: its most independent candidate among the first, middle and last start value, and its independence (the
/// share of its square that the other columns cannot represent).
pub fn independences<'a>(search: &Search<'a>, base: &State) -> Vec<(&'a Candidate, f64)> {
    let library = search.library;
    let mut seen: Vec<&Candidate> = Vec::new();
    for item in library.iter().filter(|item| item.span.is_all()) {
        if !seen.iter().any(|one| one.same_effect(item)) {
            seen.push(item);
        }
    }
    let best = |item: &Candidate| {
        let variants: Vec<&'a Candidate> = library.iter().filter(|one| one.alike(item)).collect();
        let some = [0, variants.len() / 2, variants.len() - 1].map(|k| variants[k]);
        let independences = some.into_iter().filter_map(|one| {
            let cross = base.cross(search.problem.evidence, &one.rows);
            Some((one, search.problem.own_share(&base.fit, &cross)?))
        });
        independences.max_by(|a, b| a.1.total_cmp(&b.1))
    };
    seen.into_iter().filter_map(best).collect()
}

/// The least of every family that would have been found, joint by joint.
///
/// With independence `idf`, an effect of torque RMS `t` leaves
/// `t sqrt(idf)`, so the least that is found is `0.75 floor / sqrt(idf)`; the parameter is that over the column's RMS.
pub fn minimum(search: &Search, independences: &[(&Candidate, f64)]) -> BTreeMap<String, MinimumDetectable> {
    let evidence = search.problem.evidence;
    let mut found: BTreeMap<String, MinimumDetectable> = BTreeMap::new();
    for &(best, independence) in independences {
        if independence < least_independence(best.rows.exact) {
            continue;
        }
        let rms = |joint: usize| {
            let part = best.rows.of(joint);
            part.map_or(0.0, |part| mean_square(evidence, joint, &part.column(0).into_owned()).sqrt())
        };
        // The joint where it shows best against the noise.
        let against = |joint: usize| rms(joint) / evidence.floor(joint).unwrap_or(1.0);
        let Some(joint) = best.joints().into_iter().max_by(|&a, &b| against(a).total_cmp(&against(b))) else {
            continue;
        };
        let Some(floor) = evidence.floor(joint) else { continue };
        let torque = FOUND_FLOOR_RATIO * floor / independence.sqrt();
        let site = best.spec.site.joints().first().copied().unwrap_or(joint);
        let parameter = torque / rms(joint).max(f64::MIN_POSITIVE);
        let unit = best
            .spec
            .build(search.operating_point)
            .ok()
            .and_then(|term| term.columns().first().map(|column| column.unit));
        let unknown = || vec![f64::NAN; evidence.joints()];
        let own = found.entry(best.spec.family.into()).or_insert_with(|| MinimumDetectable {
            torque_rms: unknown(),
            parameter: unknown(),
            unit: unit.unwrap_or_default().into(),
            ..MinimumDetectable::default()
        });
        // Of several sites in one joint the one that shows best.
        if own.torque_rms[site].is_nan() || torque < own.torque_rms[site] {
            (own.torque_rms[site], own.parameter[site]) = (torque, parameter);
        }
    }
    found
}

/// Effects that the base parameters represent: no data in these mountings shows them.
pub fn not_identifiable(independences: &[(&Candidate, f64)]) -> Vec<NotIdentifiable> {
    let absorbed = |&(best, independence): &(&Candidate, f64)| {
        (independence < least_independence(best.rows.exact)).then(|| NotIdentifiable {
            effect: best.spec.family.into(),
            joints: outcome::joints(best.spec.site),
            why: format!(
                "the base parameters take over all but {independence:.1e} of it; the torques in these mountings do not change"
            ),
        })
    };
    independences.iter().filter_map(absorbed).collect()
}
