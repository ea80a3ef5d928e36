//! `plumbline plan`, and the planning of a job's motions.

use super::programme::Programme;
use super::{Failure, friction_structure, progress};
use crate::config::job::Job;
use crate::config::robot::Robot;
use crate::config::units::parse_mounting;
use crate::excite::ExciteError;
use crate::excite::fourier::Fourier;
use crate::excite::limits::{Bounds, Margins, verify};
use crate::excite::plan::Plan;
use crate::excite::search::{self, Problem, Search};
use crate::input::BadInput;
use crate::joint::{Limits, Workspace};
use crate::model::gravity::Mounting;
use crate::store::{load_plan, save_plan};
use clap::Args;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Options of `plumbline plan`.
#[derive(Args)]
pub struct Options {
    /// Robot: a shipped name such as panda, or the path of a robot description
    #[arg(long)]
    robot: String,
    /// Mounting: upright, wall, ceiling, or RHO,PHI with units such as "60 deg,0 deg"
    #[arg(long, default_value = "upright")]
    mounting: String,
    /// Plan file to write
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Period of the motion [s]
    #[arg(long, default_value_t = 10.0)]
    period: f64,
    /// Harmonics per joint
    #[arg(long, default_value_t = 5)]
    harmonics: usize,
    /// Candidate motions that the search may try
    #[arg(long, default_value_t = 4000)]
    evaluations: usize,
    /// Seed of the search
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Grid of the search: samples per period.
const COARSE: usize = 100;
/// Share of the room that a validation motion uses.
const VALIDATION_AMPLITUDE: f64 = 0.7;

/// Optimises a motion and writes it.
pub fn run(options: Options) -> Result<(), Failure> {
    let robot = Robot::load(&options.robot, None)?;
    let mounting = parse_mounting("--mounting", &options.mounting)?;
    let search = Search {
        period: options.period,
        harmonics: options.harmonics,
        evaluations: options.evaluations,
        samples: COARSE,
        seed: options.seed,
    };
    let task = Task {
        robot: &robot,
        mounting,
        limits: robot.limits,
        workspace: robot.workspace,
        margins: Margins::default(),
        q0: None,
    };
    let bar = progress::bar("planning");
    let plan = task
        .best(&search, &mut |share, best| bar.at(share, &format!("raw condition {best:.1}")))
        .map_err(|error| infeasible("command line", &error))?;
    bar.done();
    save_plan(&plan, &options.out).map_err(Failure::job)?;
    println!("{}: condition {}", options.out.display(), super::conditions_text(&plan.conditions));
    Ok(())
}

/// The job's programme: the plans of an earlier run of the same job, or new ones, which are then kept in `out/plans`.
pub fn programme(job: &Job, robot: &Robot, out: &Path) -> Result<Programme, Failure> {
    let dir = out.join("plans");
    let stamp = fingerprint(job, robot);
    let stamp_file = dir.join("planned-for");
    if std::fs::read_to_string(&stamp_file).is_ok_and(|text| text.trim() == stamp) {
        return Programme::load(job, robot, &dir);
    }
    let bar = progress::bar("planning");
    let programme = Programme::plan(job, robot, &mut |name, share| bar.at(share, name))?;
    bar.done();
    programme.save(&dir)?;
    crate::atomic::write_file(&stamp_file, stamp.as_bytes()).map_err(Failure::job)?;
    Ok(programme)
}

/// Hash of everything that the plans depend on.
fn fingerprint(job: &Job, robot: &Robot) -> String {
    let parts = (&job.excitation, &job.validation, &job.limits, &job.workspace, &job.mounting, robot);
    let version = env!("CARGO_PKG_VERSION");
    Sha256::digest(format!("{version} {parts:?}")).iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The motion to identify from: the job's own plan file, or the best that a search finds.
pub fn best(
    job: &Job,
    robot: &Robot,
    mounting: &Mounting,
    seed: u64,
    progress: &mut dyn FnMut(f64),
) -> Result<Plan, Failure> {
    if let (Some(path), true) = (&job.excitation.plan, *mounting == job.mounting) {
        let plan = load_plan(path)?;
        check(job, robot, &plan, path)?;
        return Ok(plan);
    }
    let search = search(job, job.excitation.evaluations, seed);
    let task = Task::of(job, robot, mounting)?;
    task.best(&search, &mut |share, _| progress(share))
        .map_err(|error| infeasible(&job.file.display().to_string(), &error))
}

/// A random motion to judge the model by.
pub fn random(
    job: &Job,
    robot: &Robot,
    mounting: &Mounting,
    seed: u64,
    progress: &mut dyn FnMut(f64),
) -> Result<Plan, Failure> {
    let task = Task::of(job, robot, mounting)?;
    let plan =
        task.random(&search(job, 1, seed)).map_err(|error| infeasible(&job.file.display().to_string(), &error))?;
    progress(1.0);
    Ok(plan)
}

/// Checks that a plan from a file fits the job's robot and keeps the limits that the guard will hold it to.
pub fn check(job: &Job, robot: &Robot, plan: &Plan, path: &Path) -> Result<(), Failure> {
    let file = path.display().to_string();
    if plan.robot != robot.name {
        return Err(BadInput::new(&file, "key `robot`", &plan.robot, format!("`{}`", robot.name)).into());
    }
    let fourier = plan.fourier().map_err(|error| infeasible(&file, &error))?;
    if fourier.joints() != robot.chain.len() {
        let expected = format!("{} joints", robot.chain.len());
        return Err(BadInput::new(&file, "key `q0`", format!("{} joints", fourier.joints()), expected).into());
    }
    let limits = job.guard_limits(&robot.limits, robot.chain.len())?;
    let workspace = job.workspace(&robot.workspace);
    let whole = Margins {
        position: 0.0,
        velocity: 1.0,
        acceleration: 1.0,
        jerk: 1.0,
        torque: 1.0,
        torque_rate: 1.0,
        workspace: 0.0,
    };
    let bounds = Bounds { chain: &robot.chain, limits: &limits, workspace: Some(&workspace), margins: whole };
    let verdict = verify(&bounds, &fourier, None);
    match verdict.violations().next() {
        Some(peak) => Err(BadInput::new(&file, "motion", peak, "a motion inside every limit of the job").into()),
        None => Ok(()),
    }
}

fn search(job: &Job, evaluations: usize, seed: u64) -> Search {
    let excitation = &job.excitation;
    let (period, harmonics) = (excitation.period, excitation.harmonics);
    Search { period, harmonics, evaluations, samples: COARSE, seed }
}

fn infeasible(file: &str, error: &ExciteError) -> Failure {
    BadInput::new(file, "excitation", error, "a start pose and limits that leave room for a motion").into()
}

/// One search: the arm, its mounting and what it is held to.
struct Task<'a> {
    robot: &'a Robot,
    mounting: Mounting,
    limits: Limits,
    workspace: Workspace,
    margins: Margins,
    q0: Option<&'a [f64]>,
}

impl<'a> Task<'a> {
    fn of(job: &'a Job, robot: &'a Robot, mounting: &Mounting) -> Result<Task<'a>, Failure> {
        Ok(Task {
            robot,
            mounting: *mounting,
            limits: job.guard_limits(&robot.limits, robot.chain.len())?,
            workspace: job.workspace(&robot.workspace),
            margins: job.margins(),
            q0: job.excitation.q0.as_deref(),
        })
    }

