//! `plumbline plan`, and the planning of a job's motions.

use super::programme::Programme;
use super::say::say;
use super::signals::Ending;
use super::{Failure, friction_structure, models, progress};
use crate::config::job::Job;
use crate::config::units::parse_mounting;
use crate::store::{load_plan, save_plan};
use clap::{Args, ValueEnum};
use plumbline_core::BadInput;
use plumbline_core::threads;
use plumbline_core::{Limits, SpeedEnvelope, Workspace};
use plumbline_excite::ExciteError;
use plumbline_excite::criterion::{Criterion, check_excitation};
use plumbline_excite::fourier::Fourier;
use plumbline_excite::limits::{Bounds, Margins};
use plumbline_excite::nominal::Nominal;
use plumbline_excite::optimiser::optimise;
use plumbline_excite::plan::{Plan, PlanUsage};
use plumbline_excite::search::{self, Problem, Progress, Search, Watch, verdict};
use plumbline_excite::usage::{Usage, check_usage, usage};
use plumbline_franka::RobotLimits;
use plumbline_model::gravity::Mounting;
use plumbline_model::robot::Robot;
use plumbline_rt::moves::MoveFactors;
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Options of `plumbline plan`.
#[derive(Args)]
pub struct Options {
    /// Robot: a shipped name such as panda, or the path of a robot description
    #[arg(long)]
    robot: String,
    /// Mounting: upright, wall, ceiling, or RHO,PHI with units such as "60 deg,0 deg"
    #[arg(long, default_value = "upright")]
    mounting: String,
    /// Plan file to write; several motions become plan-1.toml, plan-2.toml, .., plan-validate-1.toml, ..
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// What is made small
    #[arg(long, value_enum, default_value_t = Goal::Raw)]
    criterion: Goal,
    /// Nominal model (a model file): torques and torque rates are held to the limits, too
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Motions to identify from; each one complements those before it
    #[arg(long, value_name = "K", default_value_t = 1, value_parser = clap::value_parser!(u64).range(1..=100))]
    trajectories: u64,
    /// Random motions to validate with
    #[arg(long, value_name = "K", default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=100))]
    validate: u64,
    /// Period of the motion in s
    #[arg(long, default_value_t = 10.0)]
    period: f64,
    /// Harmonics per joint
    #[arg(long, default_value_t = 5)]
    harmonics: usize,
    /// Random motions that the search descends from; the best quarter is seen through
    #[arg(long, default_value_t = 32)]
    starts: usize,
    /// Rounds in which the best motions are shaken and descended again
    #[arg(long, default_value_t = 6)]
    rounds: usize,
    /// Search each motion for this long instead of --rounds; the result then depends on the machine's speed
    #[arg(long, value_name = "S", conflicts_with = "rounds")]
    seconds: Option<f64>,
    /// Seed of the search: the same seed finds the same motions
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Keep the surfaces of the links from link 3 on in the robot's box, too, not the end effector alone
    #[arg(long)]
    links_in_box: bool,
}

/// The criteria by their names on the command line.
#[derive(Clone, Copy, ValueEnum)]
enum Goal {
    /// Condition number of the stacked base regressor
    Raw,
    /// The same without the friction columns
    RawRigid,
    /// Condition number with every column divided by its norm
    Equilibrated,
    /// Condition number with every row divided by its joint's noise
    Weighted,
    /// Volume of the parameters' confidence ellipsoid
    LogDet,
}

impl From<Goal> for Criterion {
    fn from(goal: Goal) -> Criterion {
        match goal {
            Goal::Raw => Criterion::Raw,
            Goal::RawRigid => Criterion::RawRigid,
            Goal::Equilibrated => Criterion::Equilibrated,
            Goal::Weighted => Criterion::Weighted,
            Goal::LogDet => Criterion::LogDet,
        }
    }
}

/// Share of the room that a validation motion uses.
const VALIDATION_AMPLITUDE: f64 = 0.7;
/// Rounds of a search that ends by the clock.
const ENDLESS: usize = 100_000;
/// Distance of the seeds of validation motions from those of the search.
const VALIDATION_SEED: u64 = 1_000_003;

