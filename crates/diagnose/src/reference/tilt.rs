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
    let settings = state.fit.theta.as_slice()[state.range(item)].to_vec();
    let spec = Spec { form: mounting::ABOUT_A_TILT, settings, ..own.spec.clone() };
    Candidate::of(search.problem.evidence, search.operating_point, spec, own.span)
}
