//! What a diagnosis ends with, under the names that it has in `report.json`.
//!
//! Joints count from 1 here, as in everything that people read; elsewhere in this crate they count from 0. Lists "per joint" have one entry
//! per joint of the arm or are empty. A figure that could not be measured is NaN (`null` in the file) in a list and `None` by itself.

mod disagreement;
mod effect;
mod verdict;

pub use disagreement::Disagreement;
pub use effect::{Acts, Alternative, Effect, Folds, Parameters};
pub use plumbline_model::term::effect::{Quantity, Stratum};
pub use verdict::{Confirmation, Verdict};

use super::errors::{Band, Compared, Errors};
use super::lenient;
use plumbline_identify::solve::Identification;
use plumbline_model::Structure;
use plumbline_model::term::effect::Site;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Mean square of a residual over that of the noise above which a joint lacks something.
pub const LACK_OF_FIT_RATIO: f64 = 1.3;
/// Smallest share of a joint's unmodelled power that its effects explain, for the joint to count as explained.
const MIN_EXPLAINED_RATIO: f64 = 0.9;
/// Largest unmodelled RMS of an explained joint, in units of the noise of the mean period.
const MAX_LEFT_OVER_FLOOR_RATIO: f64 = 2.5;

/// Everything under `diagnosis` in `report.json`, under the names that it has there.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Diagnosis {
    /// Outcome.
    pub verdict: Verdict,
    /// What the findings could be tested on.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub confirmation: Option<Confirmation>,
    /// Effects that were found, the strongest evidence first.
    pub effects: Vec<Effect>,
    /// Effects that the selection found and that are withheld: physics or unseen runs contradict them, or unseen runs show too little of them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hints: Vec<Effect>,
    /// Errors of the model without them on runs that took no part in anything.
    pub before: Errors,
    /// The same with those that are in the delivered model.
    pub after: Errors,
    /// `after` minus `before`, with intervals of the paired difference; negative is better.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub change: Option<Errors>,
    /// What the errors and `noise_floor` are taken of.
    #[serde(default)]
    pub band: Band,
    /// Names of the runs that the errors are taken from.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub held_out_runs: Vec<String>,
    /// Noise per joint in that band: the least that the errors can be \[Nm\]; empty where nothing repeats.
    #[serde(deserialize_with = "lenient::numbers")]
    pub noise_floor: Vec<f64>,
    /// Joints with a residual that no effect explains.
    pub unexplained: Vec<Unexplained>,
    /// Learned terms for what stays unexplained; the verdict does not count them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub empirical: Vec<Empirical>,
    /// Unseen runs that the delivered model predicts worse than the runs it was identified from: something differs between them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub disagreements: Vec<Disagreement>,
    /// Unseen runs that it predicts worse than that, but no worse than the errors of its parameters explain.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub undetermined: Vec<Disagreement>,
    /// By effect id: the least that would have been seen, so that "nothing" is a number.
    pub minimum_detectable: BTreeMap<String, MinimumDetectable>,
    /// What the recorded runs leave open.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub open: Vec<Open>,
    /// Effects that this data can't tell from the base parameters.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_identifiable: Vec<NotIdentifiable>,
    /// What was found wrong with the data.
    #[serde(default)]
    pub quality: Quality,
    /// Facts about each joint; one entry per joint.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub joints: Vec<JointFacts>,
    /// How the model grew.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub path: Vec<Step>,
    /// The best candidates that were considered, highest score first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub scores: Vec<Score>,
    /// What changed between sessions, or since a model was identified.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub changes: Vec<Changes>,
    /// Remarks that the reader has to know.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
    /// The rules that it was made with, [`crate::RULES`].
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub rules: String,
}

