//! `dataset.toml`: format and reading of a dataset.

use super::layout::Torque;
use super::{Dataset, Format, Run, file};
use plumbline_core::{BadInput, from_toml, parallel, threads};
use plumbline_model::Mounting;
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::{Component, Path};

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// Parameters are fitted to it.
    Identify,
    Validate,
}

/// Serialised form of `dataset.toml`.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub(super) struct Manifest {
    pub name: String,
    pub robot: String,
    #[serde(default, skip_serializing_if = "toml::Table::is_empty")]
    pub source: toml::Table,
    pub mounting: GravityAngles,
    #[serde(default)]
    pub torque: TorqueUnit,
    #[serde(rename = "run")]
    pub runs: Vec<RunEntry>,
}

/// Direction of the gravitational acceleration in the base frame \[rad\].
#[derive(Clone, Copy, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct GravityAngles {
    pub rho: f64,
    pub phi: f64,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub(super) struct TorqueUnit {
    pub unit: Unit,
    /// Nm per ampere, one per joint.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<Vec<f64>>,
}

impl Default for TorqueUnit {
    fn default() -> TorqueUnit {
        TorqueUnit { unit: Unit::NewtonMetre, gain: None }
    }
}

#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub(super) enum Unit {
    #[serde(rename = "Nm")]
    NewtonMetre,
    #[serde(rename = "A")]
    Ampere,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub(super) struct RunEntry {
    pub file: String,
    pub role: Role,
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub note: String,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub period: Option<f64>,
    #[serde(default = "reference_session", skip_serializing_if = "is_reference_session")]
    pub session: u32,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<f64>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mounting: Option<GravityAngles>,
}

fn reference_session() -> u32 {
    1
}

fn is_reference_session(session: &u32) -> bool {
    *session == reference_session()
}

/// Times that are nearer than this are one \[s\].
pub(super) const SAME_TIME_S: f64 = 1e-6;

/// The name of the description in a dataset's folder.
pub(super) const FILE: &str = "dataset.toml";

/// Reads `dir/dataset.toml` and every run that it names.
pub(super) fn read(dir: &Path) -> Result<Dataset, BadInput> {
    let path = dir.join(FILE);
    let file = path.display().to_string();
    let text = fs::read_to_string(&path)
        .map_err(|error| BadInput::new(&file, "file", error, "a readable dataset description"))?;
    let manifest: Manifest = from_toml(&file, &text)?;
    if manifest.runs.is_empty() {
        return Err(BadInput::new(&file, "key `run`", "no run", "at least one [[run]]"));
    }
    let mounting = mounting(&file, "mounting", manifest.mounting)?;
    let mut runs: Vec<Run> = Vec::with_capacity(manifest.runs.len());
    let entries: Vec<(usize, &RunEntry)> = manifest.runs.iter().enumerate().collect();
    let read = parallel(&entries, threads(), |(index, entry)| read_run(dir, &file, *index, entry, mounting));
    for (index, run) in read.into_iter().enumerate() {
        let run = run?;
        if let Some(first) = runs.first()
            && first.joints() != run.joints()
        {
            let expected = format!("q1..q{}, the joints of {}", first.joints(), first.data.name);
            let place = dir.join(&run.data.name).display().to_string();
            let columns_q = format!("{}, columns q", Format::of(&run.data.name).header());
            return Err(BadInput::new(place, columns_q, format!("q1..q{}", run.joints()), expected));
        }
        if runs.iter().any(|other| other.data.name == run.data.name) {
            return Err(BadInput::new(
                &file,
                format!("key `run[{index}].file`"),
                &run.data.name,
                "a file named only once",
            ));
        }
        let end = runs.last().map_or(0.0, Run::end);
        let start = manifest.runs[index].start.unwrap_or(end);
        if !(start.is_finite() && start >= end - SAME_TIME_S) {
            let expected = format!("a time in s, {end:.3} or later, where the run before ends");
            return Err(BadInput::new(&file, format!("key `run[{index}].start`"), start, expected));
        }
        runs.push(Run { start, ..run });
    }
    let n = runs[0].joints();
    if let Some(gain) = gain(&file, &manifest.torque, n)? {
        for run in &mut runs {
            for (mut column, &gain) in run.data.tau.column_iter_mut().zip(&gain) {
                column *= gain;
            }
        }
    }
    Ok(Dataset { name: manifest.name, robot: manifest.robot, mounting, source: manifest.source, runs })
}

