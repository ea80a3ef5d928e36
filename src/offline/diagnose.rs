//! Diagnosis of recorded runs: effects that a plain model lacks.

use crate::analysis::diagnosis::{Diagnosed, Question};
use crate::analysis::split::{Split, split};
use crate::analysis::{checks, exchange, pipeline, sessions};
use crate::dataset::{Dataset, Run};
use crate::failure::Failure;
use crate::offline::identify::{self, Outcome};
use crate::report::Report;
use clap::Args;
use plumbline_core::{BadInput, threads};
use plumbline_diagnose::errors::Of;
use plumbline_diagnose::{Diagnosis, OpenQuestions};
use plumbline_model::{Mounting, Robot};
use std::path::Path;

/// Options of [`diagnose`], in the words of `plumbline diagnose`.
#[derive(Args)]
#[group(id = "diagnose")]
pub struct Options {
    #[command(flatten)]
    identify: identify::Options,
    /// Highest analysed frequency in Hz; by default 16 for periodic motions, 10 for others
    #[arg(long, value_name = "HZ")]
    band: Option<f64>,
    /// Detection threshold in Nm: smallest torque RMS of an effect; by default 0.7 of the noise of the mean period
    #[arg(long, value_name = "NM")]
    threshold: Option<f64>,
    /// Wanted half width of the 95 % intervals of effects' parameters, as a share of the effect's size; a wider one is left open
    #[arg(long, value_name = "SHARE")]
    until: Option<f64>,
}

impl Options {
    /// Folder of the results.
    pub fn out(&self) -> &Path {
        &self.identify.out
    }

    /// Folder of the dataset.
    pub fn dataset(&self) -> &Path {
        &self.identify.dataset
    }
}

/// Searches for effects in recorded runs and writes `model.toml`, `report.json` and `report.html`.
///
/// # Errors
/// Options and files that can't be used; an identification or a search that failed.
pub fn diagnose(options: &Options) -> Result<Report, Failure> {
    diagnose_and_plan(options, |_, _, _, _| Ok(()))
}

/// The same; `plan` looks at what is left open, and may add to the report, before anything is written.
pub(crate) fn diagnose_and_plan(
    options: &Options,
    plan: impl FnOnce(&OpenQuestions, &mut Diagnosis, &Robot, Mounting) -> Result<(), Failure>,
) -> Result<Report, Failure> {
    let given = &options.identify;
    let mut dataset = Dataset::read(&given.dataset)?;
    let robot = Robot::load(&dataset.robot, Some(&given.dataset))?;
    dataset.expect_joints(robot.chain.len())?;
    let hash = dataset.content_hash();
    checks::is_folder(&given.out)?;
    let settings = identify::settings(given)?;
    let solver = identify::solver(given)?;
    let terms = match &given.terms {
        Some(_) => identify::terms(given, &robot)?,
        None => pipeline::plain_terms(&robot),
    };
    let session = dataset.runs.iter().map(|run| run.session).min().unwrap_or(1);
    pipeline::check_channels(&identify::to_identify(&dataset))?;
    let findings = checks::checked(&given.dataset, &dataset, &robot)?;
    let later = sessions::take_later(&mut dataset);
    let Split { identify, validate, mut notes } = split(&mut dataset, identify::hold_out(given)?)?;
    let identified: Vec<&Run> = identify.iter().collect();
    let structure = pipeline::structure(&robot, &identified, &terms)?;
    let along_axis_1 = structure.kind() == plumbline_model::BaseKind::Vbs;
    let (trusted, untrusted): (Vec<&Run>, Vec<&Run>) = validate
        .iter()
        .partition(|run| !along_axis_1 || run.data.mounting.is_along_axis_1(plumbline_model::VERTICAL_TOLERANCE));
    let repeats = identify.iter().all(|run| run.data.period.is_some());
    let diagnosis = diagnosis_settings(options, repeats)?;
    let question = Question {
        robot: &robot,
        structure: &structure,
        identify: &identified,
        unseen: &trusted,
        settings: &settings,
        options: &solver,
        diagnosis: &diagnosis,
        of: Of::Filtered,
    };
    let (Diagnosed { after, mut block, figures: drawn, open, .. }, identified, unseen) = exchange::run(&question)?;
    plan(&open, &mut block, &robot, dataset.mounting)?;
    let reference =
        sessions::Reference { robot: &robot, identified: &after, session, settings: &settings, diagnosis: &diagnosis };
    let not_valid = reference.compare(&later, &mut block, &given.out)?;

    let judged = pipeline::judge_all(&after.model, &unseen, &settings)?;
    let done = Outcome {
        robot: &robot,
        identified: after,
        runs: identified,
        judged,
        mounting: dataset.mounting,
        hash,
        settings: &settings,
    };
    done.write(given, |report| {
        let untrusted = untrusted.iter().map(|run| run.data.name.clone());
        report.identifiability.untrusted_runs = untrusted.chain(not_valid).collect();
        report.notes.append(&mut notes);
        report.checks = findings;
        report.diagnosis = Some(block);
        drawn
    })
}

fn diagnosis_settings(options: &Options, repeats: bool) -> Result<plumbline_diagnose::Settings, Failure> {
    let plain = plumbline_diagnose::Settings { threads: threads(), ..plumbline_diagnose::Settings::default() };
    let band = options.band.unwrap_or(if repeats { plain.band } else { NON_PERIODIC_BAND_HZ });
    if !(0.5..=200.0).contains(&band) {
        return Err(BadInput::new("command line", "--band", band, "0.5 to 200 Hz").into());
    }
    if let Some(threshold) = options.threshold.filter(|threshold| !(threshold.is_finite() && *threshold > 0.0)) {
        return Err(BadInput::new("command line", "--threshold", threshold, "a torque in Nm, more than 0").into());
    }
    if let Some(until) = options.until.filter(|until| !(1e-4..=1.0).contains(until)) {
        return Err(BadInput::new("command line", "--until", until, "a share of the values, 0.0001 to 1").into());
    }
    Ok(plumbline_diagnose::Settings { band, threshold: options.threshold, until: options.until, ..plain })
}

/// Highest analysed frequency of non-periodic motions \[Hz\]: above it their accelerations are noise.
const NON_PERIODIC_BAND_HZ: f64 = 10.0;