/// A residual that no effect explains.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Unexplained {
    /// Joint, from 1.
    pub joint: usize,
    /// RMS of what is left over beyond the noise, of the mean period where the motion repeats \[Nm\].
    pub rms: Option<f64>,
    /// Noise of the same \[Nm\].
    #[serde(default)]
    pub floor: Option<f64>,
    /// What it depends on, the strongest first: `q2`, `dq4`, `t`; empty where no dependence was found.
    pub depends_on: Vec<String>,
    /// Share of its variance that a function of `depends_on` predicts in trajectories that were left out.
    #[serde(default)]
    pub r2: Option<f64>,
    /// The experiment that would tell more.
    pub deciding_experiment: String,
    /// What else is known: spectral lines, where and when it occurs.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

/// A learned term on what the named effects leave of a joint's torque.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Empirical {
    /// Joint, from 1.
    pub joint: usize,
    /// The variables that it follows: `q4`, `dq2`.
    pub variables: Vec<String>,
    /// Share of the square of what is left that it predicts in trajectories or blocks that were left out of its fit, R2.
    pub share: Option<f64>,
    /// RMS of the joint on the runs that errors are measured on, without and with it \[Nm\].
    pub rms: BeforeAfter,
    /// Largest torque that it has in any state \[Nm\].
    pub cap: Option<f64>,
    /// Whether the delivered model has it.
    pub in_model: bool,
    /// Why the delivered model has it not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub withheld: Option<String>,
    /// A simple law that takes nearly as much.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub symbolic: Option<Symbolic>,
}

/// A simple law of one variable.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Symbolic {
    /// The law, with its parameters by name: `a sin(3 q4 + phi)`.
    pub law: String,
    /// Its parameters.
    #[serde(flatten)]
    pub parameters: Parameters,
    /// Share of what the learned term takes that it takes.
    pub share: Option<f64>,
}

/// The least of one kind of effect that would have been seen.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MinimumDetectable {
    /// RMS of its torque in each joint \[Nm\]; NaN where it can't be seen at any size.
    #[serde(deserialize_with = "lenient::numbers")]
    pub torque_rms: Vec<f64>,
    /// Its parameter in each joint, in `unit`.
    #[serde(default, deserialize_with = "lenient::numbers", skip_serializing_if = "Vec::is_empty")]
    pub parameter: Vec<f64>,
    /// Name of that parameter.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub name: String,
    /// Unit of that parameter.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub unit: String,
}

/// A question that the recorded runs leave open.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Open {
    /// What is asked: `presliding in joint 4, or stribeck in joint 4`.
    pub question: String,
    /// What `now`, `wanted` and `expected` are.
    pub kind: OpenKind,
    /// From the recorded runs.
    pub now: f64,
    /// What answers the question.
    pub wanted: f64,
    /// To expect once the planned motion was driven, too.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub expected: Option<f64>,
}

/// Kind of an open question, and what is measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum OpenKind {
    /// Which of two effects acts: score difference, more is better.
    Rivals,
    /// A parameter's interval is wider than wanted: half width of the 95 % interval, less is better.
    Interval,
    /// What stays unexplained or undetermined: standard deviations of the model's parameters, as a ratio to those of the recorded runs, less is
    /// better.
    #[default]
    Parameters,
}

/// An effect that the base parameters absorb.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct NotIdentifiable {
    /// Effect id.
    pub effect: String,
    /// Joints, from 1; empty for the arm as a whole.
    pub joints: Vec<usize>,
    /// Why: what absorbs it.
    pub why: String,
}

/// What was found wrong with the data before anything was fitted.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Quality {
    /// Samples that were masked because they stand out and don't repeat.
    pub outliers: Option<u64>,
    /// Rows whose time stamp is that of the row before.
    pub repeated_stamps: Option<u64>,
    /// Longest step between time stamps \[s\].
    pub longest_gap: Option<f64>,
    /// Samples at the limit of their sensor, per joint.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub saturated: Vec<u64>,
    /// Smallest spacing of the torque's values, per joint \[Nm\]; zero where they are continuous.
    #[serde(deserialize_with = "lenient::numbers", skip_serializing_if = "Vec::is_empty")]
    pub quantum: Vec<f64>,
    /// Anything else, in words.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// A figure without and with the effects.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct BeforeAfter {
    /// Without.
    pub before: Option<f64>,
    /// With.
    pub after: Option<f64>,
}

