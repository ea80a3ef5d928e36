//! One effect as it stands in `report.json`.

use plumbline_model::term::effect::{Quantity, Stratum, family};
use plumbline_model::term::{friction_change, friction_drift};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};
use std::fmt;

/// An effect that was found, with its evidence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Effect {
    /// Stable identity: `presliding`.
    pub id: String,
    /// Joints that it sits in, from 1; the joint whose torque it is first; of a contact the link that is touched. Empty for the arm as
    /// a whole.
    pub joints: Vec<usize>,
    /// What it is called in texts; made of `id` and `joints` where empty.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub label: String,
    /// Its parameters, linear and nonlinear.
    #[serde(flatten)]
    pub parameters: Parameters,
    /// Evidence for it, the score of the extended Bayesian information criterion: `2 delta_log_likelihood - penalty`.
    pub evidence: Option<f64>,
    /// Gain in log likelihood \[nat\].
    #[serde(default)]
    pub delta_log_likelihood: Option<f64>,
    /// What its parameters and the number of candidates cost, twice nats.
    #[serde(default)]
    pub penalty: Option<f64>,
    /// Whether it holds in trajectories that were left out.
    #[serde(default)]
    pub folds: Folds,
    /// Share of its torque's power that the base parameters can't absorb, 0 to 1.
    #[serde(default)]
    pub idf: Option<f64>,
    /// RMS of its torque in the joint where that is largest \[Nm\].
    #[serde(default)]
    pub torque_rms: Option<f64>,
    /// Share of the unmodelled power that it explains in the joint where that is largest, 0 to 1; of what differs between the periods
    /// where it changes from period to period.
    pub explained_share: Option<f64>,
    /// Share of its joint's unmodelled power that all effects together explain, 0 to 1.
    #[serde(default)]
    pub adequacy: Option<f64>,
    /// Ids of the effects that this data can't tell from it.
    pub alternatives: Vec<String>,
    /// The same with what would decide.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub alternatives_detail: Vec<Alternative>,
    /// Whether it held across trajectories.
    #[serde(default)]
    pub confirmed: bool,
    /// Where in the data it shows.
    #[serde(default)]
    pub stratum: Stratum,
    /// First session that has it; absent where all have.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub since_session: Option<u32>,
    /// Where in the recording it acts; absent where it acts in all of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub acts: Option<Acts>,
    /// Whether the delivered model has it; otherwise it is reported alone.
    #[serde(default)]
    pub in_model: bool,
    /// Why the delivered model has not.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub withheld: Option<String>,
    /// Name of its form; empty where the effect has one.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub form: String,
    /// Its columns: `tau_j = fp_j z, ...`.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub equation: String,
    /// What happens, in one sentence.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub physics: String,
}

/// A part of the recording in which an effect acts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Acts {
    /// Name of the run in which it begins.
    pub run: String,
    /// Its begin, since the first sample of that run \[s\].
    pub from: f64,
    /// Whether it stays for all runs after; otherwise it ends with the run.
    pub to_end_of_recording: bool,
}

impl fmt::Display for Acts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Acts { run, from, to_end_of_recording } = self;
        match (*from > 0.0, to_end_of_recording) {
            (true, true) => write!(f, "since {from:.1} s of {run}"),
            (true, false) => write!(f, "from {from:.1} s of {run} to its end"),
            (false, true) => write!(f, "since {run}"),
            (false, false) => write!(f, "in {run}"),
        }
    }
}

/// Trajectories that were left out in turn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Folds {
    /// In how many the effect lowers the error.
    pub positive: usize,
    /// How many excite it enough to say.
    pub informative: usize,
}

/// An effect that explains the data about as well.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Alternative {
    /// Its id.
    pub id: String,
    /// Its joints, from 1.
    #[serde(default)]
    pub joints: Vec<usize>,
    /// How much lower its score is.
    #[serde(default)]
    pub score_gap: Option<f64>,
    /// The experiment that tells the two apart.
    #[serde(default)]
    pub deciding_experiment: String,
}

