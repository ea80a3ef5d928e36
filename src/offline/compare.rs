//! Comparison of recorded runs with a model: changes of the arm since.

use crate::analysis::split::find_and_judge;
use crate::analysis::{checks, diagnosis, pipeline};
use crate::dataset::{Dataset, Run};
use crate::failure::Failure;
use crate::offline::identify::recorded_data_settings;
use crate::process::progress;
use crate::report::figures::Figures;
use crate::report::provenance::add_origin;
use crate::report::{Band, Base, Identifiability, Report, Validation};
use crate::store::{ModelFile, Provenance, Validated};
use clap::Args;
use plumbline_core::{BadInput, threads};
use plumbline_diagnose::reference::{self, Comparison, Stored};
use plumbline_identify::{Experiment, Rms};
use plumbline_model::term::Term;
use plumbline_model::term::rigid_body::RigidBody;
use plumbline_model::{Reduction, Robot, TorqueModel};
use plumbline_model_file::models;
use std::path::{Path, PathBuf};

/// Options of [`compare`], in the words of `plumbline compare`.
#[derive(Args)]
pub struct Options {
    /// Model file that was identified before
    model: PathBuf,
    /// Folder with dataset.toml and one CSV file per run, recorded since
    dataset: PathBuf,
    /// Folder for report.html, report.json and model.toml
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Velocities of runs that do not repeat: measured (where the run has dq columns) or derived from the positions
    #[arg(long, default_value = "measured")]
    velocities: String,
    /// Time to leave out at both ends of runs that do not repeat, in s
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    trim: f64,
    /// Detection threshold in Nm: smallest RMS of an effect; by default 0.7 of the noise of the mean period
    #[arg(long, value_name = "NM")]
    threshold: Option<f64>,
}

impl Options {
    /// Folder of the results.
    pub fn out(&self) -> &Path {
        &self.out
    }

    /// Folder of the dataset.
    pub fn dataset(&self) -> &Path {
        &self.dataset
    }
}

/// Searches for changes, validates them on held-out runs and writes `model.toml`, `report.json` and `report.html`.
///
/// # Errors
/// Options and files that can't be used; a search that failed.
pub fn compare(options: &Options) -> Result<Report, Failure> {
    let dataset = Dataset::read(&options.dataset)?;
    let robot = Robot::load(&dataset.robot, Some(&options.dataset))?;
    dataset.expect_joints(robot.chain.len())?;
    let file = model_file(options, &robot)?;
    let settings = recorded_data_settings(&options.velocities, options.trim)?;
    let search = diagnose_settings(options)?;
    let model = &file.model;
    let covariance = file.uncertainty.as_ref().map(|known| &known.parameters.covariance);
    checks::is_folder(&options.out)?;
    pipeline::check_torques(&dataset.runs.iter().collect::<Vec<_>>())?;
    let findings = checks::checked(&options.dataset, &dataset, &robot)?;

    let (held, refused): (Vec<&Run>, Vec<&Run>) =
        dataset.runs.iter().partition(|run| model.valid_in(&run.data.mounting).is_ok());
    let mut notes = Vec::new();
    let (find, judge) = find_and_judge(&held, &mut notes);

    let bar = progress::bar("comparing");
    bar.busy("preparing the runs");
    let find: Vec<&Run> = find.iter().collect();
    pipeline::check_torques(&find)?;
    let experiments = pipeline::experiments_of(model, &find, &settings)?;
    let unseen = pipeline::experiments_of(model, &judge.iter().collect::<Vec<_>>(), &settings)?;
    let trials = diagnosis::trials(&experiments, &find);
    bar.busy("building candidates");
    let changes = reference::changes(model, covariance, &trials, &search, &diagnosis::search_on(&bar));
    bar.busy("testing what was found");
    let stored = Stored { model, changes: &changes.effects };
    let sessions: Vec<u32> = judge.iter().map(|run| run.session).collect();
    let unseen: Vec<(&Experiment, u32)> = unseen.iter().zip(sessions).collect();
    let kept = stored.held(&unseen).map_err(Failure::job)?;
    bar.done();

    let after = stored.with(&kept, u32::MAX).map_err(Failure::job)?;
    let errors_after = stored.errors(&kept, &unseen).map_err(Failure::job)?;
    let names: Vec<String> = judge.iter().map(|run| run.data.name.clone()).collect();
    let since = since(options, &file);
    let comparison = Comparison {
        changes: &changes,
        stored: model,
        kept: &kept,
        declared: find.first().map(|run| run.data.mounting),
        band: Band::Filtered { cutoff: settings.torque_cutoff },
        since: since.clone(),
        runs: names,
    };
    let mut diagnosis = comparison.diagnosis(&stored.compared(&kept, &unseen).map_err(Failure::job)?);
    let identifiability = identifiability(model, &refused, &changes.doubt);
    if held.is_empty() {
        notes.push(format!(
            "nothing was compared: the {} model is not valid in the mounting of any of these runs",
            model.kind()
        ));
    }
    diagnosis.notes.append(&mut notes);
    let mut report = Report {
        robot: robot.name.clone(),
        mounting: dataset.mounting.into(),
        base: Base::of(&after),
        validate: judge
            .iter()
            .zip(&errors_after)
            .map(|(run, rms)| Validation {
                run: run.data.name.clone(),
                rms_raw: rms.raw.clone(),
                rms_filtered: rms.filtered.clone(),
                served_rms: None,
                mounting: run.data.mounting.into(),
            })
            .collect(),
        band: Band::Filtered { cutoff: settings.torque_cutoff },
        noise_floor: Rms::pooled(&errors_after).and_then(|rms| rms.noise_floor).unwrap_or_default(),
        diagnosis: Some(diagnosis),
        checks: findings,
        identifiability,
        provenance: provenance(&file.provenance, &robot, &dataset),
        ..Report::default()
    };
    add_origin(&mut report, &options.dataset);
    std::fs::create_dir_all(&options.out)
        .map_err(|error| Failure::job(format!("{}: {error}", options.out.display())))?;
    let written = if kept.is_empty() {
        // No change: the stored model.
        file
    } else {
        ModelFile {
            model: after,
            noise_floor: file.noise_floor,
            validation: judge
                .iter()
                .zip(&errors_after)
                .map(|(run, rms)| Validated {
                    run: run.data.name.clone(),
                    rho: run.data.mounting.rho,
                    phi: run.data.mounting.phi,
                    rms: rms.filtered.clone(),
                })
                .collect(),
            uncertainty: None,
            consistent: None,
            provenance: Provenance {
                source: Some(since),
                ..crate::analysis::provenance(&robot, Some(dataset.content_hash()))
            },
        }
    };
    crate::atomic::write_result(&options.out.join("model.toml"), written.to_toml().as_bytes())?;
    let drawn = judge.iter().take(2).map(|run| pipeline::figure_in_band(&written.model, run, &settings));
    let figures = Figures { runs: drawn.collect::<Result<_, _>>()?, ..Figures::default() };
    report.write(&options.out, &figures).map_err(Failure::job)?;
    Ok(report)
}

