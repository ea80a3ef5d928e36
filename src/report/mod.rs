//! Report of a job: `report.json` and `report.html`.
//!
//! The report is plain data filled by the caller; no results are computed here.

mod arm;
mod chart;
pub mod compared;
mod consistency;
pub mod diagnosis;
pub mod figures;
mod gravity;
mod html;
mod loop_tables;
mod model_plots;
mod plot;
pub mod provenance;
pub mod robot;
mod summary;
pub mod table;
mod timing;

pub use consistency::{Consistency, Moved};
pub use diagnosis::Diagnosis;
pub use figures::Figures;
pub use gravity::{GravityReport, RunGravity};
pub use plumbline_diagnose::errors::Band;
pub use timing::{IpcReport, LoopReport};

use crate::atomic;
use crate::failure::Failure;
use plumbline_excite::{Plan, PlanSearch, PlanUsage};
use plumbline_identify::check::Finding;
use plumbline_ipc::GuestCounts;
use plumbline_model::{Mounting, Parameter, TorqueModel};
use serde::{Deserialize, Deserializer, Serialize};
use std::io;
use std::path::Path;

/// Content of `report.json`. Torques in Nm, one entry per joint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Report {
    pub robot: String,
    pub mounting: MountingFacts,
    pub base: Base,
    pub identify: Fit,
    pub validate: Vec<Validation>,
    /// Frequency band in which errors are judged: `rms_raw` or `rms_filtered` of `validate` and `identify`.
    #[serde(default)]
    pub band: Band,
    /// Errors of the vertical base set in a mounting where it is not valid.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub counter_experiment: Option<CounterExperiment>,
    /// Noise of one raw sample of the measured torque, from the scatter between repetitions \[Nm\]; empty where no motion repeats. It
    /// is the lower bound of `rms_raw`.
    pub noise_floor: Vec<f64>,
    /// Checks of the data before it was fitted; empty for a job's own recordings.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub checks: Vec<Finding>,
    /// Diagnosis of the residual; absent if not requested.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub diagnosis: Option<Diagnosis>,
    /// The rounds before, each with what it left open; empty where the job has one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub rounds: Vec<Round>,
    /// Parameters and runs that this data does not determine.
    pub identifiability: Identifiability,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub conditions: Vec<Condition>,
    /// Use of the joints' limits by the job's motions, and how they were searched; empty for recorded data.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub motions: Vec<MotionUsage>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub estimator: Option<EstimatorFacts>,
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub consistency: Option<Consistency>,
    /// Readings of the inclinometer; absent without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gravity: Option<GravityReport>,
    /// Statistics of the real-time loop; absent for recorded data.
    #[serde(default, rename = "loop", skip_serializing_if = "Option::is_none")]
    pub control_loop: Option<LoopReport>,
    /// Counters of the states of an arm that another program controls; absent where plumbline drives the arm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guest: Option<GuestCounts>,
    /// Counters of the sample stream; absent for recorded data.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub ipc: Option<IpcReport>,
    /// Provenance: dataset hash, version, date, configuration.
    #[serde(default, skip_serializing_if = "serde_json::Map::is_empty")]
    pub provenance: serde_json::Map<String, serde_json::Value>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<String>,
}

/// What a round of a job ended with.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Round {
    pub verdict: diagnosis::Verdict,
    /// The findings, as in the report of that round.
    pub found: Vec<String>,
    /// What it left open, with what the motion of the next round was expected to answer.
    pub open: Vec<diagnosis::Open>,
    /// Errors on unseen runs, per joint \[Nm\].
    pub validate_rms: Vec<f64>,
}

