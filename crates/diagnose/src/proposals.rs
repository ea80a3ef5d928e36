//! Candidates for a state: screened, refined and scored.
//!
//! Score of a candidate: twice the gain in profile log likelihood, less `k ln n` for its `k` parameters (linear and nonlinear, `n` rows of
//! a joint) and `2 ln N` for a library of `N` columns (extended Bayesian information criterion, Chen and Chen, Biometrika 95, 2008).

use super::changing::WARMING_TIME_CONSTANTS_S;
use super::found::{Progress, Watch};
use super::library::{Candidate, is_undeclared_coupling};
use super::moments::GroupedCross;
use super::rows::Rows;
use super::search::{self, Settled};
use super::select::Search;
use super::span::Span;
use super::state::{State, Tried};
use plumbline_core::parallel;
use plumbline_model::term::effect::{Family, Setting, Spec};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Candidates that are fitted in full at each step.
const MAX_SHORTLISTED: usize = 16;
/// Starts of a search for several settings where more than one of them has several start values: the likelihood has more than one maximum, and what it is
/// largest at may be no plausible effect.
const MAX_STARTS: usize = 3;
/// Candidates whose columns are multiplied with the model's at once.
const SCREENED_AT_ONCE: usize = 32;
/// Smallest gain at the start of a search for several settings, as a share of the penalty.
const MIN_START_GAIN_RATIO: f64 = 0.5;
/// Share of the arms that have a coupling of two transmissions that their robot file does not declare, as prior odds: a law of another joint's motion fits
/// much that has no name.
const UNDECLARED_COUPLINGS: f64 = 1e-3;
/// Smallest score with the settings found for another state, as a share of the best, from which on they are searched again.
const MIN_SCORE_RATIO_OF_FOUND: f64 = 0.5;
/// Smallest gain of the exact columns at settings that sketches found, as a share of that of the sketch: means over some samples do not show a link that swings
/// on a stiff gear faster than that.
const MIN_EXACT_GAIN_RATIO: f64 = 0.8;
/// Smallest score with coarse settings, as a share of the best, from which on they are searched finely.
const MIN_SCORE_RATIO_OF_CONTENDERS: f64 = 0.8;
/// Resolution of the begin of an effect in a motion that does not repeat \[s\].
const BEGIN_RESOLUTION_S: f64 = 0.05;
/// Resolution of a time constant, as a share of it.
const RISE_RESOLUTION: f64 = 0.05;

/// A candidate with its score.
#[derive(Clone, Debug)]
pub struct Scored {
    /// The candidate.
    pub item: Candidate,
    /// Tried in the state at hand.
    pub tried: Tried,
    /// Score.
    pub score: f64,
    /// Part of the score that pays for parameters and choice.
    pub penalty: f64,
}

impl Scored {
    /// Torques that it adds to, counted by its columns, then its parameters, then whether few arms have it: of two that are as good the one with less is
    /// preferred.
    pub(super) fn cost(&self) -> (usize, usize, bool) {
        (self.tried.rows.width * self.item.joints().len(), self.item.parameters(), !self.item.is_usual())
    }

    /// Whether the gain pays more than twice for parameters and choice.
    pub(super) fn is_clear(&self) -> bool {
        self.score > self.penalty
    }
}

