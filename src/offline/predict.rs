//! Torques of a model along a recorded motion.

use crate::analysis::checks;
use crate::analysis::external::Seen;
use crate::analysis::pipeline::{self, Predicted};
use crate::config::units::parse_mounting;
use crate::dataset::{Dataset, Run};
use crate::failure::Failure;
use crate::store::ModelFile;
use clap::Args;
use plumbline_core::BadInput;
use plumbline_identify::check::{self, State};
use plumbline_identify::external::{ObserverSettings, Way};
use plumbline_identify::{Settings, TorqueUncertainty};
use plumbline_model::{Chain, Mounting, Robot, TorqueModel};
use plumbline_model_file::models;
use std::path::{Path, PathBuf};

/// Options of [`predict`], in the words of `plumbline predict`.
#[derive(Args)]
#[group(id = "predict")]
pub struct Options {
    /// Model file
    model: PathBuf,
    /// Recorded motion: a CSV file with columns t, q1..qn and, to compare with, tau1..taun
    run: PathBuf,
    /// Mounting of that motion: upright, wall, ceiling, or RHO,PHI with units; by default that of the dataset.toml beside the
    /// motion, else that of the model
    #[arg(long)]
    mounting: Option<String>,
    /// Predict even where the model is not valid
    #[arg(long)]
    force: bool,
    /// Predict with the nearest physically consistent parameters (block `consistent` of the model file)
    #[arg(long)]
    consistent: bool,
    /// Velocities of the motion: measured (where it has dq columns) or derived from the positions
    #[arg(long, default_value = "measured")]
    velocities: String,
    /// Add the external torque as a controller would have it, and contact: columns tau_ext1, tau_ext1_low, tau_ext1_high .. (95 % interval), contact (1
    /// where a joint exceeds its threshold). The values are those of a low-pass, late by its delay, which is printed
    #[arg(long)]
    external: bool,
    /// Half-power frequency of the low-pass of the external torque in Hz
    #[arg(long, value_name = "HZ", default_value_t = 20.0, requires = "external")]
    bandwidth: f64,
    /// False alarms an hour that are accepted, over all joints
    #[arg(long, value_name = "PER_HOUR", default_value_t = 0.1, requires = "external")]
    false_alarms: f64,
    /// How the external torque is found: generalised momentum, or accelerations from differences of the velocities
    #[arg(long, value_enum, default_value_t = By::Momentum, requires = "external")]
    by: By,
}

/// The ways of the observer by their names on the command line.
#[derive(Clone, Copy, clap::ValueEnum)]
enum By {
    Momentum,
    Acceleration,
}

impl From<By> for Way {
    fn from(by: By) -> Way {
        match by {
            By::Momentum => Way::Momentum,
            By::Acceleration => Way::Acceleration,
        }
    }
}

/// The motion with the torques of the model along it.
pub struct Prediction {
    pub run: Run,
    pub predicted: Predicted,
    /// The external torque, where it was asked for.
    pub external: Option<Seen>,
    /// Kinematics of the robot.
    pub chain: Chain,
    /// What is unusual in the recorded motion, one finding per line.
    pub warnings: Vec<String>,
}

/// Computes the torques of a model along a recorded motion.
///
/// # Errors
/// Options and files that can't be used; a model that is not valid in this mounting.
pub fn predict(options: &Options) -> Result<Prediction, Failure> {
    let (file, _) = models::load(&options.model)?;
    let (model, uncertainty) = &chosen(options, &file)?;
    let (run, robot) = motion(&Source::of(options), model, file.provenance.robot_description.as_deref())?;
    let warnings = check_motion(options, &run, &robot)?;
    if let Err(refused) = model.valid_in(&run.data.mounting)
        && !options.force
    {
        let name = options.model.display().to_string();
        let expected = "a model that holds in this mounting, or --force";
        return Err(BadInput::new(name, "key `kind`", refused, expected).into());
    }
    let measured_velocities = pipeline::measured_velocities(&options.velocities)?;
    let settings = Settings { measured_velocities, ..Settings::default() };
    let predicted = pipeline::predict(model, uncertainty.as_ref(), &run, &settings)?;
    let external = match options.external {
        true => Some(external(options, model, uncertainty.as_ref(), &run)?),
        false => None,
    };
    Ok(Prediction { run, predicted, external, chain: robot.chain, warnings })
}

