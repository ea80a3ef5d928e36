//! Tilts of the base beyond the first order: of a tilt of 3 degrees that leaves 0.1 % of the gravity torque, which is noticed.

use super::super::library::Candidate;
use super::super::select::Search;
use super::super::state::State;
use plumbline_model::term::effect::Spec;
use plumbline_model::term::mounting;

/// How often the columns are taken at the tilt that they gave; each time the rest is smaller by the square of the tilt.
const ROUNDS: usize = 3;

/// The state whose tilts have their columns at the tilt itself, and the places that its effects had.
pub(super) fn exact(search: &Search, mut state: State) -> (State, Vec<usize>) {
    let mut places: Vec<usize> = (0..state.items.len()).collect();
    let is_tilt = |item: &usize| state.items[*item].spec.family == mounting::FAMILY.id;
    let tilts: Vec<usize> = places.iter().copied().filter(is_tilt).collect();
    for tilt in [&tilts[..]; ROUNDS].concat() {
        let item = places.iter().position(|place| *place == tilt).unwrap_or(tilt);
        let Some(candidate) = about_itself(search, &state, item) else { continue };
        state = state.without(&search.problem, item).with(&search.problem, candidate);
        places.remove(item);
        places.push(tilt);
    }
    (state, places)
}

fn about_itself(search: &Search, state: &State, item: usize) -> Option<Candidate> {
    let own = &state.items[item];
    let tilt = &state.fit.theta.as_slice()[state.range(item)];
    let (evidence, operating_point) = (search.problem.evidence, search.operating_point);
    let mut gravities = (0..evidence.experiments()).map(|experiment| evidence.motion(experiment).gravity);
    let lacks = gravities.any(|gravity| mounting::lacks_first_moments(operating_point, &gravity));
    let form = if lacks { mounting::WITH_FIRST_LINK } else { mounting::ABOUT_A_TILT };
    // Of the first link nothing is known before.
    let settings = tilt[..2].to_vec();
    Candidate::of(evidence, operating_point, Spec { form, settings, ..own.spec.clone() }, own.span)
}