/// Optimises motions and writes them.
pub fn run(options: Options) -> Result<(), Failure> {
    let robot = Robot::load(&options.robot, None)?;
    let mounting = parse_mounting("--mounting", &options.mounting)?;
    let search = options.search()?;
    let nominal = options.model.as_deref().map(|path| nominal(path, &robot)).transpose()?;
    let task = Task {
        robot: &robot,
        mounting,
        room: Room::of((robot.limits, robot.envelope), robot.workspace, options.links_in_box),
        margins: Margins::default(),
        nominal: nominal.as_ref(),
        q0: None,
    };
    let ending = Ending::interrupts()?;
    let mut done: Vec<Fourier> = Vec::new();
    for k in 1..=options.trajectories {
        let plan = options.one(&task, &Search { seed: search.seed + (k - 1), ..search.clone() }, &done, &ending)?;
        done.push(motion(&plan)?);
        options.leave(&plan, &options.name("", k, options.trajectories), &done, &task)?;
        if ending.arrived() {
            // Nobody asked for half-searched motions after this one.
            return Ok(());
        }
    }
    for k in 1..=options.validate {
        let plan = task
            .random(&Search { seed: search.seed + VALIDATION_SEED + k, ..search.clone() })
            .map_err(|error| no_plan("command line", error))?;
        options.leave(&plan, &options.name("-validate", k, 100), &[], &task)?;
    }
    Ok(())
}

impl Options {
    fn search(&self) -> Result<Search, BadInput> {
        let bad =
            |option: &str, value: String, expected: &str| Err(BadInput::new("command line", option, value, expected));
        if !(self.period >= 0.1 && self.period <= 1000.0 && (self.period * 1e3).fract().abs() < 1e-6) {
            return bad("--period", self.period.to_string(), "0.1 to 1000 s, in whole milliseconds");
        }
        if let Some(seconds) = self.seconds
            && !(seconds > 0.0 && seconds <= 1e6)
        {
            return bad("--seconds", seconds.to_string(), "a time above 0 s");
        }
        let rounds = if self.seconds.is_some() { ENDLESS } else { self.rounds };
        let (period, harmonics, starts, seed) = (self.period, self.harmonics, self.starts, self.seed);
        Ok(Search { period, harmonics, criterion: self.criterion.into(), starts, rounds, seed, ..Search::default() })
    }

    /// One search, with a bar, by the clock where asked; ctrl-C ends it with the best so far.
    fn one(&self, task: &Task, search: &Search, prior: &[Fourier], ending: &Ending) -> Result<Plan, Failure> {
        let start = Instant::now();
        let limit = self.seconds.map(Duration::from_secs_f64);
        let bar = progress::bar("planning");
        let hear = |now: Progress| {
            let share = match limit {
                Some(limit) => start.elapsed().as_secs_f64() / limit.as_secs_f64(),
                None => now.done as f64 / now.of as f64,
            };
            let best = if now.best.is_finite() { format!("best {:.2}", now.best) } else { "no motion yet".into() };
            bar.at(share, &best);
        };
        let stop = || ending.arrived() || limit.is_some_and(|limit| start.elapsed() > limit);
        let watch = Watch { threads: threads(), stop: &stop, progress: &hear };
        let plan = task.best(search, prior, &watch).map_err(|error| no_plan("command line", error))?;
        bar.done();
        if ending.arrived() {
            eprintln!("plumbline: interrupted; the best motion so far is kept");
        }
        Ok(plan)
    }

    /// `plan.toml` for a motion alone, else `plan-2.toml` or `plan-validate-2.toml`.
    fn name(&self, kind: &str, k: u64, of: u64) -> PathBuf {
        if of == 1 && kind.is_empty() {
            return self.out.clone();
        }
        let stem = self.out.file_stem().map_or("plan".into(), |stem| stem.to_string_lossy().into_owned());
        let extension =
            self.out.extension().map_or("toml".into(), |extension| extension.to_string_lossy().into_owned());
        self.out.with_file_name(format!("{stem}{kind}-{k}.{extension}"))
    }

    /// Writes a plan and says how good it is.
    fn leave(&self, plan: &Plan, path: &Path, set: &[Fourier], task: &Task) -> Result<(), Failure> {
        save_plan(plan, path).map_err(Failure::job)?;
        say!("{}: condition {}", path.display(), super::conditions_text(&plan.conditions));
        if let Some(usage) = &plan.usage {
            say!("  {}", usage_text(usage));
        }
        if set.len() > 1 {
            let together = task.with_problem(|problem| search::together(problem, set));
            say!("  with the {} before it: condition {}", set.len() - 1, super::conditions_text(&together));
        }
        Ok(())
    }
}