/// The external torque along the motion.
fn external(
    options: &Options,
    model: &TorqueModel,
    uncertainty: Option<&TorqueUncertainty>,
    run: &Run,
) -> Result<Seen, Failure> {
    let name = || options.model.display().to_string();
    if run.data.tau.ncols() == 0 {
        let (file, expected) =
            (options.run.display().to_string(), "tau1..taun: the external torque is measured less modelled");
        return Err(BadInput::new(file, "line 1", "no torques", expected).into());
    }
    let Some(uncertainty) = uncertainty else {
        let expected = "a model file with [uncertainty], as `plumbline identify` and `run` write it";
        return Err(BadInput::new(name(), "--external", "no uncertainty of these parameters", expected).into());
    };
    let measured = pipeline::measured_velocities(&options.velocities)?;
    let settings = ObserverSettings {
        way: options.by.into(),
        bandwidth: options.bandwidth,
        false_alarms: options.false_alarms,
        ..ObserverSettings::default()
    };
    Seen::along(model, uncertainty, &run.data, measured, settings).map_err(|error| {
        let expected =
            "a spectrum in the model file, a bandwidth below half the recording's rate, false alarms above 0";
        BadInput::new(name(), "--external", error, expected).into()
    })
}

/// The identified model with its uncertainty, or its physically consistent projection, whose uncertainty is unknown where the parameters moved.
fn chosen(options: &Options, file: &ModelFile) -> Result<(TorqueModel, Option<TorqueUncertainty>), Failure> {
    let model = &file.model;
    if !options.consistent {
        return Ok((model.clone(), file.uncertainty.clone()));
    }
    let Some(nearest) = &file.consistent else {
        let expected = "a model file with a [consistent] block, as `plumbline identify` and `run` write it";
        let name = options.model.display().to_string();
        return Err(BadInput::new(name, "--consistent", "no key `consistent`", expected).into());
    };
    let values: Vec<(f64, Option<f64>)> = nearest.beta.iter().map(|&value| (value, None)).collect();
    let (structure, mountings) = (model.structure().clone(), model.mountings().to_vec());
    let projection = TorqueModel::new(model.robot(), structure, mountings, &values).map_err(Failure::job)?;
    Ok((projection, file.uncertainty.clone().filter(|_| nearest.exact)))
}

/// Where a motion comes from.
pub(super) struct Source<'a> {
    pub model: &'a Path,
    pub run: &'a Path,
    pub mounting: Option<&'a str>,
    /// Whether a motion of another robot is taken.
    pub force: bool,
}

impl<'a> Source<'a> {
    fn of(options: &'a Options) -> Source<'a> {
        let Options { model, run, mounting, force, .. } = options;
        Source { model, run, mounting: mounting.as_deref(), force: *force }
    }
}

/// The motion with its mounting: from `--mounting`, else from the dataset of the file, else from the model.
pub(super) fn motion(source: &Source, model: &TorqueModel, description: Option<&str>) -> Result<(Run, Robot), Failure> {
    let robot = match description {
        Some(text) => Robot::parse(&source.model.display().to_string(), text)?,
        None => Robot::load(model.robot(), None)?,
    };
    let folder = source.run.parent().filter(|folder| folder.join("dataset.toml").is_file());
    let of_dataset = match folder {
        Some(folder) => {
            let dataset = Dataset::read(folder)?;
            let declared = Robot::load(&dataset.robot, Some(folder))?;
            if declared.chain != robot.chain && !source.force {
                let (file, found) = (folder.join("dataset.toml").display().to_string(), format!("`{}`", dataset.robot));
                let expected = format!("`{}`, the robot of {}, or --force", robot.name, source.model.display());
                return Err(BadInput::new(file, "key `robot`", found, expected).into());
            }
            dataset
                .runs
                .into_iter()
                .find(|run| source.run.file_name().is_some_and(|name| name == run.data.name.as_str()))
        }
        None => None,
    };
    let mut run = match of_dataset {
        Some(run) => run,
        None => Run::read(source.run, model.mountings().first().copied().unwrap_or(Mounting::UPRIGHT))?,
    };
    if let Some(text) = source.mounting {
        run.data.mounting = parse_mounting("--mounting", text)?;
    }
    let n = model.structure().chain().len();
    if run.joints() != n {
        let expected = format!("q1..q{n}, the joints of robot `{}`", model.robot());
        let file = source.run.display().to_string();
        return Err(BadInput::new(file, "line 1", format!("q1..q{}", run.joints()), expected).into());
    }
    Ok((run, robot))
}

/// Refuses a motion that the model's robot cannot make; what is unusual is returned.
fn check_motion(options: &Options, run: &Run, robot: &Robot) -> Result<Vec<String>, Failure> {
    let folder = options.run.parent().unwrap_or(std::path::Path::new(""));
    let mut warnings = Vec::new();
    for finding in check::samples(robot, &run.data) {
        match finding.state {
            State::Fail if !options.force => return Err(checks::refusal(folder, &finding).into()),
            State::Pass => {}
            _ => warnings.push(checks::line(&finding)),
        }
    }
    Ok(warnings)
}