impl Round {
    pub fn of(diagnosis: &Diagnosis) -> Round {
        Round {
            verdict: diagnosis.verdict,
            found: diagnosis.effects.iter().map(diagnosis::name).collect(),
            open: diagnosis.open.clone(),
            validate_rms: diagnosis.after.validate_rms.clone(),
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MountingFacts {
    /// Name, or both angles if it has no name.
    pub name: String,
    /// Polar angle of gravity \[rad\].
    pub rho: f64,
    /// Azimuth of gravity \[rad\].
    pub phi: f64,
}

impl From<Mounting> for MountingFacts {
    fn from(mounting: Mounting) -> MountingFacts {
        MountingFacts { name: mounting.to_string(), rho: mounting.rho, phi: mounting.phi }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Base {
    /// `GBS` or `VBS`.
    pub kind: String,
    /// Number of base parameters: those of rigid body, friction and the other terms of the whole arm. Effects are not among them.
    pub count: usize,
    #[serde(default)]
    pub effects: usize,
    /// Base parameters by term, in the order of the model.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub terms: Vec<TermCount>,
    /// All parameters, in the order of the model.
    pub parameters: Vec<ParameterFacts>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TermCount {
    /// `rigid-body`, `friction`, `torque-offset`, `rotor-inertia`.
    pub term: String,
    pub count: usize,
}

/// Shares of the joints' limits, less their margins, that a motion uses, one entry per joint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionUsage {
    pub motion: String,
    /// Distance between the highest and the lowest position, of the range.
    pub range: Vec<f64>,
    /// Highest speed, of the highest speed that the joint has anywhere.
    pub speed: Vec<f64>,
    /// Course of the search that found the motion; absent where none did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub search: Option<PlanSearch>,
}

impl MotionUsage {
    /// Of a planned motion; `None` where its plan does not have the use of the limits.
    pub fn of(motion: &str, plan: &Plan) -> Option<MotionUsage> {
        let PlanUsage { range, speed } = plan.usage.clone()?;
        Some(MotionUsage { motion: motion.to_string(), range, speed, search: plan.search.clone() })
    }
}

impl Base {
    /// The parameters of a model, counted by term.
    pub fn of(model: &TorqueModel) -> Base {
        let mut base = Base::new(model.kind(), model.parameters());
        for (term, parameters) in model.terms().into_iter().filter(|(_, parameters)| !parameters.is_empty()) {
            if term.spec().is_some() {
                base.effects += parameters.len();
            } else {
                base.terms.push(TermCount { term: term.id().to_string(), count: parameters.len() });
            }
        }
        base.count -= base.effects;
        base
    }

    /// With the 95 % confidence intervals of the parameters, from half their widths in the order of the model.
    pub fn with_intervals(mut self, half_widths: &[Option<f64>]) -> Base {
        for (parameter, half_width) in self.parameters.iter_mut().zip(half_widths) {
            let value = parameter.value;
            parameter.interval_95 = half_width
                .map(|half| [value - half, value + half])
                .filter(|ends| ends.iter().all(|end| end.is_finite()));
        }
        self
    }

    /// Parameters that are all base parameters; `kind` is `GBS` or `VBS`.
    pub fn new(kind: impl ToString, parameters: &[Parameter]) -> Base {
        let facts = |parameter: &Parameter| ParameterFacts {
            name: parameter.column.name.clone(),
            symbol: parameter.column.symbol.clone(),
            expression: parameter.column.expression.clone(),
            value: parameter.value,
            std: parameter.std,
            interval_95: None,
            unit: parameter.column.unit.to_string(),
        };
        let parameters: Vec<ParameterFacts> = parameters.iter().map(facts).collect();
        Base { kind: kind.to_string(), count: parameters.len(), parameters, ..Base::default() }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ParameterFacts {
    /// Name in ASCII.
    pub name: String,
    /// Symbol, with R where it is regrouped.
    pub symbol: String,
    pub expression: String,
    /// Value, in `unit`.
    pub value: f64,
    /// Standard deviation where known, in `unit`.
    pub std: Option<f64>,
    /// 95 % confidence interval where known, in `unit`: from, to.
    #[serde(default)]
    pub interval_95: Option<[f64; 2]>,
    pub unit: String,
}

/// Errors of the vertical base set in another mounting, where it is refused by default.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CounterExperiment {
    pub identified_in: MountingFacts,
    /// `VBS`.
    pub kind: String,
    pub count: usize,
    pub refused_in: MountingFacts,
    pub refusal: String,
    /// RMS over the unseen motions there, per joint, mean of the motions \[Nm\].
    pub forced_rms: Vec<f64>,
    /// The same for the generalized base set \[Nm\].
    pub general_rms: Vec<f64>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fit {
    /// RMS of measured minus modelled torque per joint, raw samples \[Nm\].
    pub rms_raw: Vec<f64>,
    /// The same after the low-pass \[Nm\].
    pub rms_filtered: Vec<f64>,
}

impl Fit {
    /// The RMS in the band in which a report judges \[Nm\].
    pub fn rms(&self, band: &Band) -> &Vec<f64> {
        in_band(band, &self.rms_raw, &self.rms_filtered)
    }
}

fn in_band<'r>(band: &Band, raw: &'r Vec<f64>, filtered: &'r Vec<f64>) -> &'r Vec<f64> {
    match band {
        Band::Raw => raw,
        Band::Filtered { .. } => filtered,
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Validation {
    pub run: String,
    /// RMS of measured minus predicted torque per joint, raw samples \[Nm\].
    pub rms_raw: Vec<f64>,
    /// The same after the low-pass \[Nm\].
    pub rms_filtered: Vec<f64>,
    /// RMS of measured torque minus the feed-forward that was served while the arm moved \[Nm\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub served_rms: Option<Vec<f64>>,
    pub mounting: MountingFacts,
}

impl Validation {
    /// The RMS in the band in which a report judges \[Nm\].
    pub fn rms(&self, band: &Band) -> &Vec<f64> {
        in_band(band, &self.rms_raw, &self.rms_filtered)
    }
}

/// Parameters and runs that the data does not determine.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Identifiability {
    /// Parameters that this data can't determine.
    pub not_identifiable: Vec<String>,
    /// Parameters that a motion that was not planned determines weakly: see [`crate::analysis::excitation`].
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub weakly_determined: Vec<String>,
    pub untrusted_runs: Vec<String>,
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Condition {
    /// Definition: `raw`, `column-equilibrated`, `noise-weighted`.
    pub definition: String,
    #[serde(deserialize_with = "number_or_infinity")]
    pub with_friction: f64,
    /// Of the rigid-body columns alone.
    #[serde(deserialize_with = "number_or_infinity")]
    pub without_friction: f64,
}

/// Writes infinity, for parameters that are not excited, as `null`.
fn number_or_infinity<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::INFINITY))
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EstimatorFacts {
    /// `ols`, `wls`, `wls-full`, `huber`, `tls` or `iv`.
    pub name: String,
    pub rounds: usize,
    pub settled: bool,
    /// Parameters restricted to zero because they are not significant.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub restricted: Vec<String>,
}

impl Report {
    /// Reads `report.json` of a folder.
    ///
    /// # Errors
    /// A file that can't be read or is no report, by its name.
    pub fn read(dir: &Path) -> Result<Report, Failure> {
        let path = dir.join("report.json");
        let failed = |error: &dyn std::fmt::Display| Failure::job(format!("{}: {error}", path.display()));
        let text = std::fs::read_to_string(&path).map_err(|error| failed(&error))?;
        serde_json::from_str(&text).map_err(|error| failed(&error))
    }

    /// The text of `report.json`.
    pub fn to_json(&self) -> serde_json::Result<String> {
        serde_json::to_string_pretty(self).map(|text| text + "\n")
    }

    /// The text of `report.html`, a self-contained file.
    pub fn to_html(&self, figures: &Figures) -> io::Result<String> {
        html::render(self, figures)
    }

    /// All that the report says, in lines: what `--verbose` prints.
    pub fn in_words(&self) -> Vec<String> {
        summary::lines(self)
    }

    /// The table at the end of a job: at most [`table::MAX_LINES`] lines of [`table::WIDTH`] columns.
    pub fn table(&self) -> table::Table {
        table::Table::of(self)
    }

    /// The diagnosis alone in a few lines; none without one.
    pub fn diagnosis_lines(&self) -> Vec<String> {
        self.diagnosis.as_ref().map_or(Vec::new(), diagnosis::lines)
    }

    /// Writes `report.json` and `report.html` into folder `dir`, each atomically.
    pub fn write(&self, dir: &Path, figures: &Figures) -> io::Result<()> {
        let html = self.to_html(figures)?;
        let json = self.to_json().map_err(io::Error::other)?;
        atomic::write_file(&dir.join("report.html"), html.as_bytes())?;
        atomic::write_file(&dir.join("report.json"), json.as_bytes())
    }
}
