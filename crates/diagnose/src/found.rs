//! What a selection reports: its steps while it computes, the effects that it took in, and their rivals.

use super::gates::{FoldTest, Relevance};
use super::library::Candidate;
use super::outcome::{self, Action, Alternative, Effect, JointFacts};
use plumbline_model::term::effect::Spec;

/// An effect that was taken in.
#[derive(Clone, Debug)]
pub struct Found {
    /// Score against the model without it.
    pub score: f64,
    /// Twice the gain in log likelihood.
    pub evidence: f64,
    /// Part of the score that pays for parameters and choice.
    pub penalty: f64,
    /// How the folds judge it.
    pub folds: FoldTest,
    /// What it explains.
    pub relevance: Relevance,
    /// Share of its fitted torque that the other columns cannot represent.
    pub independence: f64,
    /// Effects with a score as good.
    pub rivals: Vec<Rival>,
}

impl Found {
    /// Whether the gain pays more than twice for parameters and choice.
    pub(super) fn is_clear(&self) -> bool {
        self.score > self.penalty
    }

    /// As an effect at a place; the caller adds parameters and where it stands in the model.
    pub(super) fn effect(&self, spec: &Spec) -> Effect {
        let mut alternatives: Vec<String> = Vec::new();
        for rival in &self.rivals {
            let family = rival.item.named().family;
            if !alternatives.iter().any(|known| known == family) {
                alternatives.push(family.into());
            }
        }
        let confounded = spec.family().map_or(&[][..], |family| family.confounded);
        let decided =
            |other: &str| confounded.iter().find(|one| one.with == other).map(|one| one.decided_by.to_string());
        let detail = |rival: &Rival| {
            let Spec { family, site, .. } = rival.item.named();
            Alternative {
                id: family.into(),
                joints: outcome::joints(site),
                score_gap: Some(rival.gap),
                deciding_experiment: decided(family).unwrap_or_default(),
            }
        };
        let largest = |values: &[f64]| values.iter().copied().reduce(f64::max);
        Effect {
            joints: outcome::joints(spec.site),
            evidence: Some(self.score),
            delta_log_likelihood: Some(0.5 * self.evidence),
            penalty: Some(self.penalty),
            folds: self.folds.counts(),
            idf: Some(self.independence),
            torque_rms: largest(&self.relevance.rms),
            explained_share: largest(&self.relevance.share),
            alternatives,
            alternatives_detail: self.rivals.iter().map(detail).collect(),
            ..Effect::of(spec.family, spec.form)
        }
    }
}

/// An effect that explains the data as well.
#[derive(Clone, Debug)]
pub struct Rival {
    /// The other effect.
    pub item: Candidate,
    /// Score of the chosen one less its own.
    pub gap: f64,
}

/// What a search reports while it computes.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// A step of the selection.
    Step(&'a Step),
    /// Candidates of the present comparison that are refined and scored.
    Candidates {
        /// So many are.
        done: usize,
        /// Of so many.
        of: usize,
    },
}

/// Takes the progress of a search; called from several threads.
pub type Watch<'w> = dyn Fn(Progress) + Sync + 'w;

/// One step of the selection.
#[derive(Clone, Debug)]
pub struct Step {
    /// What came in or went out.
    pub item: Candidate,
    /// Whether it came in.
    pub added: bool,
    /// Its score then.
    pub score: f64,
    /// Unmodelled mean square of all joints afterwards \[Nm2\].
    pub unmodelled: f64,
}

/// The steps of a selection, as in files, from a model with this unmodelled RMS in each joint.
pub(super) fn steps(from: &str, joints: &[JointFacts], path: &[Step]) -> Vec<outcome::Step> {
    let total: f64 = joints.iter().filter_map(|joint| joint.unmodelled.before).map(|rms| rms * rms).sum();
    let start = outcome::Step { action: Action::Start, what: from.into(), unmodelled: Some(total.sqrt()), score: None };
    let step = |step: &Step| outcome::Step {
        action: if step.added { Action::Added } else { Action::Removed },
        what: step.item.named().to_string(),
        unmodelled: Some(step.unmodelled.sqrt()),
        score: Some(step.score),
    };
    [start].into_iter().chain(path.iter().map(step)).collect()
}