/// What the repeatable part of one joint's residual is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct JointFacts {
    /// Noise of one sample in the band that is judged \[Nm\].
    pub noise: Option<f64>,
    /// Noise of the mean period in that band \[Nm\].
    pub floor_of_mean: Option<f64>,
    /// Lack of fit: power of the residual's mean period over what noise alone would leave there; 1 where the model lacks nothing.
    pub lack_of_fit: BeforeAfter,
    /// RMS of the residual's mean period in that band \[Nm\].
    pub rms: BeforeAfter,
    /// RMS of the residual's mean period beyond its noise \[Nm\].
    pub unmodelled: BeforeAfter,
    /// The least `unmodelled` that counts \[Nm\].
    pub threshold: Option<f64>,
    /// Share of the unmodelled power that the effects explain.
    pub adequacy: Option<f64>,
    /// RMS of the residual on trajectories, or blocks of motions that do not repeat, left out of the fit in turn \[Nm\].
    #[serde(default)]
    pub left_out: BeforeAfter,
}

/// What a step of the search did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Action {
    /// Began with the model as it was.
    #[default]
    Start,
    /// Took an effect in.
    Added,
    /// Took one out again.
    Removed,
}

/// One step of the search.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// What happened.
    pub action: Action,
    /// To which effect: `presliding in joint 4`.
    pub what: String,
    /// Unmodelled RMS afterwards, root of the sum of squares over the joints \[Nm\].
    pub unmodelled: Option<f64>,
    /// Score of the effect.
    #[serde(default)]
    pub score: Option<f64>,
}

/// A candidate that was considered.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Score {
    /// Effect and joint for people: `presliding in joint 4`.
    pub label: String,
    /// Its score: evidence for it beyond its penalty, twice nats.
    #[serde(deserialize_with = "lenient::number")]
    pub score: f64,
    /// Whether it was taken.
    #[serde(default)]
    pub chosen: bool,
    /// Whether this data can't tell it from the chosen one.
    #[serde(default)]
    pub equivalent: bool,
}

/// What changed since another session or model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Changes {
    /// The session or model that it is compared with.
    pub since: String,
    /// The session that is compared.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub session: String,
    /// What changed.
    pub effects: Vec<Effect>,
    /// Errors of that model on this session.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub before: Option<Errors>,
    /// The same with the changes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after: Option<Errors>,
    /// What the reader has to know: what can't be told apart.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
}

impl JointFacts {
    /// Whether the model lacks something there. Unknown noise says nothing.
    pub fn lacking(lack_of_fit: Option<f64>, unmodelled: Option<f64>, threshold: Option<f64>) -> bool {
        let above = unmodelled.zip(threshold).is_some_and(|(unmodelled, threshold)| unmodelled > threshold);
        lack_of_fit.is_some_and(|ratio| ratio > LACK_OF_FIT_RATIO) && above
    }

    /// The same facts after those of another model.
    pub(super) fn since(self, before: &JointFacts) -> JointFacts {
        let both = |before: BeforeAfter, after: BeforeAfter| BeforeAfter { before: before.before, ..after };
        JointFacts {
            rms: both(before.rms, self.rms),
            unmodelled: both(before.unmodelled, self.unmodelled),
            lack_of_fit: both(before.lack_of_fit, self.lack_of_fit),
            ..self
        }
    }

    /// [`JointFacts::lacking`] of the model without the effects.
    pub fn lacking_before(&self) -> bool {
        JointFacts::lacking(self.lack_of_fit.before, self.unmodelled.before, self.threshold)
    }

    /// [`JointFacts::lacking`] of the model with the effects.
    pub fn lacking_after(&self) -> bool {
        JointFacts::lacking(self.lack_of_fit.after, self.unmodelled.after, self.threshold)
    }