/// Shares of range and speed per joint, in one line.
fn usage_text(usage: &PlanUsage) -> String {
    let percent = |shares: &[f64]| shares.iter().map(|x| format!("{:.0}", 100.0 * x)).collect::<Vec<_>>().join(" ");
    format!("used per joint [%]: range {}, speed {}", percent(&usage.range), percent(&usage.speed))
}

/// The nominal model in a file.
fn nominal(path: &Path, robot: &Robot) -> Result<Nominal, Failure> {
    let file = path.display().to_string();
    let text =
        std::fs::read_to_string(path).map_err(|error| BadInput::new(&file, "file", error, "a readable model file"))?;
    let model = models::of_robot(&file, &text, robot, "the robot that is planned for")?.model;
    let left_out = Nominal::left_out(&model);
    if !left_out.is_empty() {
        tracing::warn!("{file}: a plan's torques are those without {}", left_out.join(", "));
    }
    Nominal::of(&model).map_err(|error| {
        let expected = "a model of rigid body, friction, torque-offset, rotor-inertia and effects";
        BadInput::new(&file, "term", error, expected).into()
    })
}

/// The limits of the arm that a job drives, as it serves them; `None` for a simulated arm, whose limits are those of the robot file. Connects
/// for a moment; nothing moves.
pub fn arm_limits(job: &Job) -> Result<Option<RobotLimits>, Failure> {
    let Some(franka) = &job.backend.franka else { return Ok(None) };
    let settings = franka.settings(job, plumbline_franka::Purpose::Watch)?;
    plumbline_franka::read_limits(&settings).map(Some).map_err(Failure::job)
}

/// What motions of a job and the loop's guard are held to: the limits of robot file and job and, inside them, those that the adapter of the
/// connected `arm` holds commands to.
pub fn held_to(
    job: &Job,
    robot: &Robot,
    arm: Option<&RobotLimits>,
) -> Result<(Limits, Option<SpeedEnvelope>), Failure> {
    let limits = job.guard_limits(&robot.limits, robot.chain.len())?;
    let (Some(arm), Some(franka)) = (arm, &job.backend.franka) else { return Ok((limits, robot.envelope)) };
    let share = franka.limits_share;
    Ok((
        plumbline_franka::guard_limits(arm, &limits, share),
        plumbline_franka::guard_envelope(arm, robot.envelope.as_ref(), share),
    ))
}

/// The job's programme, inside the limits of robot, job and the connected `arm`: the plans of an earlier run of the same job where they
/// are, else new ones, which are then kept in `out/plans`.
pub fn programme(job: &Job, robot: &Robot, out: &Path, arm: Option<&RobotLimits>) -> Result<Programme, Failure> {
    let dir = out.join("plans");
    let planner = Planner::of(job, robot, arm)?;
    let stamp = planner.fingerprint();
    let stamp_file = dir.join("planned-for");
    if std::fs::read_to_string(&stamp_file).is_ok_and(|text| text.trim() == stamp) {
        let known = Programme::load(job, &dir)?;
        match known.check(&planner, &dir) {
            Ok(()) => return Ok(known),
            Err(broken) => tracing::warn!("the plans in {} are not driven, new ones are made: {broken}", dir.display()),
        }
    }
    let bar = progress::bar("planning");
    let programme = Programme::plan(&planner, &|name, share| bar.at(share, name))?;
    bar.done();
    programme.save(&dir)?;
    crate::atomic::write_file(&stamp_file, stamp.as_bytes()).map_err(Failure::job)?;
    Ok(programme)
}

/// What plans the motions of a job.
pub struct Planner<'a> {
    /// The job.
    pub job: &'a Job,
    /// Its robot.
    pub robot: &'a Robot,
    room: Room,
    nominal: Option<Nominal>,
}

