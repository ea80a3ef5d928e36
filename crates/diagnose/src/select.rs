//! Forward selection of effects with re-identification at every step, and backward elimination.

use super::deviations::slopes;
use super::evidence::Evidence;
use super::fit::Problem;
use super::found::{Found, Progress, Rival, Step, Watch};
use super::gates;
use super::input::Settings;
use super::library::Candidate;
use super::proposals::Scored;
use super::span::Span;
use super::state::State;
use super::unseen::Unseen;
use super::veto::Deciding;
use plumbline_model::term::effect::{Family, OperatingPoint, Place, Site, Spec};
use std::cell::OnceCell;

/// Candidates above this share of the best score are tied, where the noise is unknown.
pub(super) const TIE_RATIO: f64 = 0.8;
/// A difference in score from which on the evidence is strong (Kass and Raftery, Journal of the American Statistical Association 90, 1995). A form that is
/// better by no more is not preferred to one of the same effect with fewer settings, for outside of the recorded range they may differ much; nor is an effect
/// that few arms have to one of the same joint that every arm has.
pub(super) const STRONG_GAP: f64 = 6.0;
/// Least score of a [defect](Candidate::is_defect) that need not matter, as a share of its penalty: none of 40 clean arms has one.
const MIN_DEFECT_RATIO: f64 = 0.5;
/// Least share of a joint's mean square on blocks left out that a change of its friction or encoder takes, where the noise is unknown.
const MIN_CHANGE_SHARE: f64 = 0.5;
/// Candidates that an outcome lists.
pub(super) const MAX_LISTED_SCORES: usize = 10;
/// Largest score difference of a rival that the data cannot separate from the chosen effect.
pub const MAX_RIVAL_SCORE_GAP: f64 = 12.0;

/// A search: the data, the operating point of the columns, and every candidate.
pub struct Search<'a> {
    /// Evidence and prior.
    pub problem: Problem<'a>,
    /// Parameters that candidates' columns are evaluated at.
    pub operating_point: &'a OperatingPoint,
    /// Every candidate.
    pub library: &'a [Candidate],
    /// How it is done.
    pub settings: &'a Settings,
    /// Runs that the model is not fitted to and that decide, where there are any and the noise is known.
    pub deciding: Option<Deciding<'a>>,
    /// What the deviations of the periods show, and the parts of the recording in which it acts.
    pub came: &'a [(Spec, Span)],
}

/// A state in which candidates are judged.
struct At<'s, 'a> {
    state: &'s State,
    unseen: OnceCell<Unseen<'a>>,
}

impl<'s> At<'s, '_> {
    fn of(state: &'s State) -> Self {
        At { state, unseen: OnceCell::new() }
    }
}

/// How the gates judge a candidate.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Gate {
    Passes,
    /// It would, if it mattered.
    TooSmall,
    Fails,
}

/// What the forward selection came to.
pub struct Draft {
    /// The model.
    pub state: State,
    path: Vec<Step>,
    first: Vec<Scored>,
    refined: Vec<Candidate>,
}

/// What the selection ended with.
pub struct Selected {
    /// The model.
    pub state: State,
    /// Facts on each of its items.
    pub found: Vec<Found>,
    /// How it came about.
    pub path: Vec<Step>,
    /// The best candidates at the first step, each added alone to the model.
    pub first: Vec<Scored>,
}

