//! Effects that act in a part of the recording alone: what came, between two runs or within one, while the arm was identified.
//!
//! They are in no model. What they do is taken off the torques that the model is identified from, and added to what it predicts where they act. Of what
//! comes by and by the model has what is there at the end of the identified runs.

use super::changing::WARMING_TIME_CONSTANTS_S;
use super::evidence::{Evidence, Trial};
use super::library::{Candidate, library, slow, sudden};
use super::outcome::Acts;
use super::span::Span;
use super::state::State;
use nalgebra::{DMatrix, DVector};
use plumbline_identify::Experiment;
use plumbline_model::Chain;
use plumbline_model::term::effect::{OperatingPoint, Spec};
use plumbline_model::term::{Motion, Term};
use std::borrow::Cow;
use std::sync::Arc;

/// The effects of a fitted state that act in a part.
pub(super) struct Acting<'a> {
    chain: &'a Chain,
    parts: Vec<Part>,
    /// End of the identified runs on the clock of the recording \[s\].
    end: f64,
}

struct Part {
    term: Arc<dyn Term>,
    theta: DVector<f64>,
    span: Span,
}

impl<'a> Acting<'a> {
    /// Of a state at an operating point, which these runs were identified from.
    pub fn of(chain: &'a Chain, state: &State, operating_point: &OperatingPoint, identified: &[Trial]) -> Acting<'a> {
        let part = |(index, item): (usize, &Candidate)| {
            let term = item.spec.build(operating_point).ok().filter(|_| !item.span.is_all())?;
            let range = state.range(index);
            Some(Part { term, theta: state.fit.theta.rows(range.start, range.len()).into_owned(), span: item.span })
        };
        Acting {
            chain,
            parts: state.items.iter().enumerate().filter_map(part).collect(),
            end: Trial::end_of(identified),
        }
    }

    /// What they do to a run along its motion, N x n \[Nm\].
    pub fn torque(&self, trial: &Trial, motion: &Motion) -> DMatrix<f64> {
        let (samples, joints) = (motion.samples(), motion.joints());
        let mut tau = DMatrix::zeros(samples, joints);
        for Part { term, theta, span } in &self.parts {
            let in_model = if span.is_slow() { span.share_at(self.end) } else { 0.0 };
            let share = trial.experiment.timeline.mean_of(|t| span.share_at(trial.start + t) - in_model);
            if share.iter().all(|share| *share == 0.0) {
                continue;
            }
            let mut y = DMatrix::zeros(samples * joints, theta.len());
            term.fill(self.chain, motion, &mut y, 0);
            let torque = y * theta;
            for (k, value) in torque.iter().enumerate() {
                tau[(k % samples, k / samples)] += share[k % samples] * value;
            }
        }
        tau
    }

    /// Experiments without what they do.
    pub fn taken_off<'e>(&self, trials: &[Trial<'e>]) -> Vec<Cow<'e, Experiment>> {
        let without = |trial: &Trial<'e>| {
            let mut experiment = Cow::Borrowed(trial.experiment);
            if !self.is_empty() {
                experiment.to_mut().tau -= self.torque(trial, &trial.experiment.motion);
            }
            experiment
        };
        trials.iter().map(without).collect()
    }

    /// Whether any comes by and by.
    pub fn any_slow(&self) -> bool {
        self.parts.iter().any(|part| part.span.is_slow())
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }
}

/// Candidates that act from the begin of a run on, in one run alone, in the parts of what `came`, from every block of a motion that does not repeat on,
/// and friction that changes as its joint warms up.
///
/// A load in the first run alone is the load of all runs, which the model has, and its opposite since the second. A tilt or an offset of all runs is
/// `in_no_model`.
pub(super) fn candidates(
    evidence: &Evidence,
    operating_point: &OperatingPoint,
    trials: &[Trial],
    came: &[(Spec, Span)],
    in_no_model: impl Fn(&Candidate) -> bool,
    threads: usize,
) -> Vec<Candidate> {
    let families = sudden();
    let everywhere = library(evidence, operating_point, &families, Span::ALL, threads);
    // The periods' deviations tell the time of what came better than the runs' means.
    let dated = |item: &Candidate, span: Span| {
        came.iter().any(|(spec, own)| item.spec.is_same_effect(spec) && own.begins_near(span))
    };
    let of_part = |span| {
        let open = everywhere.iter().filter(move |item| !dated(item, span));
        open.filter_map(move |item| item.in_folds(evidence, span))
    };
    let parts = whole_folds(evidence, trials).into_iter();
    let first = first_alone(trials).into_iter().flat_map(|span| {
        everywhere.iter().filter(|item| in_no_model(item)).filter_map(move |item| item.in_folds(evidence, span))
    });
    let mut known: Vec<Span> = came.iter().map(|(_, span)| *span).collect();
    known.dedup();
    let inside = known.iter().flat_map(|span| library(evidence, operating_point, &families, *span, threads));
    let slow = slowly(trials).flat_map(|span| library(evidence, operating_point, &slow(), span, threads));
    parts.flat_map(of_part).chain(first).chain(inside).chain(slow).collect()
}

/// From the begin of the recording on, by and by. The power that a joint's friction dissipates hardly differs between the runs of a recording.
fn slowly(trials: &[Trial]) -> impl Iterator<Item = Span> + use<> {
    let at_once = Span::since(Trial::begin_of(trials));
    WARMING_TIME_CONSTANTS_S.into_iter().map(move |rise| Span { rise, ..at_once })
}

/// The first of several runs.
fn first_alone(trials: &[Trial]) -> Option<Span> {
    let first = trials.iter().map(|trial| trial.start).min_by(f64::total_cmp)?;
    let second = trials.iter().map(|trial| trial.start).filter(|start| *start > first).min_by(f64::total_cmp)?;
    Some(Span { to: second, ..Span::since(first) })
}

/// Parts of the recording that consist of folds: from a run on, a run alone, and from a block of a motion that does not repeat on; nothing tells the
/// time of a step in such a motion before the search.
fn whole_folds(evidence: &Evidence, trials: &[Trial]) -> Vec<Span> {
    let mut starts: Vec<f64> = trials.iter().map(|trial| trial.start).collect();
    starts.sort_by(f64::total_cmp);
    starts.dedup();
    let since = starts.iter().skip(1).map(|&start| Span::since(start));
    // The last run alone is the same as since its begin.
    let alone = starts.windows(2).skip(1).map(|pair| Span { to: pair[1], ..Span::since(pair[0]) });
    let folds = evidence.folds().iter().zip(evidence.begins()).filter(|(fold, _)| fold.samples.start > 0);
    let blocks = folds.flat_map(|(fold, from)| {
        let later = starts.iter().find(|start| **start > trials[fold.experiment].start);
        [Some(Span::since(from)), later.map(|&to| Span { to, ..Span::since(from) })].into_iter().flatten()
    });
    since.chain(alone).chain(blocks).collect()
}

/// Where in its runs a part of the recording begins and ends; `None` for the whole.
pub(super) fn acts(span: Span, trials: &[Trial]) -> Option<Acts> {
    let run = trials.iter().rev().find(|trial| trial.start <= span.from)?;
    let to_end_of_recording = span.to == f64::INFINITY;
    Some(Acts { run: run.experiment.name.clone(), from: span.from - run.start, to_end_of_recording })
}

/// Whether any of these runs has samples in a part of the recording.
pub(super) fn any_in(span: Span, trials: &[Trial]) -> bool {
    trials.iter().any(|trial| trial.start < span.to && trial.end() > span.from)
}
