//! How small an effect could be and still be found, so that "nothing" is a number.

use super::fit::LEAST;
use super::outcome::{Detectable, Hidden};
use super::select::Search;
use super::state::{State, every, mean_square};

/// An effect is found with high probability when what re-identification leaves of it is this share of the noise of the mean period.
const FOUND: f64 = 0.75;

/// Of every family, site by site; and what the base parameters take over.
///
/// With independence `idf` (the share of a column's square that the other columns can't take over), an effect of torque RMS `t` leaves
/// `t sqrt(idf)`, so the least that is found is `0.75 floor / sqrt(idf)`; the parameter is that over the column's RMS.
pub fn of(search: &Search, base: &State) -> (Vec<Detectable>, Vec<Hidden>) {
    let evidence = search.problem.evidence;
    let mut detectable: Vec<Detectable> = Vec::new();
    let mut hidden: Vec<Hidden> = Vec::new();
    let mut seen: Vec<&super::library::Candidate> = Vec::new();
    for item in search.library {
        if seen.iter().any(|one| one.same_effect(item)) {
            continue;
        }
        seen.push(item);
        // The first, the middle and the last start value stand for all.
        let variants: Vec<_> = search.library.iter().filter(|one| one.alike(item)).collect();
        let some = [0, variants.len() / 2, variants.len() - 1].map(|k| variants[k]);
        let independences = some.into_iter().filter_map(|one| {
            let cross = base.columns.cross(evidence, &one.rows);
            let independence = search.problem.own_share(&base.fit, &cross, &every)?;
            Some((one, independence))
        });
        let Some((best, independence)) = independences.max_by(|a, b| a.1.total_cmp(&b.1)) else { continue };
        if independence < LEAST {
            hidden.push(Hidden { spec: item.spec.clone(), independence });
            continue;
        }
        let rms = |joint: usize| {
            let part = best.rows.parts.iter().find(|(own, _)| *own == joint);
            part.map_or(0.0, |(_, part)| mean_square(evidence, joint, &part.column(0).into_owned()).sqrt())
        };
        // The joint where it shows best against the noise.
        let against = |joint: usize| rms(joint) / evidence.floor(joint).unwrap_or(1.0);
        let Some(joint) = best.joints().into_iter().max_by(|&a, &b| against(a).total_cmp(&against(b))) else {
            continue;
        };
        let Some(floor) = evidence.floor(joint) else { continue };
        let torque = FOUND * floor / independence.sqrt();
        let site = item.spec.site.joints().first().copied().unwrap_or(joint);
        let parameter = torque / rms(joint).max(f64::MIN_POSITIVE);
        let unit =
            best.spec.build(search.ground).ok().and_then(|term| term.columns().first().map(|column| column.unit));
        match detectable.iter_mut().find(|one| one.family == item.spec.family) {
            Some(one) => one.sites.push((site, torque, parameter)),
            None => detectable.push(Detectable {
                family: item.spec.family,
                sites: vec![(site, torque, parameter)],
                unit: unit.unwrap_or_default(),
            }),
        }
    }
    (detectable, hidden)
}