/// Reads the model, which must be of the dataset's robot.
fn model_file(options: &Options, robot: &Robot) -> Result<ModelFile, Failure> {
    let name = options.model.display().to_string();
    let text = std::fs::read_to_string(&options.model)
        .map_err(|error| BadInput::new(&name, "file", error, "a readable model file"))?;
    Ok(models::of_robot(&name, &text, robot, "the robot of the dataset")?)
}

fn diagnose_settings(options: &Options) -> Result<plumbline_diagnose::Settings, Failure> {
    if let Some(threshold) = options.threshold
        && !(threshold.is_finite() && threshold >= 0.0)
    {
        return Err(BadInput::new("command line", "--threshold", threshold, "a torque in Nm, 0 or more").into());
    }
    let threads = threads();
    Ok(plumbline_diagnose::Settings {
        threshold: options.threshold,
        threads,
        ..plumbline_diagnose::Settings::default()
    })
}

/// Limits of the model's validity: runs in mountings that it has no parameters for, and parameters that these runs need and that were
/// not identifiable.
fn identifiability(model: &TorqueModel, refused: &[&Run], doubt: &reference::Doubt) -> Identifiability {
    let mut facts = Identifiability {
        not_identifiable: doubt.parameters.clone(),
        weakly_determined: Vec::new(),
        untrusted_runs: refused.iter().map(|run| run.data.name.clone()).chain(doubt.runs.iter().cloned()).collect(),
    };
    if !refused.is_empty() {
        let own: Vec<&str> = model.parameters().iter().map(|own| own.column.name.as_str()).collect();
        let generalized = RigidBody::new(&Reduction::any_mounting(model.structure().chain())).columns();
        let missing = generalized.into_iter().map(|column| column.name).filter(|name| !own.contains(&name.as_str()));
        facts.not_identifiable.extend(missing);
    }
    facts
}

fn since(options: &Options, file: &ModelFile) -> String {
    let name = options.model.file_name().map_or("the model".into(), |name| name.to_string_lossy().into_owned());
    let date = file.provenance.date.as_ref().map_or(String::new(), |date| format!(" of {date}"));
    format!("{name}{date}")
}

fn provenance(of_model: &Provenance, robot: &Robot, dataset: &Dataset) -> serde_json::Map<String, serde_json::Value> {
    let own = crate::analysis::provenance(robot, Some(dataset.content_hash()));
    let facts = [
        ("dataset", own.dataset),
        ("plumbline", own.plumbline),
        ("date", own.date),
        ("model-dataset", of_model.dataset.clone()),
        ("model-date", of_model.date.clone()),
    ];
    facts.into_iter().filter_map(|(name, value)| Some((name.to_string(), value?.into()))).collect()
}