impl<'a> Search<'a> {
    /// The same search at another operating point. Columns of the library are re-evaluated only for shortlisted candidates.
    pub fn at<'b>(&self, operating_point: &'b OperatingPoint) -> Search<'b>
    where
        'a: 'b,
    {
        let Problem { evidence, prior } = self.problem;
        Search { problem: Problem { evidence, prior }, operating_point, ..*self }
    }

    /// The rows.
    pub(super) fn evidence(&self) -> &Evidence {
        self.problem.evidence
    }

    /// [`Search::forward`] and [`Search::finish`].
    pub fn select(&self, base: State, seeds: &[Candidate], progress: &Watch) -> Selected {
        self.finish(self.forward(base, seeds, progress), progress)
    }

    /// Forward selection: adds the best effect that passes the gates and fits everything again. It starts from `seeds` that pay for themselves.
    pub fn forward(&self, base: State, seeds: &[Candidate], progress: &Watch) -> Draft {
        let mut state = base;
        let mut path: Vec<Step> = Vec::new();
        let mut tabu: Vec<Candidate> = Vec::new();
        let (mut first, mut refined) = (Vec::new(), Vec::new());
        for seed in seeds {
            state = state.with(&self.problem, seed.clone());
        }
        while let Some((worst, _)) = self.weakest(&state) {
            state = state.without(&self.problem, worst);
        }
        for item in state.items.clone() {
            self.record(&mut path, &state, item, true, 0.0, progress);
        }
        for step in 0..self.settings.steps {
            let wanted = |item: &Candidate| !tabu.iter().any(|one| one.alike(item));
            let proposals = self.proposed(&state, wanted, &mut refined, progress);
            if step == 0 {
                first.clone_from(&proposals);
            }
            let Some(chosen) = self.choose(&state, proposals) else { break };
            let begun = self.begun(&state, chosen.item);
            state = self.settle(&state.with(&self.problem, begun.clone()));
            self.record(&mut path, &state, begun, true, chosen.score, progress);
            while let Some(([whole, part], other)) = self.in_the_rest(&state) {
                for gone in [whole, part] {
                    let item = state.items[gone].clone();
                    state = state.without(&self.problem, gone);
                    self.record(&mut path, &state, item, false, 0.0, progress);
                }
                state = state.with(&self.problem, other.item.clone());
                self.record(&mut path, &state, other.item, true, other.score, progress);
            }
            while let Some((worst, score)) = self.weakest(&state) {
                let gone = state.items[worst].clone();
                state = state.without(&self.problem, worst);
                self.record(&mut path, &state, gone.clone(), false, score, progress);
                tabu.push(gone);
            }
        }
        Draft { state, path, first, refined }
    }

    /// Compares every effect of a draft with its rivals.
    pub fn finish(&self, draft: Draft, progress: &Watch) -> Selected {
        let Draft { state, mut path, first, refined } = draft;
        let (state, found) = self.judge(state, &mut path, refined, progress);
        Selected { state, found, path, first }
    }

    /// Re-evaluates columns that depend on parameters at this search's operating point, and refines the settings of the effects that they belong to.
    /// `None` when no column depends on it.
    pub fn relinearised(&self, state: &State) -> Option<State> {
        let rebuilt: Vec<Candidate> = state.items.iter().map(|item| self.rebuilt(item)).collect();
        let changed: Vec<bool> = rebuilt.iter().zip(&state.items).map(|(new, old)| new.rows != old.rows).collect();
        if !changed.contains(&true) {
            return None;
        }
        let mut now = state.clone();
        for (item, changed) in rebuilt.into_iter().zip(changed) {
            // The first is removed and appended: after one round the order is the same.
            let rest = now.without(&self.problem, 0);
            now = rest.with(&self.problem, if changed { self.refined(&rest, item) } else { item });
        }
        Some(now)
    }

    fn record(&self, path: &mut Vec<Step>, state: &State, item: Candidate, added: bool, score: f64, progress: &Watch) {
        let unmodelled = (0..self.evidence().joints()).map(|joint| state.unmodelled(self.evidence(), joint)).sum();
        let step = Step { item, added, score, unmodelled };
        progress(Progress::Step(&step));
        path.push(step);
    }

    /// Whether a candidate passes every gate.
    fn passes(&self, at: &At<'_, 'a>, one: &Scored) -> bool {
        self.gate(at, one) == Gate::Passes
    }

    /// How the gates judge a candidate. An effect of [most joints](State::has_in_most_joints) has to show alone, as has one that another joint has
    /// where its evidence is [twice its cost](Scored::is_clear). A [defect](Candidate::is_defect) has to where nobody says what matters. What the identified
    /// runs hardly show, the unseen ones may [prove](Deciding::prove).
    fn gate(&self, at: &At<'_, 'a>, one: &Scored) -> Gate {
        if one.score <= 0.0 || !gates::shows(self.evidence(), &one.item) {
            return Gate::Fails;
        }
        let state = at.state;
        let repeats = self.evidence().repeats();
        let relevance = gates::relevance(self.evidence(), state, &one.tried, &one.item);
        let of_most = state.has_in_most_joints(&one.item);
        let of_another = repeats && state.has_in_another_joint(&one.item) && one.is_clear();
        let settings = self.settings;
        let any_counts = repeats && settings.threshold.is_none() && settings.usual.is_empty();
        let is_defect = any_counts && one.item.is_defect() && one.score > MIN_DEFECT_RATIO * one.penalty;
        let matters = of_most || of_another || is_defect || gates::matters(self.evidence(), &relevance, settings);
        let folds = gates::folds(&self.problem, state, &one.tried);
        // What is in another joint as well is the more likely in this one.
        let by_weight = || !repeats && state.has_in_another_joint(&one.item) && folds.confirm_by_weight();
        if folds.confirm() == Some(false) && !by_weight() {
            return Gate::Fails;
        }
        let prove = |deciding: Deciding<'a>| {
            deciding.prove(self, at.unseen.get_or_init(|| deciding.unseen(self, state)), state, one)
        };
        if !matters && !self.deciding.is_some_and(prove) {
            return Gate::TooSmall;
        }
        if repeats {
            return Gate::Passes;
        }
        let blocks = self.evidence().folds().len();
        let least_share = if of_most { 0.0 } else { self.least_share_left_out(&one.item) };
        let hold = |penalty: f64| folds.hold(blocks, penalty, least_share);
        // The dispersion is 1 or more, and expensive.
        let holds = hold(one.penalty) && hold(one.penalty * self.dispersion(state, one));
        if holds { Gate::Passes } else { Gate::Fails }
    }

    /// [`gates::dispersion`] of what acts in a part of the recording; 1 for all else.
    fn dispersion(&self, state: &State, one: &Scored) -> f64 {
        if one.item.span.is_all() {
            return 1.0;
        }
        let everywhere = Candidate::sketch(self.evidence(), self.operating_point, one.item.spec.clone(), Span::ALL);
        everywhere
            .map_or(1.0, |everywhere| gates::dispersion(&self.problem, state, &one.tried, &one.item, &everywhere.rows))
    }

    /// Share of a joint's mean square on blocks left out that a candidate has to take where the noise is unknown.
    fn least_share_left_out(&self, item: &Candidate) -> f64 {
        // A change of one joint's friction or encoder at some time fits much that has no name.
        let of_one_joint = |family: &Family| family.place != Place::Arm && !family.rare.in_every_arm;
        let fits_much = !item.span.is_all() && item.spec.family().is_ok_and(of_one_joint);
        let usual = self.settings.least_share_left_out;
        if fits_much { usual.max(MIN_CHANGE_SHARE) } else { usual }
    }

    /// Of candidates that pass, the best; of those that are nearly as good the simplest, where the score is no exact measure. What a better one explains that is
    /// too small is not larger by a worse law of the same joint.
    fn choose(&self, state: &State, proposals: Vec<Scored>) -> Option<Scored> {
        let at = &At::of(state);
        let mut small: Vec<Scored> = Vec::new();
        let mut proposals = proposals.into_iter();
        let best = proposals.find(|one| {
            let gate = self.gate(at, one);
            if gate == Gate::TooSmall {
                small.push(one.clone());
            }
            gate == Gate::Passes && !small.iter().any(|better| self.explains(state, better, one))
        })?;
        if self.evidence().repeats() {
            let likelier = |item: &Candidate| item.is_likelier(&best.item) && item.meets(&best.item);
            let near = |one: &Scored| one.score >= best.score - STRONG_GAP && likelier(&one.item);
            let near: Vec<Scored> = proposals.filter(|one| near(one) && self.passes(at, one)).collect();
            return [best]
                .into_iter()
                .chain(near)
                .min_by_key(|one| (one.item.spec.settings.len(), !one.item.is_usual()));
        }
        let least = TIE_RATIO * best.score;
        let near = proposals.take_while(|one| one.score >= least).filter(|one| self.passes(at, one));
        Some(near.fold(best, |best, one| if one.cost() < best.cost() { one } else { best }))
    }

    /// Whether a better candidate of the same joint leaves less than half for another one.
    fn explains(&self, state: &State, better: &Scored, other: &Scored) -> bool {
        let of_one_joint =
            matches!(other.item.spec.site, Site::Joint(_)) && other.item.spec.site == better.item.spec.site;
        of_one_joint && !self.has_half_left(&state.with(&self.problem, better.item.clone()), other)
    }

    /// Whether a candidate that was scored elsewhere is worth more than half of that in a state.
    fn has_half_left(&self, state: &State, one: &Scored) -> bool {
        self.score(state, &one.item).is_some_and(|own| 2.0 * own.score > one.score)
    }

    /// Settings of every effect searched again, beside all others.
    fn settle(&self, state: &State) -> State {
        let mut state = state.clone();
        for item in 0..state.items.len() {
            if state.items[item].spec.settings.is_empty() {
                continue;
            }
            let rest = state.without(&self.problem, item);
            let better = self.refined(&rest, self.rebuilt(&state.items[item]));
            let moved = rest.with(&self.problem, better);
            if moved.fit.likelihood > state.fit.likelihood {
                // Appended as the last effect; its former neighbour is skipped in this pass.
                state = moved;
            }
        }
        state
    }

    /// What acts everywhere and its opposite in a part of the recording are one effect in the rest of it: both, the last first, and the effect that explains
    /// as much with less.
    fn in_the_rest(&self, state: &State) -> Option<([usize; 2], Scored)> {
        let items = &state.items;
        let pairs = (0..items.len()).flat_map(|whole| (0..items.len()).map(move |part| [whole, part]));
        let same = |&[whole, part]: &[usize; 2]| {
            items[whole].span.is_all() && !items[part].span.is_all() && items[part].spec == items[whole].spec
        };
        let of_pair = |[whole, part]: [usize; 2]| {
            let both = [whole.max(part), whole.min(part)];
            let rest = both.iter().fold(state.clone(), |rest, &item| rest.without(&self.problem, item));
            let penalties: f64 = both.iter().map(|&item| self.penalty(&items[item])).sum();
            let value = 2.0 * (state.fit.likelihood - rest.fit.likelihood) - penalties;
            let others = self.library.iter().filter(|other| {
                !other.span.is_all() && other.spec == items[part].spec && other.span != items[part].span
            });
            let scored = others.filter_map(|other| self.score(&rest, &self.rebuilt(other)));
            let best = scored.max_by(|a, b| a.score.total_cmp(&b.score))?;
            (best.score > value.max(0.0)).then_some((both, best))
        };
        pairs.filter(same).find_map(of_pair)
    }

    /// The effect that no longer pays for itself, if any.
    fn weakest(&self, state: &State) -> Option<(usize, f64)> {
        let score = |item: usize| {
            let rest = state.fit_without(&self.problem, item);
            2.0 * (state.fit.likelihood - rest.likelihood) - self.penalty(&state.items[item])
        };
        let scores = (0..state.items.len()).map(|item| (item, score(item)));
        scores.filter(|(_, score)| *score <= 0.0).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Replaces each effect by every other candidate in turn: a better one is kept, those with a near score are its rivals.
    fn judge(
        &self,
        mut state: State,
        path: &mut Vec<Step>,
        mut refined: Vec<Candidate>,
        progress: &Watch,
    ) -> (State, Vec<Found>) {
        let mut swaps = state.items.len();
        let mut found = Vec::new();
        let mut item = 0;
        while item < state.items.len() {
            let rest = state.without(&self.problem, item);
            let at = At::of(&rest);
            let chosen = state.items[item].clone();
            // Beside the others it may not be identifiable any more, or nothing worth: something else may be.
            let own = self.score(&rest, &chosen).filter(|own| own.score > 0.0);
            let other = |item: &Candidate| own.is_none() || !item.alike(&chosen);
            let mut others = self.proposed(&rest, other, &mut refined, progress);
            // In another joint it is another explanation where it is worth little beside the chosen one: a gain of one joint is one of all others, and
            // cross-talk in the joint before it.
            others
                .retain(|other| other.score > 0.0 && (other.item.meets(&chosen) || !self.has_half_left(&state, other)));
            let least = |other: &Scored| match &own {
                None => 0.0,
                Some(own) if self.evidence().repeats() => {
                    own.score + if chosen.is_likelier(&other.item) { STRONG_GAP } else { 0.0 }
                }
                Some(own) if other.cost() > own.cost() => (own.score / TIE_RATIO).max(own.score + MAX_RIVAL_SCORE_GAP),
                Some(own) => own.score + MAX_RIVAL_SCORE_GAP,
            };
            let better = others.iter().find(|other| other.score > least(other) && self.passes(&at, other));
            if let Some(better) = better.filter(|_| swaps > 0) {
                swaps -= 1;
                self.record(path, &rest, chosen, false, own.map_or(0.0, |own| own.score), progress);
                let begun = self.begun(&rest, better.item.clone());
                state = rest.with(&self.problem, begun.clone());
                self.record(path, &state, begun, true, better.score, progress);
                // The replacement is the last effect now and is compared later.
                continue;
            }
            let Some(own) = own else {
                self.record(path, &rest, chosen, false, 0.0, progress);
                state = rest;
                continue;
            };
            let mut rivals: Vec<Rival> = Vec::new();
            // The same effect since another time is no other explanation.
            let itself = |other: &Candidate| {
                other.spec.is_same_effect(&chosen.spec) && (chosen.span.is_all() || other.same_effect(&chosen))
            };
            // What contains the chosen effect, and is no better, is not another explanation but more than is needed: in its columns, or in what its settings
            // change, as a spring that is taut from far away. Both together are over a short way nearly anything.
            let more = |other: &Scored| {
                let parameters = &other.tried.fit.theta.as_slice()[rest.fit.theta.len()..];
                let slopes = || slopes(self.evidence(), self.operating_point, &other.item, parameters);
                other.item.rows.contains(&chosen.rows) || slopes().contains(&chosen.rows)
            };
            for other in others.iter().filter(|other| !itself(&other.item)) {
                let gap = own.score - other.score;
                let listed = rivals.iter().any(|rival| rival.item.same_effect(&other.item));
                let another = || if gap > 0.0 { !more(other) } else { self.passes(&at, other) };
                if gap < MAX_RIVAL_SCORE_GAP && !listed && another() {
                    rivals.push(Rival { item: other.item.clone(), gap });
                }
            }
            found.push(self.found(&rest, &own, rivals));
            item += 1;
        }
        (state, found)
    }

    /// The facts on a candidate that was tried in a state.
    pub(super) fn found(&self, state: &State, one: &Scored, rivals: Vec<Rival>) -> Found {
        Found {
            score: one.score,
            evidence: one.tried.evidence,
            penalty: one.penalty,
            folds: gates::folds(&self.problem, state, &one.tried),
            relevance: gates::relevance(self.evidence(), state, &one.tried, &one.item),
            independence: one.tried.independence,
            rivals,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::synthetic::{FLOOR, with_effect};
    use plumbline_model::term::effect::family;

    #[test]
    fn what_is_too_small_is_not_larger_by_a_worse_law_of_its_joint() {
        let families = [family("stribeck").unwrap()];
        let peak = Spec { family: "stribeck", form: "exponential", site: Site::Joint(1), settings: vec![0.15] };
        let recorded = with_effect(4, 16, &peak, 4.0 * FLOOR, |_| [0.0; 2]);
        recorded.search(&families, &Settings::default(), |search, base| {
            let mut proposals = search.propose(base, |item| item.joints() == [1]);
            proposals.truncate(2);
            let rms = |one: &Scored| gates::relevance(search.evidence(), base, &one.tried, &one.item).rms[1];
            let [larger, smaller] = [0, 1].map(|k| rms(&proposals[k]));
            assert!(larger > smaller);
            let chosen = |threshold: f64, scores: [f64; 2]| {
                let settings = Settings { threshold: Some(threshold), ..Settings::default() };
                let mut proposals = proposals.clone();
                proposals.iter_mut().zip(scores).for_each(|(one, score)| one.score = score);
                proposals.sort_by(|a, b| b.score.total_cmp(&a.score));
                let search = Search { settings: &settings, ..*search };
                search.choose(base, proposals).map(|one| one.item.spec.form)
            };
            let between = 0.5 * (larger + smaller);
            assert_eq!(chosen(between, [180.0, 170.0]), Some("exponential"));
            assert_eq!(chosen(0.5 * smaller, [170.0, 180.0]), Some("gaussian"));
            assert_eq!(chosen(between, [170.0, 180.0]), None, "the better one is too small");
        });
    }
}
