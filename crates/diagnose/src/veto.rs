//! What unseen runs prove, and what they refuse: effects without which they are expected no less, and those that have gone by then.

use super::acting;
use super::delivery::MIN_EXPLAINED_RATIO;
use super::evidence::{Evidence, Trial};
use super::found::Step;
use super::input::Input;
use super::proposals::Scored;
use super::select::{STRONG_GAP, Search, Selected};
use super::span::Span;
use super::state::{State, mean_square};
use super::unseen::{Known, Unseen};
use plumbline_model::Structure;

/// Runs that a model is not fitted to.
#[derive(Clone, Copy)]
pub struct Deciding<'a> {
    /// The runs, with the noise of the identified ones.
    pub evidence: &'a Evidence,
    /// Columns of the plain model.
    pub structure: &'a Structure,
    /// The runs.
    pub trials: &'a [Trial<'a>],
}

impl<'a> Deciding<'a> {
    /// A state on these runs.
    pub fn unseen(&self, search: &Search, state: &State) -> Unseen<'a> {
        Unseen::of(self.evidence, self.structure, self.trials, state, search.operating_point)
    }

    /// Whether these runs prove a candidate: minus twice the log of the density that the identified runs predict for them falls by as much as its parameters and
    /// its choice cost, and the mean square of what they predict in one joint falls by half of what is above the noise, and by no less than an effect has to
    /// have. `unseen` is the state without it.
    pub fn prove(&self, search: &Search, unseen: &Unseen, state: &State, one: &Scored) -> bool {
        if !acting::any_in(one.item.span, self.trials) {
            return false;
        }
        let Ok(term) = one.item.spec.build(search.operating_point) else { return false };
        let with = unseen.with(&self.evidence.columns(&*term, one.item.span));
        let (before, after, phi) = (&state.fit.theta, &one.tried.fit.theta, &one.tried.fit.phi);
        let information = search.problem.information(&one.tried.moments(search.evidence(), state), phi);
        let expected = with.update(Known { theta: after, information: &information, phi }).1;
        if unseen.update_of(&search.problem, state, phi).1 - expected < one.penalty {
            return false;
        }
        let settings = search.settings;
        let taken = |joint: usize| {
            let [without, with] = [unseen.residual(joint, before), with.residual(joint, after)]
                .map(|rest| mean_square(self.evidence, joint, &rest));
            self.evidence.floor(joint).is_some_and(|floor| {
                let least = settings.threshold.unwrap_or(settings.least_floor * floor).powi(2);
                without - with > least.max(MIN_EXPLAINED_RATIO * (without - floor * floor))
            })
        };
        (0..self.evidence.joints()).any(taken)
    }
}

/// Removes every effect without which unseen runs are expected no less, or more by [`STRONG_GAP`] if it came within the identified ones. Where they are the
/// only unseen ones the delivery withholds it instead, and the reason is said.
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
        // The base parameters of the model without what came are those of the time since then: these runs may not tell one from the other.
        let refuting = if state.items[item].span.is_all() { 0.0 } else { STRONG_GAP };
        if surprise(&unseen, state) < surprise(&unseen.without(state.range(item)), &rest) + refuting {
            item += 1;
            continue;
        }
        remove(search, &mut selected, item, rest);
        item = 0;
    }
    selected
}

/// Ends with the identified runs what came within them and without which the unseen runs after it are predicted better: it has gone by then. What does not pay
/// for its end, one number more, is removed.
pub fn end_where_refuted(search: &Search, selected: &mut Selected, evidence: &Evidence, input: &Input) {
    let end = Trial::end_of(input.identify);
    let cost = (search.problem.evidence.per_joint() as f64).ln();
    for item in (0..selected.state.items.len()).rev() {
        let state = &selected.state;
        let span = state.items[item].span;
        if span.is_all() || span.to.is_finite() || !acting::any_in(Span::since(end), input.deciding()) {
            continue;
        }
        let unseen = Unseen::of(evidence, input.structure, input.deciding(), state, search.operating_point);
        let mut without = state.fit.theta.clone();
        let range = state.range(item);
        without.rows_mut(range.start, range.len()).fill(0.0);
        if unseen.gain(&state.fit.phi, &without, &state.fit.theta) >= 0.0 {
            continue;
        }
        if selected.found[item].score > cost {
            selected.state.items[item].span.to = end;
        } else {
            let rest = selected.state.without(&search.problem, item);
            remove(search, selected, item, rest);
        }
    }
}

/// Removes an effect, `rest` is the state without it.
fn remove(search: &Search, selected: &mut Selected, item: usize, rest: State) {
    let evidence = search.problem.evidence;
    let unmodelled = (0..evidence.joints()).map(|joint| rest.unmodelled(evidence, joint)).sum();
    let gone = selected.state.items[item].clone();
    selected.path.push(Step { item: gone, added: false, score: selected.found[item].score, unmodelled });
    selected.found.remove(item);
    selected.state = rest;
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::found::Found;
    use crate::gates::{FoldTest, Relevance};
    use crate::synthetic::{At, recorded};
    use crate::{Candidate, Settings};
    use plumbline_identify::solve::Options;
    use plumbline_model::term::effect::{Site, Spec};
    use plumbline_model::term::torque_offset;

    #[test]
    fn what_has_gone_pays_for_its_end_or_is_none() {
        let came = |at: &At| [0.0, if at.trajectory >= 2 { 1.0 } else { 0.0 }];
        let (identify, there, gone) =
            (recorded(4, 103, came), recorded(2, 104, |_| [0.0, 1.0]), recorded(2, 104, |_| [0.0; 2]));
        let identified = identify.trials();
        identify.search(&[&torque_offset::FAMILY], &Settings::default(), |search, base| {
            let evidence = search.problem.evidence;
            let spec = Spec { family: "torque-offset", form: "", site: Site::Joint(1), settings: vec![] };
            let span = Span::since(identified[2].start);
            let item = Candidate::of(evidence, search.operating_point, spec, span).unwrap();
            let cost = (evidence.per_joint() as f64).ln();
            for (unseen, score, ends) in [
                (&there, 0.1, Some(f64::INFINITY)),
                (&gone, 1.01 * cost, Some(Trial::end_of(&identified))),
                (&gone, 0.99 * cost, None),
            ] {
                let mut veto = unseen.trials();
                veto.iter_mut().for_each(|trial| trial.start += Trial::end_of(&identified));
                let input = Input {
                    structure: &identify.structure,
                    identify: &identified,
                    veto: &veto,
                    judge: &[],
                    options: &Options::default(),
                    came: &[],
                };
                let (folds, relevance) = (FoldTest::default(), Relevance::default());
                let found =
                    Found { score, evidence: 0.0, penalty: 0.0, folds, relevance, independence: 1.0, rivals: vec![] };
                let state = base.with(&search.problem, item.clone());
                let mut selected = Selected { state, found: vec![found], path: vec![], first: vec![] };
                let unseen =
                    Evidence::with_noise_of(identify.structure.chain(), &veto, &identified, search.settings.band);
                end_where_refuted(search, &mut selected, &unseen, &input);
                assert_eq!(selected.state.items.first().map(|item| item.span.to), ends);
                assert_eq!(
                    (selected.found.len(), selected.path.len()),
                    (selected.state.items.len(), 1 - selected.found.len())
                );
                assert!(selected.path.iter().all(|step| !step.added));
            }
        });
    }
}
