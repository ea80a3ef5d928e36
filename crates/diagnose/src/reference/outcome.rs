//! Changes as they stand in files.

use super::{Change, Changes};
use crate::errors::{Band, Compared};
use crate::found::steps;
use crate::outcome::{
    self, BeforeAfter, Confirmation, Diagnosis, Effect, JointFacts, MinimumDetectable, Parameters, Quantity, Score,
    Stratum, Unexplained, Verdict,
};
use crate::select::MAX_LISTED_SCORES;
use plumbline_model::{Mounting, TorqueModel};

/// A joint whose residual power is more than this many times its noise lacks something, if that is above the noise of the mean period.
const LACKING_RATIO: f64 = 2.0;
/// Quantities of an effect in its line.
const MAX_LISTED_QUANTITIES: usize = 4;

/// Changes of a stored model, and what was done with them.
pub struct Comparison<'a> {
    /// What changed.
    pub changes: &'a Changes,
    /// The model that it changed from.
    pub stored: &'a TorqueModel,
    /// Indices of the effects that the delivered model has.
    pub kept: &'a [usize],
    /// How the base is declared to be mounted.
    pub declared: Option<Mounting>,
    /// What the errors are taken of.
    pub band: Band,
    /// The model in a few words.
    pub since: String,
    /// Names of the runs that judged, none where there were none.
    pub runs: Vec<String>,
}

impl Comparison<'_> {
    /// The outcome, with errors of the stored model without and with the changes on the runs that judged.
    pub fn diagnosis(self, compared: &Compared) -> Diagnosis {
        let changes = self.changes;
        let (held, not_held): (Vec<usize>, Vec<usize>) =
            (0..changes.effects.len()).partition(|k| self.kept.contains(k) || self.runs.is_empty());
        let one = |k: usize| changes.effects[k].effect(self.stored, self.declared.as_ref(), self.kept.contains(&k));
        let effects: Vec<Effect> = held.into_iter().map(one).collect();
        let not_held = not_held.into_iter().map(|k| {
            let what = changes.effects[k].line();
            format!("{what} was found and does not hold on the unseen runs, so it counts as no change; what a model lacks is found by `plumbline diagnose`")
        });
        let joints = joints(changes);
        let unexplained: Vec<Unexplained> = joints.iter().enumerate().filter_map(unexplained).collect();
        let verdict = match (effects.is_empty(), unexplained.is_empty()) {
            (true, _) if changes.folds == 0 => Verdict::Unexplained,
            (true, true) => Verdict::NothingSignificant,
            (true, false) => Verdict::Unexplained,
            (false, false) => Verdict::Partly,
            (false, true) => Verdict::of_all(&effects),
        };
        let confirmation = match (changes.floor.is_some(), changes.folds) {
            (false, _) => Confirmation::NoRepeats,
            (true, 0 | 1) => Confirmation::OneTrajectory,
            (true, trajectories) => Confirmation::Full { trajectories },
        };
        Diagnosis {
            verdict,
            confirmation: Some(confirmation),
            before: compared.before.clone(),
            after: compared.after.clone(),
            change: (!self.runs.is_empty()).then(|| compared.change.clone()),
            noise_floor: compared.floor.clone().unwrap_or_default(),
            unexplained,
            minimum_detectable: changes.least.iter().map(least).collect(),
            path: steps("the stored model", &joints, &changes.path),
            joints,
            scores: self.scores(),
            changes: vec![outcome::Changes {
                since: self.since,
                effects: effects.clone(),
                before: Some(compared.before.clone()),
                after: Some(compared.after.clone()),
                ..outcome::Changes::default()
            }],
            effects,
            band: self.band,
            held_out_runs: self.runs,
            notes: not_held.collect(),
            ..Diagnosis::default()
        }
    }

    fn scores(&self) -> Vec<Score> {
        let Changes { effects, first, .. } = self.changes;
        let score = |one: &crate::Scored| {
            let spec = &one.item.spec;
            let chosen = self.kept.iter().any(|&k| effects[k].spec.is_same_effect(spec));
            Score { label: spec.to_string(), score: one.score, chosen, equivalent: false }
        };
        first.iter().take(MAX_LISTED_SCORES).map(score).collect()
    }
}

impl Change {
    /// As it stands in files. `stored` is the model that it changes, `declared` how the base is declared to be mounted.
    pub fn effect(&self, stored: &TorqueModel, declared: Option<&Mounting>, in_model: bool) -> Effect {
        let form = self.spec.form();
        let mut parameters = self.quantities(stored.parameters(), declared);
        if let Some(form) = form {
            let settings = form.settings.iter().zip(&self.spec.settings);
            parameters.extend(settings.map(|(setting, &value)| Quantity::new(setting.name, value, setting.unit)));
        }
        Effect {
            since_session: self.since,
            parameters: Parameters(parameters),
            confirmed: self.found.folds.confirm() == Some(true),
            stratum: Stratum::Reference,
            in_model,
            ..self.found.effect(&self.spec)
        }
    }

    /// In one line, with its first quantities: `payload (mass 0.7310 +- 0.0040 kg, com_x ...)`.
    pub fn line(&self) -> String {
        let number = |own: &Quantity| match own.std {
            Some(std) => format!("{} {:.4} +- {std:.4} {}", own.name, own.value, own.unit),
            None => format!("{} {:.4} {}", own.name, own.value, own.unit),
        };
        let each: Vec<String> = self.quantities(&[], None).iter().take(MAX_LISTED_QUANTITIES).map(number).collect();
        format!("{} ({})", self.spec, each.join(", "))
    }
}

fn joints(changes: &Changes) -> Vec<JointFacts> {
    let of = |list: &[f64], joint: usize| list.get(joint).copied();
    let fact = |joint: usize| {
        let floor = changes.floor.as_ref().and_then(|floor| of(floor, joint));
        let unmodelled = BeforeAfter { before: of(&changes.before, joint), after: of(&changes.after, joint) };
        let lack_of_fit = changes.lack_of_fit.as_ref().map(|list| BeforeAfter::both(list[joint]));
        JointFacts {
            floor_of_mean: floor,
            lack_of_fit: lack_of_fit.unwrap_or_default(),
            unmodelled,
            threshold: floor,
            adequacy: unmodelled.share_taken(),
            ..JointFacts::default()
        }
    };
    (0..changes.before.len()).map(fact).collect()
}

fn unexplained((joint, facts): (usize, &JointFacts)) -> Option<Unexplained> {
    let above = facts.unmodelled.after.zip(facts.threshold).is_none_or(|(rms, least)| rms > least);
    let lacking = above && facts.lack_of_fit.after.is_some_and(|ratio| ratio > LACKING_RATIO);
    lacking.then(|| Unexplained {
        joint: joint + 1,
        rms: facts.unmodelled.after,
        floor: facts.floor_of_mean,
        deciding_experiment: "`plumbline diagnose` on the same data".into(),
        ..Unexplained::default()
    })
}

fn least((id, rms): &(&'static str, Vec<f64>)) -> (String, MinimumDetectable) {
    let known = |rms: &f64| if rms.is_finite() { *rms } else { f64::NAN };
    let torque_rms = rms.iter().map(known).collect();
    ((*id).to_string(), MinimumDetectable { torque_rms, ..MinimumDetectable::default() })
}