impl<'a> Planner<'a> {
    /// Reads what the job names; `arm` is the connected arm. Errors on limits that are none, and on a nominal model that can't be read.
    pub fn of(job: &'a Job, robot: &'a Robot, arm: Option<&RobotLimits>) -> Result<Planner<'a>, Failure> {
        let held_to = held_to(job, robot, arm)?;
        let nominal = job.excitation.model.as_deref().map(|path| nominal(path, robot)).transpose()?;
        let links_in_box = job.workspace.is_some_and(|own| own.links_in_box);
        let room = Room::of(held_to, job.workspace(&robot.workspace), links_in_box);
        Ok(Planner { job, robot, room, nominal })
    }

    /// Hash of everything that the plans depend on.
    fn fingerprint(&self) -> String {
        let Planner { job, robot, room, nominal } = self;
        let parts = (&job.excitation, &job.validation, &job.limits, &job.mounting, robot, room, nominal);
        let version = env!("CARGO_PKG_VERSION");
        Sha256::digest(format!("{version} {parts:?}")).iter().map(|byte| format!("{byte:02x}")).collect()
    }

    /// The motion to identify from: the job's own plan file, or the best that a search finds.
    pub fn best(&self, mounting: &Mounting, seed: u64, progress: &(dyn Fn(f64) + Sync)) -> Result<Plan, Failure> {
        if let (Some(path), true) = (&self.job.excitation.plan, *mounting == self.job.mounting) {
            let plan = load_plan(path)?;
            self.check(&plan, path).map_err(|broken| self.other_plan(broken))?;
            let usage = PlanUsage::of(&self.usage(&motion(&plan)?));
            return Ok(Plan { usage: Some(usage), ..plan });
        }
        let hear = |now: Progress| progress(now.done as f64 / now.of as f64);
        let watch = Watch { threads: threads(), stop: &|| false, progress: &hear };
        self.task(mounting, self.job.margins())
            .best(&self.search(seed), &[], &watch)
            .map_err(|error| self.no_plan(error))
    }

    /// Says what to do about a plan that the job names and that can't be driven.
    fn other_plan(&self, broken: Failure) -> Failure {
        let job = self.job.file.display();
        let next = format!(
            "Without `excitation.plan` in {job}, `plumbline run {job}` plans a motion under the limits of this job and its arm"
        );
        match broken {
            Failure::Input(bad) => Failure::Input(BadInput { expected: format!("{}. {next}", bad.expected), ..bad }),
            Failure::Job(what) => Failure::Job(format!("{what}. {next}")),
        }
    }

    /// A random motion to judge the model by.
    pub fn random(&self, mounting: &Mounting, seed: u64) -> Result<Plan, Failure> {
        self.task(mounting, self.job.margins()).random(&self.search(seed)).map_err(|error| self.no_plan(error))
    }

    /// Checks that a plan from a file fits the job's robot, keeps every limit, margins apart, at 1 kHz, passes the guard, and moves every joint.
    pub fn check(&self, plan: &Plan, path: &Path) -> Result<(), Failure> {
        let file = path.display().to_string();
        if plan.robot != self.robot.name {
            return Err(BadInput::new(&file, "key `robot`", &plan.robot, format!("`{}`", self.robot.name)).into());
        }
        let fourier = plan.fourier().map_err(|error| infeasible(&file, &error))?;
        if fourier.joints() != self.robot.chain.len() {
            let expected = format!("{} joints", self.robot.chain.len());
            return Err(BadInput::new(&file, "key `q0`", format!("{} joints", fourier.joints()), expected).into());
        }
        let verdict = self.task(&plan.mounting(), Margins::none()).with_problem(|problem| verdict(problem, &fourier));
        if let Some(peak) = verdict.violations().next() {
            let expected = match self.job.backend.franka {
                Some(_) => "a motion inside every limit of the job and of the connected arm",
                None => "a motion inside every limit of the job",
            };
            return Err(BadInput::new(&file, "motion", peak, expected).into());
        }
        check_usage(&self.usage(&fourier), None, 1).map_err(|error| no_plan(&file, error))
    }

    /// How much of each joint's limits a motion uses.
    pub fn usage(&self, fourier: &Fourier) -> Vec<Usage> {
        usage(&self.room.bounds(self.robot, self.job.margins()), fourier)
    }

    /// Checks that motions in one mounting together determine every parameter.
    pub fn check_excitation(&self, mounting: &Mounting, motions: &[Fourier]) -> Result<(), Failure> {
        let task = self.task(mounting, Margins::none());
        let determined =
            task.with_problem(|problem| check_excitation(problem.structure, &search::all(problem, motions)));
        determined.map_err(|error| self.no_plan(error))
    }

    /// What the arm is held to on the ways between motions: everything to its full.
    pub fn bounds(&self) -> Bounds<'_> {
        self.room.bounds(self.robot, Margins::none())
    }

    fn task(&self, mounting: &Mounting, margins: Margins) -> Task<'_> {
        Task {
            robot: self.robot,
            mounting: *mounting,
            room: self.room,
            margins,
            nominal: self.nominal.as_ref(),
            q0: self.job.excitation.q0.as_deref(),
        }
    }

    fn search(&self, seed: u64) -> Search {
        let excitation = &self.job.excitation;
        Search {
            period: excitation.period,
            harmonics: excitation.harmonics,
            criterion: excitation.criterion,
            starts: excitation.starts,
            rounds: excitation.rounds,
            seed,
            ..Search::default()
        }
    }

    fn no_plan(&self, error: ExciteError) -> Failure {
        no_plan(&self.job.file.display().to_string(), error)
    }
}

