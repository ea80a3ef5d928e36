//! What has changed, as the report has it: shared by `compare` and the live watch.

use crate::failure::Failure;
use crate::report::Band;
use crate::report::diagnosis::{
    self, Action, Alternative, BeforeAfter, Diagnosis, Effect, EffectParameter, Errors, Folds, JointFacts,
    MinimumDetectable, Occurrence, Parameters, Score, Unexplained, Verdict,
};
use plumbline_diagnose::errors::{Compared, Of};
use plumbline_diagnose::reference::{Change, Changes};
use plumbline_diagnose::{errors, reference};

use plumbline_identify::{Experiment, Modelled, Rms, validate};
use plumbline_model::term::effect::{Quantity, Site, family};
use plumbline_model::{Mounting, TorqueModel};

/// A joint whose residual power is so many times its noise lacks something.
const LACKING: f64 = 2.0;
/// Candidates that are listed.
const LISTED: usize = 10;
/// Quantities of an effect that a line names.
const QUANTITIES: usize = 4;

/// The stored model and what was found.
pub struct Stored<'a> {
    /// The model.
    pub model: &'a TorqueModel,
    /// What was found.
    pub changes: &'a [Change],
}

impl Stored<'_> {
    /// The model with some of the changes, as far as they had come in a session.
    pub fn with(&self, kept: &[usize], session: u32) -> Result<TorqueModel, Failure> {
        let come = |k: &&usize| self.changes[**k].since.is_none_or(|since| since <= session);
        let chosen: Vec<Change> = kept.iter().filter(come).map(|&k| self.changes[k].clone()).collect();
        reference::extended(self.model, &chosen).map_err(Failure::job)
    }

    /// Its errors on runs of these sessions.
    pub fn errors(&self, kept: &[usize], runs: &[(&Experiment, u32)]) -> Result<Vec<Rms>, Failure> {
        let error = |&(experiment, session): &(&Experiment, u32)| {
            let model = self.with(kept, session)?;
            Ok(validate(experiment, |motion| model.predict(motion)))
        };
        runs.iter().map(error).collect()
    }

    /// Changes that lower the error on unseen runs, in one joint at least for certain; without unseen runs, all of them. What a model lacked
    /// when it was identified is in every search, and holds on other runs by chance alone.
    pub fn stand_the_test(&self, unseen: &[(&Experiment, u32)]) -> Result<Vec<usize>, Failure> {
        let mut kept: Vec<usize> = (0..self.changes.len()).collect();
        if unseen.is_empty() {
            return Ok(kept);
        }
        let total = |kept: &[usize]| -> Result<f64, Failure> {
            let square = |rms: &Rms| rms.samples as f64 * rms.filtered.iter().map(|value| value * value).sum::<f64>();
            Ok(self.errors(kept, unseen)?.iter().map(square).sum())
        };
        let mut with = total(&kept)?;
        for k in (0..self.changes.len()).rev() {
            let rest: Vec<usize> = kept.iter().copied().filter(|&other| other != k).collect();
            let without = total(&rest)?;
            if without <= with || !self.certain(&rest, &kept, unseen)? {
                (kept, with) = (rest, without);
            }
        }
        Ok(kept)
    }

    /// Whether the second model is better than the first in a joint, by the whole interval of the difference.
    fn certain(&self, first: &[usize], second: &[usize], unseen: &[(&Experiment, u32)]) -> Result<bool, Failure> {
        let mut pairs = Vec::new();
        for &(experiment, session) in unseen {
            let (first, second) = (self.with(first, session)?, self.with(second, session)?);
            let along = |model: &TorqueModel| Modelled::of(experiment, |motion| model.predict(motion));
            pairs.push((experiment, along(&first), along(&second)));
        }
        let compared = errors::compare(&pairs, Of::Filtered).unwrap_or_default();
        Ok(compared.change.interval.iter().any(|[_, high]| *high < 0.0))
    }

    /// Errors without and with them, with intervals, after the low-pass; empty without runs.
    pub fn compared(&self, kept: &[usize], runs: &[(&Experiment, u32)]) -> Result<Compared, Failure> {
        let mut pairs = Vec::new();
        for &(experiment, session) in runs {
            let with = self.with(kept, session)?;
            let along = |model: &TorqueModel| Modelled::of(experiment, |motion| model.predict(motion));
            pairs.push((experiment, along(self.model), along(&with)));
        }
        Ok(errors::compare(&pairs, Of::Filtered).unwrap_or_default())
    }
}

/// Changes on their way into the report.
pub struct Told<'a> {
    changes: &'a Changes,
    stored: &'a TorqueModel,
    /// Those that the delivered model has.
    kept: &'a [usize],
    /// What errors are taken of.
    pub band: Band,
    /// How the base is said to be mounted.
    pub declared: Option<Mounting>,
}