impl Search<'_> {
    /// What a candidate's parameters and its choice cost.
    pub(super) fn penalty(&self, item: &Candidate) -> f64 {
        self.penalty_among(self.columns(), item)
    }

    /// Columns of the library, N.
    fn columns(&self) -> usize {
        self.library.iter().map(|one| one.rows.width).sum()
    }

    fn penalty_among(&self, columns: usize, item: &Candidate) -> f64 {
        let rows = self.evidence().per_joint() as f64;
        let parameters = item.parameters() as f64 * rows.ln();
        // What the deviations show has been chosen there.
        let came = |(spec, span): &(Spec, Span)| item.spec.is_same_effect(spec) && span.begins_near(item.span);
        if self.came.iter().any(came) {
            return parameters;
        }
        let undeclared = |family: &Family| is_undeclared_coupling(family, item.spec.site, self.operating_point);
        let rare = if item.spec.family().is_ok_and(undeclared) { UNDECLARED_COUPLINGS } else { 1.0 };
        parameters + 2.0 * (columns.max(2) as f64 / rare).ln()
    }

    /// The best candidates for a state, refined, best first.
    pub fn propose(&self, state: &State, wanted: impl Fn(&Candidate) -> bool + Sync) -> Vec<Scored> {
        self.proposed(state, wanted, &mut Vec::new(), &|_| {})
    }

    /// [`Search::propose`] that tells how far it is. `refined` has what it found for other states: one that is still better than every start is the only
    /// start for that effect. It is updated.
    pub(super) fn proposed(
        &self,
        state: &State,
        wanted: impl Fn(&Candidate) -> bool + Sync,
        refined: &mut Vec<Candidate>,
        progress: &Watch,
    ) -> Vec<Scored> {
        let threads = self.settings.threads;
        let (library, grid) = (self.library.iter().chain(&*refined).collect::<Vec<_>>(), self.library.len());
        let quietly = OnceLock::new();
        let quiet = || quietly.get_or_init(|| self.problem.quiet(&state.fit));
        let columns = self.columns();
        let screen = |item: &Candidate, cross: &GroupedCross| {
            let penalty = self.penalty_among(columns, item);
            // A torque gain is taken over by the masses beyond its joint, which the joints before it then have wrong.
            let own = self.problem.gain(&state.fit, cross, Some(&item.joints()));
            let elsewhere = own.as_ref().is_some_and(|own| own.elsewhere > MIN_START_GAIN_RATIO * penalty);
            let (fit, gain) = match own {
                None => (quiet(), self.problem.gain(quiet(), cross, None)),
                Some(_) if elsewhere => (&state.fit, self.problem.gain(&state.fit, cross, None)),
                own => (&state.fit, own),
            };
            gain.map_or(f64::NEG_INFINITY, |gain| {
                let evidence = gain.evidence + 2.0 * (fit.likelihood - state.fit.likelihood);
                item.plausibility(gain.gamma.as_slice()) * evidence - penalty
            })
        };
        let usable = |k: &usize| wanted(library[*k]) && !state.items.iter().any(|own| own.alike(library[*k]));
        let mut order: Vec<usize> = (0..library.len()).filter(usable).collect();
        let screened = parallel(&order.chunks(SCREENED_AT_ONCE).collect::<Vec<_>>(), threads, |chunk| {
            let rows: Vec<&Rows> = chunk.iter().map(|&k| &library[k].rows).collect();
            let crosses = state.crosses(self.evidence(), &rows);
            chunk.iter().zip(&crosses).map(|(&k, cross)| screen(library[k], cross)).collect::<Vec<_>>()
        });
        let mut scores = vec![f64::NEG_INFINITY; library.len()];
        order.iter().zip(screened.concat()).for_each(|(&k, score)| scores[k] = score);
        order.retain(|&k| scores[k].is_finite());
        order.sort_by(|&a, &b| scores[b].total_cmp(&scores[a]));
        let least = MIN_SCORE_RATIO_OF_FOUND * order.first().map_or(0.0, |&k| scores[k]);
        let poor: Vec<&Candidate> =
            order.iter().filter(|&&k| k >= grid && scores[k] < least).map(|&k| library[k]).collect();
        let searched = |item: &Candidate| !poor.iter().any(|found| std::ptr::eq(*found, item));
        let short = shortlisted(order.into_iter().map(|k| (library[k], k >= grid)));
        // Those of several settings take far longer than the others: the threads share the starts, not the effects.
        let starts: Vec<&Candidate> = short.iter().flatten().copied().collect();
        let (done, of) = (AtomicUsize::new(0), starts.len());
        let tried = parallel(&starts, threads, |start| {
            let item = self.rebuilt(start);
            let item = if searched(start) { self.searched(state, item, search::COARSE) } else { item };
            let scored = self.score(state, &item);
            progress(Progress::Candidates { done: done.fetch_add(1, Ordering::Relaxed) + 1, of });
            (item, scored)
        });
        let mut tried = tried.into_iter();
        let (mut scored, mut implausible): (Vec<Scored>, Vec<Candidate>) = (Vec::new(), Vec::new());
        for starts in &short {
            let (items, own): (Vec<_>, Vec<_>) = tried.by_ref().take(starts.len()).unzip();
            match own.into_iter().flatten().max_by(|a, b| a.score.total_cmp(&b.score)) {
                Some(best) => scored.push(best),
                None => implausible.extend(items.into_iter().next()),
            }
        }
        let least = MIN_SCORE_RATIO_OF_CONTENDERS * scored.iter().map(|one| one.score).fold(0.0, f64::max);
        let mut scored = parallel(&scored, threads, |one| {
            let contends = one.item.spec.settings.len() > 1 && one.score > least;
            let finely = || self.score(state, &self.searched(state, one.item.clone(), search::FINE));
            let better = contends.then(finely).flatten().filter(|fine| fine.score > one.score);
            better.unwrap_or_else(|| one.clone())
        });
        // What is not plausible at any maximum is not searched from all starts again either.
        let found = scored.iter().map(|one| one.item.clone()).chain(implausible);
        for item in found.filter(|item| item.spec.settings.len() > 1) {
            refined.retain(|other| !other.alike(&item));
            refined.push(item);
        }
        scored.sort_by(|a, b| b.score.total_cmp(&a.score));
        scored
    }

    /// A candidate's score in a state.
    pub fn score(&self, state: &State, item: &Candidate) -> Option<Scored> {
        let tried = state.try_in(&self.problem, item)?;
        let parameters = &tried.fit.theta.as_slice()[state.fit.theta.len()..];
        if !item.allows(parameters) {
            return None;
        }
        let penalty = self.penalty(item);
        Some(Scored { score: tried.evidence - penalty, penalty, tried, item: item.clone() })
    }

    /// A candidate with its settings at the nearest maximum of the likelihood.
    pub fn refined(&self, state: &State, item: Candidate) -> Candidate {
        self.searched(state, item, search::FINE)
    }

    fn searched(&self, state: &State, item: Candidate, settled: Settled) -> Candidate {
        let form = item.spec.form();
        let Some(form) = form.filter(|form| !form.settings.is_empty()) else { return item };
        let gain = |item: &Candidate| {
            let cross = state.cross(self.evidence(), &item.rows);
            let gain = self.problem.gain(&state.fit, &cross, None);
            gain.map_or(f64::NEG_INFINITY, |gain| item.plausibility(gain.gamma.as_slice()) * gain.evidence)
        };
        let spec_at = |shares: &[f64]| {
            let setting = |(setting, share): (&Setting, &f64)| inside(setting, *share);
            Spec { settings: form.settings.iter().zip(shares).map(setting).collect(), ..item.spec.clone() }
        };
        let at = |shares: &[f64]| {
            let sketch = Candidate::sketch(self.evidence(), self.operating_point, spec_at(shares), item.span);
            sketch.map_or(f64::NEG_INFINITY, |sketch| gain(&sketch))
        };
        let start: Vec<f64> =
            form.settings.iter().zip(&item.spec.settings).map(|(own, value)| own.share(*value)).collect();
        let steps: Vec<f64> = form.settings.iter().map(Setting::spacing).collect();
        let before = gain(&item);
        let (start, highest) =
            if item.has_several_maxima() { search::beside(start, before, steps[0], &at) } else { (start, before) };
        // Expensive. Skipped when the gain is below half the penalty.
        if form.settings.len() > 1 && highest < MIN_START_GAIN_RATIO * self.penalty(&item) {
            return item;
        }
        let found = search::largest(&start, &steps, settled, &at);
        // A sketch is approximate: the found settings are evaluated exactly.
        let exactly = |shares: &[f64]| {
            let item = Candidate::of(self.evidence(), self.operating_point, spec_at(shares), item.span)?;
            Some((gain(&item), item))
        };
        let gained = |one: &Option<(f64, Candidate)>| one.as_ref().map_or(f64::NEG_INFINITY, |(gain, _)| *gain);
        let mut exact = exactly(&found);
        if gained(&exact) < MIN_EXACT_GAIN_RATIO * at(&found) {
            exact = exactly(&search::largest(&found, &steps, settled, &|shares| gained(&exactly(shares))));
        }
        match exact {
            Some((gain, found)) if gain > before => found,
            _ => item,
        }
    }

    /// A candidate that begins where the likelihood is largest, near the begin of a block of a motion that does not repeat, or between the begins that the
    /// deviations of the periods leave open; one that comes by and by, with the time constant nearby at which it is.
    pub(super) fn begun(&self, state: &State, item: Candidate) -> Candidate {
        let evidence = self.evidence();
        let (span, spec) = (item.span, item.spec.clone());
        let sketch = |span: Span| Candidate::sketch(evidence, self.operating_point, spec.clone(), span);
        let [shortest, .., longest] = WARMING_TIME_CONSTANTS_S;
        // The logarithm of a time constant, or the begin within a block.
        let moved = |offset: f64| match span.is_slow() {
            true => sketch(Span { rise: (span.rise * offset.exp()).clamp(shortest, longest), ..span }),
            false => sketch(Span { from: span.from + offset, ..span }),
        };
        let (mut reach, resolution) = if span.is_slow() {
            (std::f64::consts::LN_2, RISE_RESOLUTION)
        } else {
            let length = evidence.length_of_block_at(span.from).or_else(|| self.open_around(&item));
            let Some(length) = length else { return item };
            (length, BEGIN_RESOLUTION_S)
        };
        let gain = |item: &Candidate| {
            let cross = state.cross(evidence, &item.rows);
            let gain = self.problem.gain(&state.fit, &cross, None);
            gain.map_or(f64::NEG_INFINITY, |gain| gain.evidence)
        };
        // Blocks are short against the time that an effect lasts: there is one maximum nearby.
        let (mut best, mut here) = ((gain(&item), item), 0.0);
        while reach > resolution {
            reach *= 0.5;
            for offset in [here - reach, here + reach] {
                let Some(moved) = moved(offset) else { continue };
                let gain = gain(&moved);
                if gain > best.0 {
                    (best, here) = ((gain, moved), offset);
                }
            }
        }
        best.1
    }

    /// How far the next begin is at which the deviations of the periods say that a candidate may have come as well \[s\].
    fn open_around(&self, item: &Candidate) -> Option<f64> {
        let same = self.came.iter().filter(|(spec, span)| *spec == item.spec && span.begins_near(item.span));
        let apart = same.map(|(_, span)| (span.from - item.span.from).abs()).filter(|apart| *apart > 0.0);
        apart.min_by(f64::total_cmp)
    }

    /// The same effect with its columns at this operating point.
    pub(super) fn rebuilt(&self, item: &Candidate) -> Candidate {
        Candidate::of(self.evidence(), self.operating_point, item.spec.clone(), item.span)
            .unwrap_or_else(|| item.clone())
    }
}

