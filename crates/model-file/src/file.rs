//! `model.toml`: an identified model with its uncertainty, validation and provenance.

use super::{consistent, uncertainty};
use plumbline_core::{BadInput, from_toml};
use plumbline_identify::TorqueUncertainty;
use plumbline_identify::consistency::Nearest;
use plumbline_model::{BaseKind, Chain, Mounting, NamedEffect, NamedTerm, TorqueModel};
use serde::Deserialize;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::path::Path;

/// An identified model, and what is known of it.
#[derive(Clone, Debug)]
pub struct ModelFile {
    /// The model.
    pub model: TorqueModel,
    /// Noise floor of the measured torque, per joint \[Nm\]; empty where unknown.
    pub noise_floor: Vec<f64>,
    /// Errors on unseen runs.
    pub validation: Vec<Validated>,
    /// Covariance of these parameters and residual of the identification. `None` where unknown: of parameters that were not identified here, and of a
    /// stored model with changes, whose errors depend on those of the stored parameters.
    pub uncertainty: Option<TorqueUncertainty>,
    /// Physically consistent bodies with these parameters, or the nearest ones; `None` if not computed.
    pub consistent: Option<Nearest>,
    /// Origin of the parameters.
    pub provenance: Provenance,
}

/// Errors of the model on an unseen run.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Validated {
    /// File of the run.
    pub run: String,
    /// Polar angle of gravity in that run \[rad\].
    pub rho: f64,
    /// Azimuth of gravity in that run \[rad\].
    pub phi: f64,
    /// RMS of measured minus modelled torque, per joint \[Nm\].
    pub rms: Vec<f64>,
}

/// Origin of a model's parameters.
#[derive(Clone, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields, default, rename_all = "kebab-case")]
pub struct Provenance {
    /// SHA-256 of the dataset's content.
    pub dataset: Option<String>,
    /// Version of plumbline that wrote the file.
    pub plumbline: Option<String>,
    /// Day of the identification.
    pub date: Option<String>,
    /// Source of parameters that were not identified by this program.
    pub source: Option<String>,
    /// Text of the robot's description, where it is not a built-in robot.
    pub robot_description: Option<String>,
}