/// A search without a plan: a failed job where motions were found and none is of use, else bad input.
fn no_plan(file: &str, error: ExciteError) -> Failure {
    match error {
        ExciteError::Frozen { .. } => Failure::job(format!(
            "{file}: {error}. Give the joint more room: wider limits or box, another start pose, or another period"
        )),
        ExciteError::Unexcited { .. } => Failure::job(format!(
            "{file}: {error}. Search longer (more starts), or give the arm more room: wider limits or box, more speed, a longer period"
        )),
        _ => infeasible(file, &error),
    }
}

fn infeasible(file: &str, error: &ExciteError) -> Failure {
    BadInput::new(file, "excitation", error, "a start pose and limits that leave room for a motion").into()
}

/// Where an arm may move, and how fast.
#[derive(Clone, Copy, Debug)]
struct Room {
    limits: Limits,
    workspace: Workspace,
    links_in_box: bool,
    envelope: Option<SpeedEnvelope>,
}

impl Room {
    /// The speed envelope is that which the loop's guard holds motions to: a stop has to stay under it, too.
    fn of((limits, envelope): (Limits, Option<SpeedEnvelope>), workspace: Workspace, links_in_box: bool) -> Room {
        let ddq = limits.ddq.map(|ddq| MoveFactors::default().brake * ddq);
        Room { limits, workspace, links_in_box, envelope: envelope.map(|envelope| envelope.braked_with(&ddq)) }
    }

    fn bounds<'a>(&'a self, robot: &'a Robot, margins: Margins) -> Bounds<'a> {
        Bounds {
            workspace: Some(&self.workspace),
            shape: Some(&robot.shape),
            links_in_box: self.links_in_box,
            envelope: self.envelope.as_ref(),
            ..Bounds::new(&robot.chain, &self.limits, margins)
        }
    }
}

/// One search: the arm, its mounting and what it is held to.
struct Task<'a> {
    robot: &'a Robot,
    mounting: Mounting,
    room: Room,
    margins: Margins,
    nominal: Option<&'a Nominal>,
    q0: Option<&'a [f64]>,
}

impl Task<'_> {
    fn best(&self, search: &Search, prior: &[Fourier], watch: &Watch) -> Result<Plan, ExciteError> {
        self.with_problem(|problem| optimise(problem, search, prior, watch))
    }

    fn random(&self, search: &Search) -> Result<Plan, ExciteError> {
        self.with_problem(|problem| search::random(problem, search, VALIDATION_AMPLITUDE))
    }

    fn with_problem<T>(&self, find: impl FnOnce(&Problem) -> T) -> T {
        let n = self.robot.chain.len();
        let structure = friction_structure(self.robot, &self.mounting);
        // Before anything is measured, the torque range of a joint stands for the size of its noise.
        let sigma: Vec<f64> = self.room.limits.tau[..n].iter().map(|tau| tau * 1e-3).collect();
        find(&Problem {
            robot: &self.robot.name,
            structure: &structure,
            mounting: self.mounting,
            bounds: self.room.bounds(self.robot, self.margins),
            nominal: self.nominal,
            sigma: &sigma,
            q0: self.q0,
        })
    }
}

/// The motion of a plan that was checked before.
pub fn motion(plan: &Plan) -> Result<Fourier, Failure> {
    plan.fourier().map_err(Failure::job)
}
