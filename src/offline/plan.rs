//! Search of motions that determine the parameters.

use crate::config::units::parse_mounting;
use crate::failure::Failure;
use crate::process::progress;
use crate::setup::planner::{Room, Task, motion, no_plan, nominal};
use clap::{Args, ValueEnum};
use plumbline_core::{BadInput, threads};
use plumbline_excite::{Criterion, Fourier, Margins, Plan, Progress, Search, SearchControl};
use plumbline_model::{Conditions, Robot};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Options of [`plan`], in the words of `plumbline plan`.
#[derive(Args)]
#[group(id = "plan")]
pub struct Options {
    /// Robot: a shipped name such as panda, or the path of a robot description
    #[arg(long)]
    pub robot: Option<String>,
    /// Mounting: upright, wall, ceiling, or RHO,PHI with units such as "60 deg,0 deg"
    #[arg(long, default_value = "upright")]
    mounting: String,
    /// Criterion to minimise
    #[arg(long, value_enum, default_value_t = Goal::Raw)]
    criterion: Goal,
    /// Nominal model (a model file): with it, torques and torque rates are limited, too
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
    /// Random starting motions of the search; the best quarter is optimised fully
    #[arg(long, default_value_t = 32)]
    starts: usize,
    /// Rounds in which the best motions are perturbed and optimised again
    #[arg(long, default_value_t = 6)]
    rounds: usize,
    /// Search each motion for this long instead of --rounds; the result then depends on the machine's speed
    #[arg(long, value_name = "S", conflicts_with = "rounds")]
    seconds: Option<f64>,
    /// Seed of the search: the same seed finds the same motions
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Keep also the links from link 3 on inside the workspace box, not only the end effector
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

const UNLIMITED_ROUNDS: usize = 100_000;
/// Offset of the seeds of validation motions from those of the search.
const VALIDATION_SEED_OFFSET: u64 = 1_000_003;

/// A motion of [`plan`].
pub struct Planned {
    pub plan: Plan,
    pub purpose: Purpose,
    /// Condition numbers of this motion with those before it, where there are any.
    pub together: Option<Conditions>,
}

/// What a planned motion is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// To identify from: motion `number` of `of`, from 1.
    Identify { number: u64, of: u64 },
    /// To validate with: motion `number`, from 1.
    Validate { number: u64 },
}

/// Searches the motions one by one and hands each to `found`. `stop` ends the search: the motion that is searched for then is the best so far, and no
/// further one follows.
///
/// # Errors
/// Options that can't be used, limits without a motion, and errors of `found`.
pub fn plan(
    options: &Options,
    stop: &(dyn Fn() -> bool + Sync),
    found: &mut dyn FnMut(Planned) -> Result<(), Failure>,
) -> Result<(), Failure> {
    let robot = options.robot()?;
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
    let mut done: Vec<Fourier> = Vec::new();
    for number in 1..=options.trajectories {
        let plan =
            options.search_one(&task, &Search { seed: search.seed + (number - 1), ..search.clone() }, &done, stop)?;
        done.push(motion(&plan)?);
        let stacked = || task.with_problem(|problem| plumbline_excite::stacked_conditions(problem, &done));
        let together = (done.len() > 1).then(stacked);
        found(Planned { plan, purpose: Purpose::Identify { number, of: options.trajectories }, together })?;
        if stop() {
            return Ok(());
        }
    }
    for number in 1..=options.validate {
        let plan = task
            .random(&Search { seed: search.seed + VALIDATION_SEED_OFFSET + number, ..search.clone() })
            .map_err(|error| no_plan("command line", error))?;
        found(Planned { plan, purpose: Purpose::Validate { number }, together: None })?;
    }
    Ok(())
}

impl Options {
    /// The robot to plan for.
    ///
    /// # Errors
    /// No robot, or a description that can't be read.
    pub fn robot(&self) -> Result<Robot, Failure> {
        match &self.robot {
            Some(robot) => Ok(Robot::load(robot, None)?),
            None => Err(BadInput::new("command line", "--robot", "no robot", "--robot R").into()),
        }
    }

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
        let rounds = if self.seconds.is_some() { UNLIMITED_ROUNDS } else { self.rounds };
        let (period, harmonics, starts, seed) = (self.period, self.harmonics, self.starts, self.seed);
        Ok(Search { period, harmonics, criterion: self.criterion.into(), starts, rounds, seed, ..Search::default() })
    }

    /// One search with a progress bar. A time limit or `stop` ends it with the best motion so far.
    fn search_one(
        &self,
        task: &Task,
        search: &Search,
        prior: &[Fourier],
        stop: &(dyn Fn() -> bool + Sync),
    ) -> Result<Plan, Failure> {
        let start = Instant::now();
        let limit = self.seconds.map(Duration::from_secs_f64);
        let bar = progress::bar("planning");
        let report = |now: Progress| {
            let share = match limit {
                Some(limit) => start.elapsed().as_secs_f64() / limit.as_secs_f64(),
                None => now.done as f64 / now.of as f64,
            };
            let best = if now.best.is_finite() { format!("best {:.2}", now.best) } else { "no motion yet".into() };
            bar.at(share, &best);
        };
        let stop = || stop() || limit.is_some_and(|limit| start.elapsed() > limit);
        let watch = SearchControl { threads: threads(), stop: &stop, progress: &report };
        let plan = task.best(search, prior, &watch).map_err(|error| no_plan("command line", error))?;
        bar.done();
        Ok(plan)
    }
}