    fn best(&self, search: &Search, progress: &mut dyn FnMut(f64, f64)) -> Result<Plan, ExciteError> {
        self.with_problem(|problem| {
            search::optimise(problem, search, |now| progress(now.done as f64 / now.of as f64, now.best))
        })
    }

    fn random(&self, search: &Search) -> Result<Plan, ExciteError> {
        self.with_problem(|problem| search::random(problem, search, VALIDATION_AMPLITUDE))
    }

    fn with_problem(&self, find: impl FnOnce(&Problem) -> Result<Plan, ExciteError>) -> Result<Plan, ExciteError> {
        let n = self.robot.chain.len();
        let structure = friction_structure(self.robot, &self.mounting);
        // Before anything is measured, the torque range of a joint stands for the size of its noise.
        let sigma: Vec<f64> = self.limits.tau[..n].iter().map(|tau| tau * 1e-3).collect();
        find(&Problem {
            robot: &self.robot.name,
            structure: &structure,
            mounting: self.mounting,
            bounds: Bounds {
                chain: &self.robot.chain,
                limits: &self.limits,
                workspace: Some(&self.workspace),
                margins: self.margins,
            },
            torque: None,
            sigma: &sigma,
            q0: self.q0,
        })
    }
}

/// The motion of a plan that was checked before.
pub fn motion(plan: &Plan) -> Result<Fourier, Failure> {
    plan.fourier().map_err(Failure::job)
}
