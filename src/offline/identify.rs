//! Identification of recorded runs.

use crate::analysis::pipeline::{self, Identified, Judged};
use crate::analysis::results::report_of;
use crate::analysis::split::{HOLD_OUT, Split, split};
use crate::analysis::{checks, drawn};
use crate::dataset::{Dataset, Role, Run};
use crate::failure::Failure;
use crate::process::progress;
use crate::report::figures::{Curves, Figures};
use crate::report::provenance::add_origin;
use crate::report::{Band, Consistency, Report, Validation};
use crate::store::{ModelFile, Validated, uncertainty_of};
use clap::Args;
use plumbline_core::{BadInput, parallel, threads};
use plumbline_identify::solve::Estimator;
use plumbline_identify::{Method, Settings, solve};
use plumbline_model::{Mounting, Robot};
use std::path::{Path, PathBuf};

/// Options of [`identify`], in the words of `plumbline identify`.
#[derive(Args)]
pub struct Options {
    /// Folder with dataset.toml and one CSV file per run
    pub(super) dataset: PathBuf,
    /// Folder for report.html, report.json and model.toml
    #[arg(long, value_name = "DIR")]
    pub(super) out: PathBuf,
    /// Terms besides the rigid body; by default friction and torque-offset, and rotor-inertia for motor-side torques
    #[arg(long, value_delimiter = ',')]
    pub(super) terms: Option<Vec<String>>,
    /// Estimator: ols, wls, wls-full, huber, tls or iv
    #[arg(long, default_value = "wls")]
    estimator: String,
    /// Remove parameters that are not significantly different from zero (essential parameters)
    #[arg(long)]
    essential: bool,
    /// Signal processing: spectral, or paper (order 20, 2 Hz, central differences)
    #[arg(long, default_value = "spectral")]
    method: String,
    /// Cut-off of the zero-phase low-pass on torques and regressor columns in Hz; 4 by default, 2 for the paper's method
    #[arg(long, value_name = "HZ")]
    torque_cutoff: Option<f64>,
    /// Cut-off of the zero-phase low-pass on positions in Hz; by default as wide as their noise allows, 10 to 80, or 2 for the paper's method
    #[arg(long, value_name = "HZ")]
    position_cutoff: Option<f64>,
    /// Order of both filters; 8 by default, 20 for the paper's method
    #[arg(long)]
    order: Option<usize>,
    /// Velocities of runs that do not repeat: measured (where the run has dq columns) or derived from the positions
    #[arg(long, default_value = "measured")]
    velocities: String,
    /// Time to leave out at both ends of runs that do not repeat, in s
    #[arg(long, value_name = "SECONDS", default_value_t = 0.0)]
    trim: f64,
    /// Use also samples at which the whole arm is at rest, where Coulomb friction is undetermined
    #[arg(long)]
    keep_rests: bool,
    /// Share of every run to validate with, if the dataset has no validation run
    #[arg(long, value_name = "SHARE", default_value_t = HOLD_OUT)]
    hold_out: f64,
}

/// Default cut-off of the torque low-pass for recorded data, which is rarely periodic \[Hz\].
const TORQUE_CUTOFF_HZ: f64 = 4.0;
/// Largest speed of a joint at rest \[rad/s\]: the model's Coulomb friction changes sign within 0.01 rad/s.
const REST_SPEED: f64 = 0.01;

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