/// Parameters of an effect in their own order. In the file they are three objects by name: `parameters`, `std` and `units`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(from = "Maps", into = "Maps")]
pub struct Parameters(pub Vec<Quantity>);

#[derive(Serialize, Deserialize)]
struct Maps {
    parameters: Map<String, Value>,
    #[serde(default)]
    std: Map<String, Value>,
    #[serde(default)]
    units: Map<String, Value>,
}

impl From<Parameters> for Maps {
    fn from(Parameters(list): Parameters) -> Maps {
        let map = |of: fn(&Quantity) -> Value| list.iter().map(|p| (p.name.clone(), of(p))).collect();
        Maps { parameters: map(|p| p.value.into()), std: map(|p| p.std.into()), units: map(|p| p.unit.clone().into()) }
    }
}

impl From<Maps> for Parameters {
    fn from(Maps { parameters, std, units }: Maps) -> Parameters {
        let number = |map: &Map<String, Value>, name: &str| map.get(name).and_then(Value::as_f64);
        let each = |name: &String| Quantity {
            name: name.clone(),
            value: number(&parameters, name).unwrap_or(f64::NAN),
            std: number(&std, name),
            unit: units.get(name).and_then(Value::as_str).unwrap_or_default().to_string(),
        };
        Parameters(parameters.keys().map(each).collect())
    }
}

impl Effect {
    /// What the catalogue has of a form of an effect; the caller adds what was found.
    pub fn of(id: &str, form: &str) -> Effect {
        let family = family(id);
        let written = family.and_then(|family| family.form(form));
        Effect {
            id: id.into(),
            form: form.into(),
            stratum: family.map_or(Stratum::default(), |family| family.stratum),
            equation: written.map_or(String::new(), |form| form.equation.into()),
            physics: family.map_or(String::new(), |family| family.physics.into()),
            ..Effect::default()
        }
    }

    /// Whether another effect, between two runs or sessions, is of the same cause: friction that drifts within a run goes on after it.
    pub fn goes_on_as(&self, other: &Effect) -> bool {
        let drifts = self.id == friction_drift::ID && [friction_drift::ID, friction_change::ID].contains(&&*other.id);
        drifts && self.joints == other.joints
    }

    /// Takes over the parameters of an effect that is of the same cause; `since` tells them from its own.
    pub fn take_over(&mut self, other: Effect, since: &str) {
        let named = |one: Quantity| Quantity { name: format!("{} {since}", one.name), ..one };
        self.parameters.0.extend(other.parameters.0.into_iter().map(named));
    }

    /// Whether the delivered model has it, or was identified without what it does in a part of the recording.
    pub fn counts(&self) -> bool {
        self.in_model || self.acts.is_some()
    }

    /// Identity and joints: `presliding in joint 4`.
    pub fn place(&self) -> String {
        let place = match self.joints[..] {
            [] => self.id.clone(),
            [joint] => format!("{} in joint {joint}", self.id),
            [row, cause, ..] => format!("{} in joint {row} from joint {cause}", self.id),
        };
        match &self.acts {
            Some(acts) => format!("{place} {acts}"),
            None => place,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn friction_that_drifts_goes_on_as_a_change_of_the_same_joint() {
        let change = |joint: usize| Effect {
            joints: vec![joint],
            parameters: Parameters(vec![Quantity::new("dfc6", -0.01, "Nm")]),
            ..Effect::of(friction_change::ID, "")
        };
        let mut drift = Effect {
            joints: vec![6],
            parameters: Parameters(vec![Quantity::new("fc", -0.05, "Nm")]),
            ..Effect::of(friction_drift::ID, "")
        };
        assert!(drift.goes_on_as(&change(6)) && !drift.goes_on_as(&change(5)) && !change(6).goes_on_as(&drift));
        drift.take_over(change(6), "since session 2");
        let names: Vec<&str> = drift.parameters.0.iter().map(|one| one.name.as_str()).collect();
        assert_eq!(names, ["fc", "dfc6 since session 2"]);
    }
}
