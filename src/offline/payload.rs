//! The body on the flange from a short motion of the wrist, against a stored model.

use crate::config::units::parse_mounting;
use crate::failure::Failure;
use crate::offline::predict::{self, Source};
use crate::setup::planner::{Room, Task, no_plan};
use crate::store::{ModelFile, Provenance};
use clap::Args;
use plumbline_core::{BadInput, threads};
use plumbline_excite::{Fourier, Margins, Plan, Search, SearchControl, best_by_score};
use plumbline_identify::payload::{self, Found, PayloadError, determined, with_body};
use plumbline_identify::{Experiment, Settings};
use plumbline_model::Mounting;
use plumbline_model::term::Motion;
use plumbline_model_file::models;
use std::path::{Path, PathBuf};

/// Options of [`plan`] and [`find`], in the words of `plumbline payload`.
#[derive(Args)]
#[group(id = "payload")]
pub struct Options {
    /// Model file of the arm without the body
    model: PathBuf,
    /// Recorded motion with the body: a CSV file with t, q1..qn, tau1..taun (and dq1..dqn)
    #[arg(long, value_name = "FILE", required_unless_present = "plan")]
    pub run: Option<PathBuf>,
    /// Model file to write: the stored model with the body as a term, for `export`, `predict` and the daemon
    #[arg(long, value_name = "FILE", requires = "run")]
    pub out: Option<PathBuf>,
    /// Plan the motion, and write it to this plan file (`plumbline plan --of` writes it as CSV or for ROS)
    #[arg(long, value_name = "FILE", conflicts_with = "run")]
    pub plan: Option<PathBuf>,
    /// Joints that move, counted from the flange
    #[arg(long, value_name = "K", default_value_t = 3, requires = "plan")]
    joints: usize,
    /// Start pose of the plan in rad, by default the best that is found
    #[arg(long, value_name = "Q1,..,QN", value_delimiter = ',', allow_hyphen_values = true, requires = "plan")]
    pose: Option<Vec<f64>>,
    /// Period of the plan in s; drive it twice
    #[arg(long, default_value_t = 10.0, requires = "plan")]
    period: f64,
    /// Random motions that are compared
    #[arg(long, default_value_t = 64, requires = "plan", value_parser = clap::value_parser!(u64).range(1..=10_000))]
    starts: u64,
    /// Seed of the search
    #[arg(long, default_value_t = 1, requires = "plan")]
    seed: u64,
    /// Mounting: upright, wall, ceiling, or RHO,PHI with units; by default that of the dataset.toml beside the run, else that of the model
    #[arg(long)]
    mounting: Option<String>,
    /// Velocities of the motion: measured (where it has dq columns) or derived from the positions
    #[arg(long, default_value = "measured")]
    velocities: String,
}

/// A motion of the last joints.
pub struct Planned {
    pub plan: Plan,
    /// First joint that moves, from 1.
    pub first: usize,
    /// Joints of the arm.
    pub joints: usize,
    /// Weakest over strongest direction of the body's ten parameters.
    pub ratio: f64,
}

/// The body on the flange.
pub struct BodyOnFlange {
    pub found: Found,
    /// The stored model with the body as a term.
    pub model: ModelFile,
    /// The stored model has no uncertainty: its errors are not part of the intervals.
    pub without_uncertainty: bool,
}

