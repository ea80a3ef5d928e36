//! What unseen runs prove, and what they refuse: effects without which they are expected no less, and those that have gone by then. And what is no effect of
//! its own beside what has no name.

use super::acting;
use super::delivery::MIN_EXPLAINED_RATIO;
use super::evidence::{Evidence, Trial};
use super::fallback::Residual;
use super::found::Step;
use super::input::Input;
use super::library::Candidate;
use super::proposals::Scored;
use super::select::{STRONG_GAP, Search, Selected};
use super::span::Span;
use super::state::{State, mean_square};
use super::unseen::{Known, Unseen};
use plumbline_model::Structure;
use plumbline_model::term::effect::Site;

/// Score on unseen runs against an effect that refutes a clear one, as a share of its own.
const MIN_REFUTING_RATIO: f64 = 0.01;
/// Effects that are the first terms of any function of the positions: a constant, a line, a wave.
const FIRST_TERMS: [&str; 3] = ["torque-offset", "spring", "position-ripple"];
/// Largest RMS of such an effect, over that of what is left of such a function, at which it is a part of it: three terms of many take no more.
const MAX_FIRST_TERM_RATIO: f64 = 2.0;

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

/// Removes every effect without which unseen runs are expected no less; if it came within the identified ones or is
/// [clear](super::found::Found::is_clear) there, more by [`STRONG_GAP`] and [`MIN_REFUTING_RATIO`]: a motion that hardly shows it is expected as well without
/// it, or a little better. Where they are the only unseen ones the delivery withholds it instead, and the reason is said.
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
        let doubtful = state.items[item].span.is_all() && !selected.found[item].is_clear();
        let refuting = if doubtful { 0.0 } else { STRONG_GAP.max(MIN_REFUTING_RATIO * selected.found[item].score) };
        if surprise(&unseen, state) < surprise(&unseen.without(state.range(item)), &rest) + refuting {
            item += 1;
            continue;
        }
        remove(search, &mut selected, item, rest);
        item = 0;
    }
    selected
}