/// A value between the setting's limits, whatever rounding does.
pub(super) fn inside(setting: &Setting, share: f64) -> f64 {
    setting.at(share.clamp(0.0, 1.0)).clamp(setting.low, setting.high)
}

/// The first effects of a list, each with the first of its starts, which differ in their first setting: a sharper flank of the same gap leads to the same
/// maximum. One that a search has found is followed by no other.
fn shortlisted<'a>(candidates: impl Iterator<Item = (&'a Candidate, bool)>) -> Vec<Vec<&'a Candidate>> {
    let differs = |one: &Candidate, other: &Candidate| one.spec.settings.first() != other.spec.settings.first();
    let mut short: Vec<(usize, Vec<&Candidate>)> = Vec::new();
    for (item, found) in candidates {
        match short.iter().position(|(_, starts)| starts[0].alike(item)) {
            Some(of) if short[of].1.len() < short[of].0 && short[of].1.iter().all(|start| differs(start, item)) => {
                short[of].1.push(item);
            }
            None if short.len() < MAX_SHORTLISTED => {
                let most = if !found && item.has_several_maxima() { MAX_STARTS } else { 1 };
                short.push((most, vec![item]));
            }
            _ => {}
        }
    }
    short.into_iter().map(|(_, starts)| starts).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use crate::fit::Problem;
    use crate::synthetic::{At, recorded, with_effect};
    use plumbline_model::term::effect::{Site, family};

    #[test]
    fn of_sixteen_effects_the_best_starts_are_searched_from() {
        let families = ["presliding", "stribeck", "backlash", "position-ripple"].map(|id| family(id).unwrap());
        recorded(2, 61, |_| [0.0; 2]).search(&families, &Settings::default(), |search, _| {
            let library = || search.library.iter().map(|item| (item, false));
            let short = shortlisted(library());
            assert!(short.iter().all(|starts| starts.iter().all(|item| item.alike(starts[0]))));
            let mut seen = [false; 2];
            for starts in &short {
                let mut all: Vec<&Candidate> = search.library.iter().filter(|item| item.alike(starts[0])).collect();
                let several = starts[0].has_several_maxima();
                all.dedup_by_key(|item| item.spec.settings.first().copied());
                let expected = &all[..all.len().min(if several { 3 } else { 1 })];
                assert!(starts.iter().zip(expected).all(|(one, other)| std::ptr::eq(*one, *other)));
                assert_eq!(starts.len(), expected.len());
                seen[usize::from(several)] |= all.len() > 3;
            }
            assert_eq!(seen, [true; 2], "effects with one setting and with several");
            assert!(shortlisted(library().chain(library())).len() == short.len() && short.len() <= 16);
            let found = shortlisted(search.library.iter().map(|item| (item, true)));
            assert!(found.len() == short.len() && found.iter().all(|starts| starts.len() == 1));
        });
    }

    #[test]
    fn what_came_begins_between_the_begins_that_the_periods_leave_open() {
        let offset = family("torque-offset").unwrap();
        let torque = |at: &At| [0.0, if at.trajectory == 1 && at.elapsed >= 6.97 { 2.0 } else { 0.0 }];
        recorded(2, 61, torque).search(&[offset], &Settings::default(), |search, base| {
            let spec = Spec { family: offset.id, form: "", site: Site::Joint(1), settings: Vec::new() };
            let start = search.evidence().begins()[1];
            let came = [6.4, 6.65, 6.9, 7.15].map(|from| (spec.clone(), Span::since(start + from)));
            let begun = |came: &[(Spec, Span)]| {
                let problem = Problem { evidence: search.problem.evidence, prior: None };
                let search = Search { problem, came, ..*search };
                let item = Candidate::of(search.evidence(), search.operating_point, spec.clone(), came[0].1);
                search.begun(base, item.unwrap()).span.from - start
            };
            assert!((begun(&came[2..]) - 6.97).abs() < 0.05, "{}", begun(&came[2..]));
            assert_eq!(begun(&came[2..3]), came[2].1.from - start, "where nothing else is open");
        });
    }

    #[test]
    fn what_was_found_for_several_settings_is_where_the_next_search_begins() {
        let elasticity = family("joint-elasticity").unwrap();
        let spec = Spec { family: elasticity.id, form: "swinging", site: Site::Joint(1), settings: vec![2e-3, 5.0] };
        with_effect(2, 61, &spec, 0.5, |_| [0.0; 2]).search(&[elasticity], &Settings::default(), |search, base| {
            let swings = |item: &Candidate| item.spec.settings.len() > 1;
            let mut refined = Vec::new();
            let mut propose = || search.proposed(base, swings, &mut refined, &|_| {});
            let (first, second) = (propose(), propose());
            assert!(!first.is_empty() && first.len() == second.len());
            // The best one is searched finely.
            let again = search.score(base, &search.refined(base, first[0].item.clone())).unwrap();
            assert!(again.score < first[0].score + 0.2, "{} then {}", first[0].score, again.score);
            for one in &second {
                let before = first.iter().find(|other| other.item.alike(&one.item)).unwrap();
                // A search compares gains at the weights of the state; a score has weights of its own.
                assert!(one.score >= (1.0 - 1e-4) * before.score, "{} then {}", before.score, one.score);
            }
            let implausible = refined.iter().filter(|item| !second.iter().any(|one| one.item.alike(item)));
            assert_eq!(refined.len() - implausible.clone().count(), second.len());
            assert!(implausible.clone().all(|item| search.score(base, item).is_none()));
            assert!(second.iter().all(|one| refined.iter().any(|item| item.spec == one.item.spec)));
        });
    }

    #[test]
    fn what_was_found_and_is_worth_less_than_half_of_the_best_is_not_searched_again() {
        let families = ["presliding", "torque-offset"].map(|id| family(id).unwrap());
        let spec = |settings: &[f64]| Spec {
            family: families[0].id,
            form: "spread",
            site: Site::Joint(1),
            settings: settings.to_vec(),
        };
        let known = spec(&[3.6e-2, 2.9]);
        for (offset, searched) in [(0.0, true), (5.0, false)] {
            let recorded = with_effect(2, 61, &spec(&[3e-2, 3.0]), 0.055, |_| [0.0, offset]);
            recorded.search(&families, &Settings::default(), |search, base| {
                let mut refined = vec![
                    Candidate::sketch(search.evidence(), search.operating_point, known.clone(), Span::ALL).unwrap(),
                ];
                let proposed = search.proposed(base, |_| true, &mut refined, &|_| {});
                let own = proposed
                    .iter()
                    .find(|one| one.item.spec.is_same_effect(&known) && one.item.spec.form == known.form);
                let found = own.unwrap();
                assert!(searched == (found.score > 0.5 * proposed[0].score), "{} {}", found.score, proposed[0].score);
                assert_eq!(found.item.spec != known, searched, "{:?}", found.item.spec);
            });
        }
    }

    #[test]
    fn exact_columns_decide_where_means_mislead() {
        let elasticity = family("joint-elasticity").unwrap();
        let swinging = |settings: &[f64]| Spec {
            family: elasticity.id,
            form: "swinging",
            site: Site::Joint(1),
            settings: settings.to_vec(),
        };
        let recorded = with_effect(2, 62, &swinging(&[3e-4, 30.0]), 0.5, |_| [0.0; 2]);
        recorded.search(&[elasticity], &Settings::default(), |search, base| {
            let (evidence, point) = (search.evidence(), search.operating_point);
            let start = Candidate::of(evidence, point, swinging(&[1e-4, 2.5]), Span::ALL).unwrap();
            let settings = elasticity.form("swinging").unwrap().settings;
            let spec_at = |shares: &[f64]| {
                swinging(&settings.iter().zip(shares).map(|(own, share)| inside(own, *share)).collect::<Vec<_>>())
            };
            let gain = |item: Option<Candidate>| {
                let item = item.unwrap();
                let gain = search.problem.gain(&base.fit, &base.cross(evidence, &item.rows), None);
                gain.map_or(0.0, |gain| item.plausibility(gain.gamma.as_slice()) * gain.evidence)
            };
            let exact = |spec: Spec| gain(Candidate::of(evidence, point, spec, Span::ALL));
            let mean = |spec: Spec| gain(Candidate::sketch(evidence, point, spec, Span::ALL));
            let shares = settings.iter().zip(&start.spec.settings).map(|(own, value)| own.share(*value)).collect();
            let steps: Vec<f64> = settings.iter().map(Setting::spacing).collect();
            let at = |shares: &[f64]| mean(spec_at(shares));
            let (beside, _) = search::beside(shares, exact(start.spec.clone()), steps[0], &at);
            let misleading = search::largest(&beside, &steps, search::FINE, &at);
            let (shown, true_gain) = (mean(spec_at(&misleading)), exact(spec_at(&misleading)));
            assert!(true_gain < 0.8 * shown, "{true_gain} of {shown}");
            let found = exact(search.refined(base, start).spec);
            assert!(found > 1.1 * true_gain, "{found} instead of {true_gain}");
        });
    }

    #[test]
    fn what_is_implausible_is_remembered_too() {
        let elasticity = family("joint-elasticity").unwrap();
        let spec = Spec { family: elasticity.id, form: "swinging", site: Site::Joint(1), settings: vec![2e-3, 5.0] };
        with_effect(2, 61, &spec, -0.5, |_| [0.0; 2]).search(&[elasticity], &Settings::default(), |search, base| {
            let mut refined = Vec::new();
            let wanted = |item: &Candidate| item.spec.is_same_effect(&spec) && item.spec.form == spec.form;
            let scored = search.proposed(base, wanted, &mut refined, &|_| {});
            assert!(scored.is_empty() && refined.len() == 1);
        });
    }
}