/// Identifies, validates and writes `model.toml`, `report.json` and `report.html`.
///
/// # Errors
/// Options and files that can't be used; an identification that failed.
pub fn identify(options: &Options) -> Result<Report, Failure> {
    let mut dataset = Dataset::read(&options.dataset)?;
    let robot = Robot::load(&dataset.robot, Some(&options.dataset))?;
    dataset.expect_joints(robot.chain.len())?;
    let hash = dataset.content_hash();
    let settings = settings(options)?;
    let solver = solver(options)?;
    let terms = terms(options, &robot)?;
    let hold_out = hold_out(options)?;
    checks::is_folder(&options.out)?;
    pipeline::check_channels(&to_identify(&dataset))?;
    let findings = checks::checked(&options.dataset, &dataset, &robot)?;
    let Split { identify, validate, notes } = split(&mut dataset, hold_out)?;

    let bar = progress::bar("identifying");
    bar.busy("regression");
    let identified_runs: Vec<&Run> = identify.iter().collect();
    let identified = pipeline::identify(&robot, &identified_runs, &terms, &settings, &solver)?;
    let mut judged: Vec<(&Run, Judged)> = Vec::new();
    let mut untrusted = Vec::new();
    for (k, run) in validate.iter().enumerate() {
        bar.at(k as f64 / validate.len() as f64, &run.data.name);
        match identified.model.valid_in(&run.data.mounting) {
            Ok(()) => judged.push((run, pipeline::judge(&identified.model, run, &settings)?)),
            Err(_) => untrusted.push(run.data.name.clone()),
        }
    }
    bar.done();

    let done = Outcome {
        robot: &robot,
        identified,
        runs: identified_runs,
        judged,
        mounting: dataset.mounting,
        hash,
        settings: &settings,
    };
    done.write(options, |report| {
        report.identifiability.untrusted_runs = untrusted;
        report.notes = notes;
        report.checks = findings;
        Curves::default()
    })
}

/// The runs to identify from.
pub(super) fn to_identify(dataset: &Dataset) -> Vec<&Run> {
    dataset.runs.iter().filter(|run| run.role == Role::Identify).collect()
}

/// A validated model from files: the result of an identification or a diagnosis.
pub(super) struct Outcome<'a> {
    pub robot: &'a Robot,
    pub identified: Identified,
    pub runs: Vec<&'a Run>,
    /// Validation runs with the model's errors.
    pub judged: Vec<(&'a Run, Judged)>,
    pub mounting: Mounting,
    pub hash: String,
    pub settings: &'a Settings,
}

impl Outcome<'_> {
    /// Writes model.toml, report.json and report.html. `add` completes the report and returns its figures.
    pub fn write(self, options: &Options, add: impl FnOnce(&mut Report) -> Curves) -> Result<Report, Failure> {
        let out = options.out();
        let Outcome { robot, identified, runs, judged, mounting, hash, settings } = self;
        let provenance = crate::analysis::provenance(robot, Some(hash));
        let mut report = report_of(&identified, mounting, &provenance);
        // Recorded data is rarely periodic, so raw samples have no noise floor.
        report.band = Band::Filtered { cutoff: settings.torque_cutoff };
        report.validate = judged
            .iter()
            .map(|(run, judged)| Validation {
                run: run.data.name.clone(),
                rms_raw: judged.rms.raw.clone(),
                rms_filtered: judged.rms.filtered.clone(),
                served_rms: None,
                mounting: run.data.mounting.into(),
            })
            .collect();
        add_origin(&mut report, &options.dataset);
        let diagnosis = add(&mut report);
        let consistent = pipeline::real_bodies(&identified);
        report.consistency = consistent.as_ref().map(|found| Consistency::of_model(&identified.model, found));
        let model = ModelFile {
            validation: judged
                .iter()
                .map(|(run, judged)| Validated {
                    run: run.data.name.clone(),
                    rho: run.data.mounting.rho,
                    phi: run.data.mounting.phi,
                    rms: judged.rms.filtered.clone(),
                })
                .collect(),
            noise_floor: report.noise_floor.clone(),
            uncertainty: uncertainty_of(
                &identified.identification,
                &identified.model,
                identified.residual_spectrum.clone(),
            ),
            consistent,
            model: identified.model,
            provenance,
        };
        std::fs::create_dir_all(out).map_err(|error| Failure::job(format!("{}: {error}", out.display())))?;
        crate::atomic::write_result(&out.join("model.toml"), model.to_toml().as_bytes())?;
        let correlation = drawn::correlation(&identified.identification);
        let friction = match runs.first() {
            Some(run) => drawn::friction(&model.model, run, settings)?,
            None => Vec::new(),
        };
        let shown = runs.iter().take(1).copied().chain(judged.iter().map(|(run, _)| *run).take(2));
        let shown: Vec<&Run> = shown.collect();
        let runs = parallel(&shown, threads(), |run| pipeline::figure_in_band(&model.model, run, settings));
        let runs = runs.into_iter().collect::<Result<_, _>>()?;
        let figures = Figures { runs, diagnosis, friction, correlation, ..Figures::default() };
        report.write(out, &figures).map_err(Failure::job)?;
        Ok(report)
    }
}