fn read_run(dir: &Path, file: &str, index: usize, entry: &RunEntry, shared: Mounting) -> Result<Run, BadInput> {
    let key = |name: &str| format!("key `run[{index}].{name}`");
    // Runs outside the dataset's folder are refused, because a dataset is untrusted input.
    if !Path::new(&entry.file).components().all(|part| matches!(part, Component::Normal(_))) || entry.file.is_empty() {
        return Err(BadInput::new(file, key("file"), format!("`{}`", entry.file), "a file in the dataset's folder"));
    }
    let mut columns = file::read_run(&dir.join(&entry.file), Torque::Required)?;
    if let Some(period) = entry.period {
        let length = columns.t[columns.t.len() - 1] - columns.t[0];
        if !(period > 0.0 && period <= length * 1.001 + 0.01) {
            let expected = format!("a period in s, above 0 and at most the run's length of {length:.3} s");
            return Err(BadInput::new(file, key("period"), period, expected));
        }
    }
    if entry.session == 0 {
        return Err(BadInput::new(file, key("session"), entry.session, "a number from 1"));
    }
    // A period is one of the stamps.
    if entry.period.is_none() {
        columns.take_times_of_sender(&entry.file);
    }
    let data = plumbline_identify::Run {
        name: entry.file.clone(),
        t: columns.t,
        q: columns.q,
        dq: columns.dq,
        tau: columns.tau,
        mounting: entry.mounting.map_or(Ok(shared), |own| mounting(file, &format!("run[{index}].mounting"), own))?,
        period: entry.period,
    };
    Ok(Run {
        data,
        role: entry.role,
        note: entry.note.clone(),
        session: entry.session,
        start: 0.0,
        extra: columns.extra,
    })
}

fn mounting(file: &str, key: &str, angles: GravityAngles) -> Result<Mounting, BadInput> {
    for (name, value) in [("rho", angles.rho), ("phi", angles.phi)] {
        // Larger numbers are probably degrees.
        if !(value.is_finite() && value.abs() <= 6.3) {
            return Err(BadInput::new(file, format!("key `{key}.{name}`"), value, "an angle in rad, at most one turn"));
        }
    }
    Ok(Mounting { rho: angles.rho, phi: angles.phi })
}

fn gain(file: &str, torque: &TorqueUnit, n: usize) -> Result<Option<Vec<f64>>, BadInput> {
    let key = "key `torque.gain`";
    match (torque.unit, &torque.gain) {
        (Unit::NewtonMetre, None) => Ok(None),
        (Unit::NewtonMetre, Some(_)) => {
            Err(BadInput::new(file, key, "a gain with unit = \"Nm\"", "no gain, or unit = \"A\""))
        }
        (Unit::Ampere, None) => Err(BadInput::new(file, key, "nothing", "a gain in Nm/A per joint, as unit = \"A\"")),
        (Unit::Ampere, Some(gain)) if gain.len() != n => {
            Err(BadInput::new(file, key, format!("{} values", gain.len()), format!("{n}, one per joint")))
        }
        (Unit::Ampere, Some(gain)) => match gain.iter().find(|value| !(value.is_finite() && **value != 0.0)) {
            Some(bad) => Err(BadInput::new(file, key, bad, "finite gains that are not 0")),
            None => Ok(Some(gain.clone())),
        },
    }
}