/// Removes the first terms of what has no name: effects of one joint of which what is left, at least half as much, depends on positions. `left` tells what is
/// left of each joint in which the model lacks something.
pub fn without_first_terms(
    search: &Search,
    mut selected: Selected,
    left: impl Fn(&State) -> Vec<Residual>,
) -> Selected {
    let joint = |item: &Candidate| match item.spec.site {
        Site::Joint(joint) if item.span.is_all() && FIRST_TERMS.contains(&item.spec.family) => Some(joint),
        _ => None,
    };
    if !search.evidence().repeats() || !selected.state.items.iter().any(|item| joint(item).is_some()) {
        return selected;
    }
    let left: Vec<Residual> =
        left(&selected.state).into_iter().filter(|one| one.counts() && one.follows_positions()).collect();
    for item in (0..selected.state.items.len()).rev() {
        let own = joint(&selected.state.items[item]);
        let is_part = |one: &Residual| {
            Some(one.joint) == own
                && selected.found[item].relevance.rms[one.joint] < MAX_FIRST_TERM_RATIO * one.unmodelled
        };
        if left.iter().any(is_part) {
            let rest = selected.state.without(&search.problem, item);
            remove(search, &mut selected, item, rest);
        }
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
    use crate::Settings;
    use crate::fallback::{self, Variable};
    use crate::found::Found;
    use crate::gates::{FoldTest, Relevance};
    use crate::synthetic::{At, recorded};
    use plumbline_identify::solve::Options;
    use plumbline_model::term::effect::Spec;
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

    /// An offset in joint 2, and what the search found of it.
    fn offset(search: &Search, base: &State, score: f64, rms: f64) -> Selected {
        let spec = Spec { family: "torque-offset", form: "", site: Site::Joint(1), settings: vec![] };
        let item = Candidate::of(search.evidence(), search.operating_point, spec, Span::ALL).unwrap();
        let (folds, relevance) = (FoldTest::default(), Relevance { rms: vec![0.0, rms], ..Relevance::default() });
        let found = Found { score, evidence: 0.0, penalty: 20.0, folds, relevance, independence: 1.0, rivals: vec![] };
        let state = base.with(&search.problem, item);
        Selected { state, found: vec![found], path: vec![], first: vec![] }
    }

    #[test]
    fn what_is_clear_is_refuted_by_more_than_a_motion_that_hardly_shows_it() {
        let identify = recorded(4, 105, |_| [0.0, 0.3]);
        // As much of it in the unseen runs as leaves a score of so much against it.
        let unseen = |share: f64| recorded(2, 106, move |_| [0.0, 0.3 * share]);
        let identified = identify.trials();
        identify.search(&[&torque_offset::FAMILY], &Settings::default(), |search, base| {
            let selected = |score: f64| offset(search, base, score, 0.3);
            let noise_of = |recorded: &[Trial]| {
                Evidence::with_noise_of(identify.structure.chain(), recorded, &identified, search.settings.band)
            };
            let against = |share: f64| {
                let (recorded, Selected { state, .. }) = (unseen(share), selected(0.0));
                let veto = recorded.trials();
                let evidence = noise_of(&veto);
                let with = Unseen::of(&evidence, &identify.structure, &veto, &state, search.operating_point);
                let surprise = |unseen: &Unseen, own: &State| unseen.update_of(&search.problem, own, &state.fit.phi).1;
                surprise(&with, &state) - surprise(&with.without(state.range(0)), &state.without(&search.problem, 0))
            };
            let share_of = |score: f64| {
                let (mut less, mut more) = (0.0, 1.0);
                assert!(against(less) > score && against(more) < score);
                for _ in 0..30 {
                    let middle = 0.5 * (less + more);
                    if against(middle) > score { less = middle } else { more = middle }
                }
                more
            };
            for (score, against, stays) in [
                (19.0, 1.0, false),
                (21.0, 1.0, true),
                (21.0, 5.0, true),
                (21.0, 7.0, false),
                (1000.0, 9.0, true),
                (1000.0, 11.0, false),
            ] {
                let recorded = unseen(share_of(against));
                let (veto, judge) = (recorded.trials(), &identified[..1]);
                let evidence = noise_of(&veto);
                let (structure, options) = (&identify.structure, &Options::default());
                let input = Input { structure, identify: &identified, veto: &veto, judge, options, came: &[] };
                let left = vetoed(search, selected(score), &input, &evidence);
                assert_eq!(left.found.len(), usize::from(stays), "score {score}, {against} against it");
                assert_eq!((left.state.items.len(), left.path.len()), (left.found.len(), 1 - left.found.len()));
            }
        });
    }

    #[test]
    fn an_offset_is_a_part_of_what_is_left_over_positions() {
        let bend = |at: &At| [0.0, 0.3 + 0.5 * (4.0 * at.q[0]).sin() * (4.0 * at.q[1]).sin()];
        recorded(4, 107, bend).search(&[&torque_offset::FAMILY], &Settings::default(), |search, base| {
            let unexplained = |state: &State| fallback::unexplained(search.evidence(), state, 1, search.settings);
            let left = unexplained(&offset(search, base, 0.0, 0.0).state);
            assert!(left.counts() && left.follows_positions(), "{:?}", left.depends_on);
            let speed = Residual { depends_on: vec![Variable::Position(0), Variable::Velocity(1)], ..left.clone() };
            let elsewhere = Residual { joint: 0, ..left.clone() };
            let rms = left.unmodelled;
            for (left, ratio, stays) in
                [(&left, 1.9, false), (&left, 2.1, true), (&speed, 1.9, true), (&elsewhere, 1.9, true)]
            {
                let selected = offset(search, base, 100.0, ratio * rms);
                let selected = without_first_terms(search, selected, |_| vec![left.clone()]);
                assert_eq!(selected.state.items.len(), usize::from(stays), "{ratio} {:?}", left.depends_on);
                assert_eq!(selected.path.len(), usize::from(!stays));
            }
        });
    }
}