impl<'a> Told<'a> {
    /// `kept` are the indices of the effects that the delivered model has.
    pub fn new(changes: &'a Changes, stored: &'a TorqueModel, kept: &'a [usize]) -> Told<'a> {
        Told { changes, stored, kept, band: Band::Raw, declared: None }
    }

    /// The block `diagnosis`.
    pub fn diagnosis(&self, since: &str, runs: &[String], compared: &Compared) -> Diagnosis {
        let changes = self.changes;
        let (held, not_held): (Vec<usize>, Vec<usize>) =
            (0..changes.effects.len()).partition(|k| self.kept.contains(k) || runs.is_empty());
        let one = |k: usize| {
            let in_model = self.kept.contains(&k);
            effect(&changes.effects[k], self.stored, self.declared.as_ref(), in_model)
        };
        let effects: Vec<Effect> = held.into_iter().map(one).collect();
        let not_held = not_held.into_iter().map(|k| {
            let what = line(&changes.effects[k]);
            format!("{what} was found and does not hold on the unseen runs, so it counts as no change; what a model lacks is found by `plumbline diagnose`")
        });
        let errors = |of: &errors::Errors| Errors { validate_rms: of.rms.clone(), intervals: of.interval.clone() };
        let (before, after) = (errors(&compared.before), errors(&compared.after));
        let joints = self.joints();
        let unexplained: Vec<Unexplained> = joints.iter().enumerate().filter_map(unexplained).collect();
        let ambiguous = effects.iter().any(|effect| !effect.alternatives.is_empty());
        let verdict = match (effects.is_empty(), unexplained.is_empty()) {
            (true, _) if changes.folds == 0 => Verdict::Unexplained,
            (true, true) => Verdict::NothingSignificant,
            (true, false) => Verdict::Unexplained,
            (false, false) => Verdict::Partly,
            (false, true) if ambiguous => Verdict::Ambiguous,
            (false, true) => Verdict::Diagnosed,
        };
        let confirmation = match (changes.floor.is_some(), changes.folds) {
            (false, _) => "no repeats",
            (true, 0 | 1) => "one trajectory",
            (true, _) => "confirmed across trajectories",
        };
        Diagnosis {
            verdict,
            confirmation: confirmation.into(),
            before: before.clone(),
            after: after.clone(),
            change: (!runs.is_empty()).then(|| errors(&compared.change)),
            band: self.band,
            held_out_runs: runs.to_vec(),
            noise_floor: compared.floor.clone().unwrap_or_default(),
            unexplained,
            minimum_detectable: changes.least.iter().map(least).collect(),
            joints,
            path: path(changes),
            scores: self.scores(),
            changes: vec![diagnosis::Changes {
                since: since.to_string(),
                effects: effects.clone(),
                before: Some(before),
                after: Some(after),
                ..diagnosis::Changes::default()
            }],
            effects,
            notes: not_held.collect(),
            ..Diagnosis::default()
        }
    }

    fn joints(&self) -> Vec<JointFacts> {
        let of = |list: &[f64], joint: usize| list.get(joint).copied();
        let changes = self.changes;
        let fact = |joint: usize| {
            let floor = changes.floor.as_ref().and_then(|floor| of(floor, joint));
            let both = changes.lack_of_fit.as_ref().map(|list| list[joint]);
            let (before, after) = (of(&changes.before, joint), of(&changes.after, joint));
            JointFacts {
                floor_of_mean: floor,
                lack_of_fit: BeforeAfter { before: both.map(|f| f[0]), after: both.map(|f| f[1]) },
                unmodelled: BeforeAfter { before, after },
                threshold: floor,
                adequacy: before.zip(after).map(|(b, a)| 1.0 - (a / b.max(f64::MIN_POSITIVE)).powi(2)),
                ..JointFacts::default()
            }
        };
        (0..changes.before.len()).map(fact).collect()
    }

    fn scores(&self) -> Vec<Score> {
        let chosen = |spec: &plumbline_model::term::effect::Spec| {
            let same = |k: &&usize| {
                (self.changes.effects[**k].spec.family, self.changes.effects[**k].spec.site) == (spec.family, spec.site)
            };
            self.kept.iter().any(|k| same(&k))
        };
        let score = |one: &plumbline_diagnose::Scored| Score {
            label: label(one.item.spec.family, one.item.spec.site),
            score: one.score,
            chosen: chosen(&one.item.spec),
            equivalent: false,
        };
        self.changes.first.iter().take(LISTED).map(score).collect()
    }
}

/// An effect as the report has it. `stored` is the model that it changes, `declared` how the base is said to be mounted.
pub fn effect(change: &Change, stored: &TorqueModel, declared: Option<&Mounting>, in_model: bool) -> Effect {
    let (spec, found) = (&change.spec, &change.found);
    let form = family(spec.family).and_then(|family| Some((family, family.form(spec.form)?)));
    let quantity =
        |own: Quantity| EffectParameter { name: own.name, value: own.value, std: own.std, unit: own.unit.into() };
    let mut parameters: Vec<EffectParameter> =
        change.quantities(stored.parameters(), declared).into_iter().map(quantity).collect();
    if let Some((_, form)) = form {
        parameters.extend(form.settings.iter().zip(&spec.settings).map(|(setting, &value)| EffectParameter {
            name: setting.name.into(),
            value,
            std: None,
            unit: setting.unit.into(),
        }));
    }
    let largest = |values: &[f64]| values.iter().copied().reduce(f64::max);
    let (alternatives, alternatives_detail) = alternatives(spec.family, &found.rivals);
    Effect {
        id: spec.family.into(),
        joints: joints(spec.site),
        since_session: change.since,
        parameters: Parameters(parameters),
        evidence: Some(found.score),
        delta_log_likelihood: Some(0.5 * found.evidence),
        penalty: Some(found.penalty),
        folds: Folds { positive: found.folds.positive, informative: found.folds.informative },
        idf: Some(found.independence),
        torque_rms: largest(&found.relevance.rms),
        explained_share: largest(&found.relevance.share),
        alternatives,
        alternatives_detail,
        confirmed: found.folds.confirm() == Some(true),
        stratum: Occurrence::Reference,
        in_model,
        equation: form.map_or(String::new(), |(_, form)| form.equation.into()),
        physics: form.map_or(String::new(), |(family, _)| family.physics.into()),
        ..Effect::default()
    }
}

/// An effect in one line, with its first quantities: `payload (mass 0.7310 +- 0.0040 kg, com_x ...)`.
pub fn line(change: &Change) -> String {
    let number = |own: &Quantity| match own.std {
        Some(std) => format!("{} {:.4} +- {std:.4} {}", own.name, own.value, own.unit),
        None => format!("{} {:.4} {}", own.name, own.value, own.unit),
    };
    let each: Vec<String> = change.quantities(&[], None).iter().take(QUANTITIES).map(number).collect();
    format!("{} ({})", change.spec, each.join(", "))
}

pub(super) fn label(id: &str, site: Site) -> String {
    match site {
        Site::Arm => id.to_string(),
        site => format!("{id} in {site}"),
    }
}

pub(super) fn joints(site: Site) -> Vec<usize> {
    site.joints().into_iter().map(|joint| joint + 1).collect()
}

fn unexplained((joint, facts): (usize, &JointFacts)) -> Option<Unexplained> {
    let lacking = facts.lack_of_fit.after.is_some_and(|ratio| ratio > LACKING);
    lacking.then(|| Unexplained {
        joint: joint + 1,
        rms: facts.unmodelled.after,
        floor: facts.floor_of_mean,
        deciding_experiment: "`plumbline diagnose` on the same data".into(),
        ..Unexplained::default()
    })
}

fn least((id, rms): &(&'static str, Vec<f64>)) -> (String, MinimumDetectable) {
    (
        (*id).to_string(),
        MinimumDetectable {
            torque_rms: rms.iter().map(|rms| if rms.is_finite() { *rms } else { f64::NAN }).collect(),
            ..MinimumDetectable::default()
        },
    )
}

fn path(changes: &Changes) -> Vec<diagnosis::Step> {
    let total = |list: &[f64]| list.iter().map(|value| value * value).sum::<f64>().sqrt();
    steps("the stored model", total(&changes.before), &changes.path)
}

/// How a search went, from a model that left so much unmodelled \[Nm\].
pub(super) fn steps(from: &str, unmodelled: f64, path: &[plumbline_diagnose::Step]) -> Vec<diagnosis::Step> {
    let start = diagnosis::Step { action: Action::Start, what: from.into(), unmodelled: Some(unmodelled), score: None };
    let step = |step: &plumbline_diagnose::Step| diagnosis::Step {
        action: if step.added { Action::Added } else { Action::Removed },
        what: label(step.item.spec.family, step.item.spec.site),
        unmodelled: Some(step.unmodelled.sqrt()),
        score: Some(step.score),
    };
    [start].into_iter().chain(path.iter().map(step)).collect()
}

/// What might be there instead of an effect of family `id`: the families, each once, and every rival with the experiment that decides.
pub(super) fn alternatives(id: &str, rivals: &[plumbline_diagnose::Rival]) -> (Vec<String>, Vec<Alternative>) {
    let confounded = family(id).map_or(&[][..], |family| family.confounded);
    let decided = |other: &str| confounded.iter().find(|one| one.with == other).map(|one| one.decided_by.to_string());
    let mut ids: Vec<String> = Vec::new();
    for rival in rivals {
        if !ids.iter().any(|known| known == rival.item.spec.family) {
            ids.push(rival.item.spec.family.into());
        }
    }
    let detail = |rival: &plumbline_diagnose::Rival| Alternative {
        id: rival.item.spec.family.into(),
        joints: joints(rival.item.spec.site),
        score_gap: Some(rival.gap),
        deciding_experiment: decided(rival.item.spec.family).unwrap_or_default(),
    };
    (ids, rivals.iter().map(detail).collect())
}
