//! `plumbline diagnose`: what a plain model of recorded data lacks, offline, from files.

use super::diagnosed::{self, Diagnosed, Question};
use super::identify::{self, Split};
use super::results::report_of;
use super::{Failure, export, pipeline, sessions};
use crate::config::robot::{Robot, TorqueSensing};
use crate::dataset::{Dataset, Run};
use crate::diagnose::errors::Of;
use crate::diagnose::{self};
use crate::input::BadInput;
use crate::report::figures::Figures;
use crate::report::{Band, Validation};
use crate::store::{ModelFile, Validated};
use clap::Args;

/// Options of `plumbline diagnose`.
#[derive(Args)]
#[group(id = "diagnose")]
pub struct Options {
    #[command(flatten)]
    identify: identify::Options,
    /// Highest frequency that is looked at in Hz; by default 16 for motions that repeat, 10 for others
    #[arg(long, value_name = "HZ")]
    band: Option<f64>,
    /// Least torque RMS of an effect that matters in Nm; by default 0.7 of the noise of the mean period
    #[arg(long, value_name = "NM")]
    threshold: Option<f64>,
}

/// Looks for effects in recorded runs and writes the results.
pub fn run(options: Options) -> Result<(), Failure> {
    let given = &options.identify;
    let mut dataset = Dataset::read(&given.dataset)?;
    let robot = Robot::load(&dataset.robot, Some(&given.dataset))?;
    dataset.expect_joints(robot.chain.len())?;
    let hash = dataset.content_hash();
    let later = sessions::take_later(&mut dataset);
    let settings = identify::settings(given)?;
    let solver = identify::solver(given)?;
    // An offset is a finding here, not a part of the plain model.
    let terms = match &given.terms {
        Some(_) => identify::terms(given, &robot)?,
        None => plain_terms(&robot),
    };
    let Split { identify, validate, mut notes } = identify::split(&dataset, identify::hold_out(given)?)?;
    let identified: Vec<&Run> = identify.iter().collect();
    let structure = pipeline::structure(&robot, &identified, &terms)?;
    let along_axis_1 = structure.kind() == crate::model::base::BaseKind::Vbs;
    let (trusted, untrusted): (Vec<&Run>, Vec<&Run>) = validate
        .iter()
        .partition(|run| !along_axis_1 || run.mounting.is_along_axis_1(crate::model::gravity::VERTICAL_TOLERANCE));
    let repeats = identify.iter().all(|run| run.period.is_some());
    let diagnosis = diagnosis_settings(&options, repeats)?;
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
    let Diagnosed { after, mut block, figures: drawn } = diagnosed::run(&question)?;
    let reference = sessions::Reference {
        model: &after.model,
        noise_floor: after.identification.rms.noise_floor.as_deref().unwrap_or_default(),
        session: dataset.runs.first().map_or(1, |run| run.session),
        settings: &settings,
        diagnosis: &diagnosis,
    };
    let not_valid = reference.compare(&later, &mut block, &given.out)?;

    let judged = trusted.iter().map(|run| Ok((*run, pipeline::judge(&after.model, run, &settings)?)));
    let judged = judged.collect::<Result<Vec<_>, Failure>>()?;
    let provenance = super::provenance(Some(hash));
    let mut report = report_of(&after, dataset.mounting, &provenance);
    report.band = Band::Filtered { cutoff: settings.torque_cutoff };
    report.identify.rms.clone_from(&report.identify.rms_filtered);
    report.validate = judged
        .iter()
        .map(|(run, judged)| Validation {
            run: run.file.clone(),
            rms: judged.rms.filtered.clone(),
            rms_raw: judged.rms.raw.clone(),
            rms_filtered: judged.rms.filtered.clone(),
            served_rms: None,
            mounting: run.mounting.into(),
        })
        .collect();
    report.identifiability.untrusted_runs = untrusted.iter().map(|run| run.file.clone()).chain(not_valid).collect();
    report.notes.append(&mut notes);
    report.diagnosis = Some(block);
    let consistent = export::of_identified(&after);
    report.consistency = consistent.as_ref().map(|found| export::facts(&after.model, found));
    let model = ModelFile {
        validation: judged
            .iter()
            .map(|(run, judged)| Validated {
                run: run.file.clone(),
                rho: run.mounting.rho,
                phi: run.mounting.phi,
                rms: judged.rms.filtered.clone(),
            })
            .collect(),
        noise_floor: report.noise_floor.clone(),
        consistent,
        model: after.model,
        provenance,
    };
    std::fs::create_dir_all(&given.out).map_err(|error| Failure::job(format!("{}: {error}", given.out.display())))?;
    super::write(&given.out.join("model.toml"), model.to_toml().as_bytes())?;
    let shown = identified.iter().take(1).chain(trusted.iter().take(2));
    let runs = shown.map(|run| pipeline::figure_in_band(&model.model, run, &settings)).collect::<Result<_, _>>()?;
    report.write(&given.out, &Figures { runs, plan: None, diagnosis: drawn }).map_err(Failure::job)?;
    for line in report.summary() {
        println!("{line}");
    }
    println!("report: {}", given.out.join("report.html").display());
    Ok(())
}

/// Terms of the plain model besides the rigid body: motor-side torques feel the rotors.
fn plain_terms(robot: &Robot) -> Vec<&'static str> {
    match robot.torque_sensing {
        TorqueSensing::Link => vec!["friction"],
        TorqueSensing::Motor => vec!["friction", "rotor-inertia"],
    }
}

fn diagnosis_settings(options: &Options, repeats: bool) -> Result<diagnose::Settings, Failure> {
    let plain = diagnose::Settings { threads: threads(), ..diagnose::Settings::default() };
    let band = options.band.unwrap_or(if repeats { plain.band } else { BAND_OF_ONE });
    if !(0.5..=200.0).contains(&band) {
        return Err(BadInput::new("command line", "--band", band, "0.5 to 200 Hz").into());
    }
    if let Some(threshold) = options.threshold.filter(|threshold| !(threshold.is_finite() && *threshold > 0.0)) {
        return Err(BadInput::new("command line", "--threshold", threshold, "a torque in Nm, more than 0").into());
    }
    Ok(diagnose::Settings { band, threshold: options.threshold, ..plain })
}

/// Highest frequency that is looked at where motions do not repeat \[Hz\]: above it their accelerations are noise.
const BAND_OF_ONE: f64 = 10.0;

/// Threads to work on.
pub fn threads() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}