pub(super) fn settings(options: &Options) -> Result<Settings, Failure> {
    let mut settings = match Method::by_id(&options.method) {
        Some(Method::Spectral) => Settings { torque_cutoff: TORQUE_CUTOFF_HZ, ..Settings::default() },
        Some(Method::Paper) => Settings::paper(),
        None => {
            let found = format!("`{}`", options.method);
            return Err(BadInput::new("command line", "--method", found, "spectral or paper").into());
        }
    };
    for (name, given) in [("--torque-cutoff", options.torque_cutoff), ("--position-cutoff", options.position_cutoff)] {
        if let Some(value) = given
            && !(0.01..=500.0).contains(&value)
        {
            return Err(BadInput::new("command line", name, value, "0.01 to 500 Hz").into());
        }
    }
    settings.torque_cutoff = options.torque_cutoff.unwrap_or(settings.torque_cutoff);
    settings.position_cutoff = options.position_cutoff.or(settings.position_cutoff);
    if let Some(order) = options.order {
        if order == 0 || order % 2 == 1 || order > 40 {
            return Err(BadInput::new("command line", "--order", order, "an even number from 2 to 40").into());
        }
        settings.order = order;
    }
    settings.measured_velocities = pipeline::measured_velocities(&options.velocities)?;
    if !(0.0..=3600.0).contains(&options.trim) {
        return Err(BadInput::new("command line", "--trim", options.trim, "0 to 3600 s").into());
    }
    settings.trim = options.trim;
    settings.rest = (!options.keep_rests).then_some(REST_SPEED);
    Ok(settings)
}

/// Default settings for recorded data: 4 Hz, without samples at rest.
pub(super) fn recorded_data_settings(velocities: &str, trim: f64) -> Result<Settings, Failure> {
    let measured_velocities = pipeline::measured_velocities(velocities)?;
    if !(0.0..=3600.0).contains(&trim) {
        return Err(BadInput::new("command line", "--trim", trim, "0 to 3600 s").into());
    }
    Ok(Settings {
        torque_cutoff: TORQUE_CUTOFF_HZ,
        measured_velocities,
        trim,
        rest: Some(REST_SPEED),
        ..Settings::default()
    })
}

pub(super) fn hold_out(options: &Options) -> Result<f64, Failure> {
    if !(0.05..=0.95).contains(&options.hold_out) {
        return Err(BadInput::new("command line", "--hold-out", options.hold_out, "0.05 to 0.95").into());
    }
    Ok(options.hold_out)
}

pub(super) fn solver(options: &Options) -> Result<solve::Options, Failure> {
    let Some(estimator) = Estimator::by_id(&options.estimator) else {
        let known = Estimator::ALL.map(Estimator::id).join(", ");
        return Err(BadInput::new("command line", "--estimator", format!("`{}`", options.estimator), known).into());
    };
    Ok(solve::Options { estimator, essential: options.essential })
}

pub(super) fn terms<'a>(options: &'a Options, robot: &Robot) -> Result<Vec<&'a str>, Failure> {
    let Some(named) = &options.terms else { return Ok(pipeline::default_terms(robot)) };
    let known = &plumbline_model::term::KNOWN[1..];
    for name in named {
        if !known.contains(&name.as_str()) {
            return Err(BadInput::new("command line", "--terms", format!("`{name}`"), known.join(", ")).into());
        }
    }
    Ok(named.iter().map(String::as_str).collect())
}
