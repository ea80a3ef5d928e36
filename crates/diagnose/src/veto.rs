//! What unseen runs refuse: effects without which they are expected no less, and those that have gone by then.

use super::acting;
use super::evidence::{Evidence, Trial};
use super::found::Step;
use super::input::Input;
use super::select::{Search, Selected};
use super::span::Span;
use super::state::State;
use super::unseen::Unseen;

/// Removes every effect without which unseen runs are expected no less. Where they are the only unseen ones the delivery withholds it instead, and
/// the reason is said.
pub fn vetoed(search: &Search, mut selected: Selected, input: &Input, evidence: &Evidence) -> Selected {
    if input.veto.is_empty() || input.judge.is_empty() {
        return selected;
    }
    let mut item = 0;
    while item < selected.state.items.len() {
        let state = &selected.state;
        if !acting::any_in(state.items[item].span, input.veto) {
            // These runs say nothing about it.
            item += 1;
            continue;
        }
        let unseen = Unseen::of(evidence, input.structure, input.veto, state, search.operating_point);
        let rest = state.without(&search.problem, item);
        let surprise = |unseen: &Unseen, own: &State| unseen.update_of(&search.problem, own, &state.fit.phi).1;
        if surprise(&unseen, state) < surprise(&unseen.without(state.range(item)), &rest) {
            item += 1;
            continue;
        }
        let gone = state.items[item].clone();
        let unmodelled =
            (0..search.problem.evidence.joints()).map(|joint| rest.unmodelled(search.problem.evidence, joint));
        let score = selected.found[item].score;
        selected.path.push(Step { item: gone, added: false, score, unmodelled: unmodelled.sum() });
        selected.found.remove(item);
        selected.state = rest;
        item = 0;
    }
    selected
}

/// Ends with the identified runs what came within them and without which the unseen runs after it are predicted better: it has gone by then.
pub fn end_where_refuted(search: &Search, state: &mut State, evidence: &Evidence, input: &Input) {
    let end = Trial::end_of(input.identify);
    for item in 0..state.items.len() {
        let span = state.items[item].span;
        if span.is_all() || span.to.is_finite() || !acting::any_in(Span::since(end), input.deciding()) {
            continue;
        }
        let unseen = Unseen::of(evidence, input.structure, input.deciding(), state, search.operating_point);
        let mut without = state.fit.theta.clone();
        let range = state.range(item);
        without.rows_mut(range.start, range.len()).fill(0.0);
        if unseen.gain(&state.fit.phi, &without, &state.fit.theta) < 0.0 {
            state.items[item].span.to = end;
        }
    }
}
