//! What a diagnosis came to in a word, and what its findings could be tested on.

use super::Effect;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Outcome of a diagnosis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// No joint has a residual that its noise does not explain.
    NothingSignificant,
    /// The same in the identified runs, but an unseen run has one that only the errors of the parameters explain: the runs do not determine the model.
    NotDetermined,
    /// The effects that were found explain the residual, each without a rival.
    Diagnosed,
    /// They explain it, but this data can't tell some of them from an alternative.
    Ambiguous,
    /// They explain it in some joints, or a part of it.
    Partly,
    /// The residual is real and none of the known effects explains it.
    #[default]
    Unexplained,
}

impl Verdict {
    /// Of effects that explain all: whether one of them has a rival.
    pub fn of_all<'e>(effects: impl IntoIterator<Item = &'e Effect>) -> Verdict {
        let rivals = effects.into_iter().any(|effect| !effect.alternatives.is_empty());
        if rivals { Verdict::Ambiguous } else { Verdict::Diagnosed }
    }

    /// Its name in files.
    pub fn id(self) -> &'static str {
        match self {
            Verdict::NothingSignificant => "nothing-significant",
            Verdict::NotDetermined => "not-determined",
            Verdict::Diagnosed => "diagnosed",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Partly => "partly",
            Verdict::Unexplained => "unexplained",
        }
    }
}

impl fmt::Display for Verdict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Verdict::NothingSignificant => "nothing significant",
            Verdict::NotDetermined => "not determined",
            Verdict::Diagnosed => "diagnosed",
            Verdict::Ambiguous => "ambiguous",
            Verdict::Partly => "partly explained",
            Verdict::Unexplained => "unexplained",
        })
    }
}

/// What findings could be tested on. In files it is the text of its `Display`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Confirmation {
    /// Several trajectories, and repeats that tell the noise.
    Full {
        /// Trajectories.
        trajectories: usize,
    },
    /// Repeats, but one trajectory: no finding could be tested on another.
    OneTrajectory,
    /// No repeats: the noise is unknown, and blocks of the runs are the folds.
    NoRepeats,
}

impl fmt::Display for Confirmation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Confirmation::Full { trajectories } => write!(f, "confirmed across {trajectories} trajectories"),
            Confirmation::OneTrajectory => f.write_str("one trajectory"),
            Confirmation::NoRepeats => f.write_str("no repeats"),
        }
    }
}

impl From<Confirmation> for String {
    fn from(confirmation: Confirmation) -> String {
        confirmation.to_string()
    }
}

impl TryFrom<String> for Confirmation {
    type Error = String;

    fn try_from(text: String) -> Result<Confirmation, String> {
        let trajectories = text.strip_prefix("confirmed across ").and_then(|rest| rest.strip_suffix(" trajectories"));
        match (text.as_str(), trajectories.and_then(|count| count.parse().ok())) {
            (_, Some(trajectories)) => Ok(Confirmation::Full { trajectories }),
            ("one trajectory", _) => Ok(Confirmation::OneTrajectory),
            ("no repeats", _) => Ok(Confirmation::NoRepeats),
            _ => Err(format!("`{text}`: expected confirmed across N trajectories, one trajectory, or no repeats")),
        }
    }
}
