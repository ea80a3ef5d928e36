//! From recorded runs to results: model, errors, diagnosis, comparison. Used by the offline commands and the estimator.

pub mod checks;
pub mod collector;
pub mod diagnosis;
pub mod drawn;
pub mod exchange;
pub mod excitation;
pub mod external;
pub mod next;
pub mod pipeline;
pub mod results;
pub mod sessions;
pub mod split;

use crate::date::today;
use crate::report::Condition;
use crate::store::Provenance;
use plumbline_model::{Conditions, Robot};

/// Two gravity directions closer than this are one mounting \[rad\].
pub const SAME_MOUNTING: f64 = 1e-3;

pub fn conditions_facts(conditions: &Conditions) -> Vec<Condition> {
    let fact = |definition: &str, with_friction, without_friction| Condition {
        definition: definition.to_string(),
        with_friction,
        without_friction,
    };
    vec![
        fact("raw", conditions.raw, conditions.raw_rigid),
        fact("column-equilibrated", conditions.equilibrated, conditions.equilibrated_rigid),
        fact("noise-weighted", conditions.weighted, conditions.weighted_rigid),
    ]
}

pub fn conditions_text(conditions: &Conditions) -> String {
    let one = |fact: Condition| {
        format!("{} {:.1} (rigid body alone {:.1})", fact.definition, fact.with_friction, fact.without_friction)
    };
    conditions_facts(conditions).into_iter().map(one).collect::<Vec<_>>().join(", ")
}

/// Where numbers of a `robot` that this program identified come from; `dataset` is the hash of the data's content, where it is known already.
pub fn provenance(robot: &Robot, dataset: Option<String>) -> Provenance {
    let plumbline = Some(env!("CARGO_PKG_VERSION").to_string());
    let robot_description = robot.description.clone();
    Provenance { dataset, plumbline, date: Some(today()), source: None, robot_description }
}