/// Serialised form of `model.toml`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
struct Raw {
    format: u32,
    /// Checked against the text itself.
    #[serde(rename = "content")]
    _content: Option<String>,
    robot: String,
    kind: Kind,
    #[serde(default)]
    noise_floor: Vec<f64>,
    #[serde(rename = "mounting")]
    mountings: Vec<Angles>,
    #[serde(rename = "term")]
    terms: Vec<RawTerm>,
    #[serde(default)]
    validation: Vec<Validated>,
    uncertainty: Option<uncertainty::Raw>,
    consistent: Option<consistent::Raw>,
    #[serde(default)]
    provenance: Provenance,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Angles {
    rho: f64,
    phi: f64,
}

#[derive(Clone, Copy, Deserialize)]
enum Kind {
    #[serde(rename = "GBS")]
    Gbs,
    #[serde(rename = "VBS")]
    Vbs,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawTerm {
    id: String,
    #[serde(default)]
    form: String,
    joint: Option<usize>,
    cause: Option<usize>,
    other: Option<usize>,
    #[serde(default)]
    settings: BTreeMap<String, f64>,
    parameters: Vec<RawParameter>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RawParameter {
    name: String,
    value: f64,
    std: Option<f64>,
    unit: String,
    /// For people; the program derives them from the robot's geometry.
    #[serde(rename = "symbol")]
    _symbol: Option<String>,
    #[serde(rename = "expression")]
    _expression: Option<String>,
}

impl RawTerm {
    fn named(&self) -> NamedTerm {
        NamedTerm {
            id: self.id.clone(),
            effect: NamedEffect {
                form: self.form.clone(),
                joint: self.joint,
                cause: self.cause,
                other: self.other,
                settings: self.settings.iter().map(|(name, value)| (name.clone(), *value)).collect(),
            },
            parameters: self.parameters.iter().map(|own| (own.name.clone(), own.value, own.std)).collect(),
        }
    }
}

pub(super) const FORMAT: u32 = 1;

impl ModelFile {
    /// Parses a model; `file` is the name in errors. `chain_of` returns the kinematic chain of a robot's name.
    /// Errors: a text that is not what was written (a file that was edited or cut off, by the hash in its `content`; a file without one was
    /// written by hand and is taken), an unknown key, another format version, a parameter that is missing, foreign, doubled, not finite or in another unit, a number
    /// of values that doesn't fit the arm; whatever `chain_of` says about the robot.
    pub fn parse(
        file: &str,
        text: &str,
        chain_of: impl FnOnce(&str) -> Result<Chain, BadInput>,
    ) -> Result<ModelFile, BadInput> {
        ModelFile::parse_described(file, text, |name, _| chain_of(name))
    }

    /// As [`ModelFile::parse`]; `chain_of` gets the description that the file holds, too.
    pub fn parse_described(
        file: &str,
        text: &str,
        chain_of: impl FnOnce(&str, Option<&str>) -> Result<Chain, BadInput>,
    ) -> Result<ModelFile, BadInput> {
        // The version is checked first, so that another format gets a clear error.
        let head: toml::Table = from_toml(file, text)?;
        if let Some(format) = head.get("format")
            && format.as_integer() != Some(i64::from(FORMAT))
        {
            return Err(BadInput::new(file, "key `format`", format, format!("{FORMAT}, the format of this program")));
        }
        let raw: Raw = from_toml(file, text)?;
        debug_assert_eq!(raw.format, FORMAT);
        let chain = chain_of(&raw.robot, raw.provenance.robot_description.as_deref())?;
        let n = chain.len();
        check_numbers(file, &raw, n)?;
        let kind = match raw.kind {
            Kind::Gbs => BaseKind::Gbs,
            Kind::Vbs => BaseKind::Vbs,
        };
        let mountings = raw.mountings.iter().map(|angles| Mounting { rho: angles.rho, phi: angles.phi }).collect();
        let terms: Vec<NamedTerm> = raw.terms.iter().map(RawTerm::named).collect();
        let model = TorqueModel::from_named(&raw.robot, chain, kind, mountings, &terms).map_err(|error| {
            let expected = format!("the parameters of the {kind} of robot `{}`", raw.robot);
            BadInput::new(file, "[[term]]", error, expected)
        })?;
        check_units(file, &raw, &model)?;
        let names: Vec<&str> =
            raw.terms.iter().flat_map(|term| &term.parameters).map(|own| own.name.as_str()).collect();
        let uncertainty = raw.uncertainty.as_ref().map(|raw| raw.check(file, &names, &model)).transpose()?;
        let consistent = raw.consistent.map(|raw| raw.check(file, &model)).transpose()?;
        // Checked last: other errors are more specific.
        check_content(file, text, &head)?;
        let Raw { noise_floor, validation, provenance, .. } = raw;
        Ok(ModelFile { model, noise_floor, validation, uncertainty, consistent, provenance })
    }

    /// Reads a file, as [`ModelFile::parse`].
    ///
    /// # Errors
    /// A file that can't be read, else those of [`ModelFile::parse`].
    pub fn load(path: &Path, chain_of: impl FnOnce(&str) -> Result<Chain, BadInput>) -> Result<ModelFile, BadInput> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|error| BadInput::new(&file, "file", error, "a readable model file"))?;
        ModelFile::parse(&file, &text, chain_of)
    }
}

const CONTENT: &str = "content = \"sha256:";

/// `text` with the hash of everything else in it, as its second line.
pub(super) fn sealed(text: &str) -> String {
    let (first, rest) = text.split_once('\n').unwrap_or((text, ""));
    format!("{first}\n{CONTENT}{}\"\n{rest}", content_hash(text))
}

/// SHA-256 of a text without the line that holds it, in hexadecimal.
fn content_hash(text: &str) -> String {
    let mut hash = Sha256::new();
    for line in text.split_inclusive('\n').filter(|line| !line.starts_with(CONTENT)) {
        hash.update(line.as_bytes());
    }
    hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}

fn check_content(file: &str, text: &str, head: &toml::Table) -> Result<(), BadInput> {
    let Some(written) = head.get("content") else { return Ok(()) };
    let found = format!("sha256:{}", content_hash(text));
    if written.as_str() == Some(&found) {
        return Ok(());
    }
    let expected =
        "the file as plumbline wrote it: it was edited or truncated (to use an edited model, remove this line)";
    Err(BadInput::new(file, "key `content`", written, expected))
}

/// Identity of a model file's text, as used by the loop; never 0.
pub fn model_identity(text: &str) -> u64 {
    let hash = Sha256::digest(text.as_bytes());
    let mut first = [0; 8];
    first.copy_from_slice(&hash[..8]);
    u64::from_be_bytes(first).max(1)
}

/// Every number is finite, standard deviations and errors are not negative, lists per joint have `n` entries.
fn check_numbers(file: &str, raw: &Raw, n: usize) -> Result<(), BadInput> {
    let bad =
        |key: String, value: f64, expected: &str| Err(BadInput::new(file, format!("key `{key}`"), value, expected));
    let per_joint = |key: String, values: &[f64]| {
        if values.len() != n {
            let found = format!("{} values", values.len());
            return Err(BadInput::new(file, format!("key `{key}`"), found, format!("{n}, one per joint")));
        }
        match values.iter().position(|value| !(value.is_finite() && *value >= 0.0)) {
            Some(j) => bad(format!("{key}[{j}]"), values[j], "a torque in Nm, 0 or more"),
            None => Ok(()),
        }
    };
    if !raw.noise_floor.is_empty() {
        per_joint("noise-floor".into(), &raw.noise_floor)?;
    }
    let angle = |key: String, rho: f64, phi: f64| match [rho, phi].into_iter().find(|angle| !angle.is_finite()) {
        Some(value) => bad(key, value, "angles in rad"),
        None => Ok(()),
    };
    for (index, angles) in raw.mountings.iter().enumerate() {
        angle(format!("mounting[{index}]"), angles.rho, angles.phi)?;
    }
    for (index, run) in raw.validation.iter().enumerate() {
        per_joint(format!("validation[{index}].rms"), &run.rms)?;
        angle(format!("validation[{index}]"), run.rho, run.phi)?;
    }
    for term in &raw.terms {
        for parameter in &term.parameters {
            if !parameter.value.is_finite() {
                return bad(format!("value of {}", parameter.name), parameter.value, "a finite number");
            }
            if let Some(std) = parameter.std
                && !(std.is_finite() && std >= 0.0)
            {
                return bad(format!("std of {}", parameter.name), std, "a standard deviation, 0 or more");
            }
        }
    }
    Ok(())
}

/// A number in another unit is another number.
fn check_units(file: &str, raw: &Raw, model: &TorqueModel) -> Result<(), BadInput> {
    for written in raw.terms.iter().flat_map(|term| &term.parameters) {
        let known = model.parameters().iter().find(|known| known.column.name == written.name);
        if let Some(known) = known
            && known.column.unit != written.unit
        {
            let found = format!("`{}`", written.unit);
            return Err(BadInput::new(file, format!("key `unit of {}`", written.name), found, known.column.unit));
        }
    }
    Ok(())
}