    /// Whether its effects explain it: a large share of what was unmodelled, with little left over.
    pub fn is_explained(&self) -> bool {
        let [floor, left] = [self.floor_of_mean, self.unmodelled.after];
        let little = floor.zip(left).is_some_and(|(floor, left)| left <= MAX_LEFT_OVER_FLOOR_RATIO * floor);
        little && self.adequacy.or(self.share()).is_some_and(|share| share >= MIN_EXPLAINED_RATIO)
    }

    /// Share in the identified runs. Unseen ones may have nothing to explain, as where a payload is picked up in the first run and stays.
    fn share(&self) -> Option<f64> {
        let counts = self.unmodelled.before > self.threshold;
        self.unmodelled.share_taken().filter(|_| counts)
    }
}

impl BeforeAfter {
    /// Both figures.
    pub fn both(figures: [f64; 2]) -> BeforeAfter {
        BeforeAfter { before: Some(figures[0]), after: Some(figures[1]) }
    }

    /// Share of the mean square that goes, where both are root mean squares.
    pub fn share_taken(self) -> Option<f64> {
        Some(1.0 - (self.after? / self.before?.max(f64::MIN_POSITIVE)).powi(2))
    }
}

impl Diagnosis {
    /// Whether the delivered model has effects or learned terms that the plain one has not.
    pub fn grows(&self) -> bool {
        self.effects.iter().any(|effect| effect.in_model) || self.empirical.iter().any(|term| term.in_model)
    }

    /// Takes those effects out of what was found between runs or sessions that are more of a drift found within one; `since` tells their parameters from its own.
    pub fn take_what_goes_on(&mut self, found: &mut Vec<Effect>, since: &str) {
        for drift in &mut self.effects {
            for effect in found.extract_if(.., |effect| drift.goes_on_as(effect)).collect::<Vec<_>>() {
                drift.take_over(effect, since);
            }
        }
    }

    /// Takes over errors on held-out runs.
    pub(super) fn set_errors(&mut self, compared: Compared) {
        self.before = compared.before;
        self.after = compared.after;
        self.noise_floor = compared.floor.unwrap_or_default();
    }
}

/// `joint 4`, `joints 4 and 5`; nothing for the arm as a whole.
pub fn places(joints: &[usize]) -> String {
    match joints {
        [] => String::new(),
        [joint] => format!("joint {joint}"),
        _ => format!("joints {}", listed(joints.iter().map(usize::to_string))),
    }
}

/// `a`, `a and b`, `a, b and c`.
pub fn listed(items: impl IntoIterator<Item = String>) -> String {
    let mut items: Vec<String> = items.into_iter().collect();
    match items.pop() {
        Some(last) if !items.is_empty() => format!("{} and {last}", items.join(", ")),
        last => last.unwrap_or_default(),
    }
}

/// Joints of a site, from 1.
pub(super) fn joints(site: Site) -> Vec<usize> {
    site.joints().into_iter().map(|joint| joint + 1).collect()
}

/// A model and how it came about.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// Its structure.
    pub structure: Structure,
    /// Its parameters.
    pub identification: Identification,
}

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_model::term::{friction_change, friction_drift};

    #[test]
    fn what_goes_on_is_more_of_the_drift_of_its_joint() {
        let of = |id: &str, joint: usize| Effect {
            joints: vec![joint],
            parameters: Parameters(vec![Quantity::new("dfc", -0.01, "Nm")]),
            ..Effect::of(id, "")
        };
        let effects = vec![of(friction_change::ID, 2), of(friction_drift::ID, 6)];
        let mut block = Diagnosis { effects, ..Diagnosis::default() };
        let mut found = vec![of(friction_change::ID, 2), of(friction_change::ID, 6)];
        block.take_what_goes_on(&mut found, "in later.csv");
        assert_eq!(found.iter().map(|effect| &effect.joints[..]).collect::<Vec<_>>(), [[2]], "nothing drifts there");
        let names = |effect: &Effect| effect.parameters.0.iter().map(|one| one.name.clone()).collect::<Vec<_>>();
        assert_eq!(block.effects.iter().map(names).collect::<Vec<_>>(), [vec!["dfc"], vec!["dfc", "dfc in later.csv"]]);
    }
}