/// Searches a motion of the last joints that determines the body. `stop` ends the search with the best motion so far.
///
/// # Errors
/// Options and files that can't be used; limits without a motion.
pub fn plan(options: &Options, stop: &(dyn Fn() -> bool + Sync)) -> Result<Planned, Failure> {
    let (file, robot) = &models::load(&options.model)?;
    let bad = |option: &str, found: String, expected: &str| BadInput::new("command line", option, found, expected);
    let n = robot.chain.len();
    if !(0.1..=1000.0).contains(&options.period) || (options.period * 1e3).fract().abs() > 1e-6 {
        let expected = "0.1 to 1000 s, in whole milliseconds";
        return Err(bad("--period", options.period.to_string(), expected).into());
    }
    if !(1..=n).contains(&options.joints) {
        return Err(bad("--joints", options.joints.to_string(), &format!("1 to {n}")).into());
    }
    if let Some(pose) = options.pose.as_ref().filter(|pose| pose.len() != n) {
        return Err(bad("--pose", format!("{} angles", pose.len()), &format!("{n} angles in rad")).into());
    }
    let mounting = match &options.mounting {
        Some(text) => parse_mounting("--mounting", text)?,
        None => file.model.mountings().first().copied().unwrap_or(Mounting::UPRIGHT),
    };
    let structure = with_body(&file.model).map_err(|error| refused(options, error))?;
    let sigma: Vec<f64> = match &file.uncertainty {
        Some(known) => known.residual_std.iter().map(|std| std.max(1e-6)).collect(),
        None => robot.limits.tau[..n].iter().map(|tau| tau * 1e-3).collect(),
    };
    let task = Task {
        robot,
        mounting,
        room: Room::of((robot.limits, robot.envelope), robot.workspace, false),
        margins: Margins::default(),
        nominal: None,
        q0: options.pose.as_deref(),
    };
    let search =
        Search { period: options.period, starts: options.starts as usize, seed: options.seed, ..Search::default() };
    let score = |fourier: &Fourier| Some(determined(&structure, &motion(fourier, &mounting), &sigma));
    let control = SearchControl { threads: threads(), stop, progress: &|_| {} };
    let moving = n - options.joints..n;
    let found = task
        .with_problem(|problem| best_by_score(problem, &search, moving, &score, &control))
        .map_err(|error| no_plan("command line", error))?;
    let fourier = found.fourier().map_err(Failure::job)?;
    let ratio = determined(&structure, &motion(&fourier, &mounting), &sigma);
    Ok(Planned { plan: found, first: n - options.joints + 1, joints: n, ratio })
}

/// One period at 100 Hz.
fn motion(fourier: &Fourier, mounting: &Mounting) -> Motion {
    let (dt, n) = (0.01, fourier.joints());
    let samples = (fourier.period / dt).round().max(2.0) as usize;
    let of = |what: fn(&plumbline_excite::Point) -> f64| {
        nalgebra::DMatrix::from_fn(samples, n, |k, j| what(&fourier.at(j, k as f64 * dt)))
    };
    Motion {
        dt,
        q: of(|point| point.q),
        dq: of(|point| point.dq),
        ddq: of(|point| point.ddq),
        gravity: mounting.gravity(),
        periodic: true,
        start: 0.0,
    }
}

/// Finds the body along the recorded motion `run`, against the stored model.
///
/// # Errors
/// Options and files that can't be used; a motion that leaves the body undetermined.
pub fn find(options: &Options, run: &Path) -> Result<BodyOnFlange, Failure> {
    let (file, _) = &models::load(&options.model)?;
    let source = Source { model: &options.model, run, mounting: options.mounting.as_deref(), force: false };
    let (recorded, _) = predict::motion(&source, &file.model, file.provenance.robot_description.as_deref())?;
    let name = || run.display().to_string();
    if recorded.data.tau.ncols() == 0 {
        return Err(BadInput::new(name(), "line 1", "no torques", "tau1..taun").into());
    }
    if let Err(error) = file.model.valid_in(&recorded.data.mounting) {
        let expected = "a model that holds in the mounting of the run";
        return Err(BadInput::new(options.model.display().to_string(), "key `kind`", error, expected).into());
    }
    let measured_velocities = crate::analysis::pipeline::measured_velocities(&options.velocities)?;
    let settings = Settings { measured_velocities, ..Settings::default() };
    let experiment = Experiment::prepare(&recorded.data, &settings).map_err(|error| {
        BadInput::new(name(), "samples", error, "a run that is long and even enough for the filters")
    })?;
    let found = payload::find(&file.model, file.uncertainty.as_ref(), &[experiment])
        .map_err(|error| refused(options, error))?;
    let since = options.model.file_name().map_or("the model".into(), |name| name.to_string_lossy().into_owned());
    let model = ModelFile {
        model: found.model.clone(),
        validation: Vec::new(),
        uncertainty: None,
        consistent: None,
        provenance: Provenance { source: Some(since), ..file.provenance.clone() },
        noise_floor: file.noise_floor.clone(),
    };
    Ok(BodyOnFlange { found, model, without_uncertainty: file.uncertainty.is_none() })
}

fn refused(options: &Options, error: PayloadError) -> Failure {
    match error {
        PayloadError::Undetermined { .. } | PayloadError::HasBody => {
            let expected = "a model without a body on its last link, and a motion that turns the wrist";
            BadInput::new(options.model.display().to_string(), "payload", error, expected).into()
        }
        other => Failure::job(other),
    }
}
