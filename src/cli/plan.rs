//! `plumbline plan`, and the planning of a job's motions.

use crate::cli::say::say;
use crate::config::units::parse_mounting;
use crate::failure::Failure;
use crate::process::progress;
use crate::process::signals::Ending;
use crate::setup::planner::{Room, Task, motion, no_plan, nominal};
use crate::store::save_plan;
use clap::{Args, ValueEnum};
use plumbline_core::{BadInput, threads};
use plumbline_excite::{Criterion, Fourier, Margins, Plan, PlanUsage, Progress, Search, SearchControl};
use plumbline_model::Robot;
use serde_json::Value;
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
    /// Print condition numbers and use of the limits as JSON, one entry per plan file
    #[arg(long)]
    json: bool,
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
    let mut written: Vec<Value> = Vec::new();
    for k in 1..=options.trajectories {
        let plan =
            options.search_one(&task, &Search { seed: search.seed + (k - 1), ..search.clone() }, &done, &ending)?;
        done.push(motion(&plan)?);
        written.push(options.write(&plan, &options.name("", k, options.trajectories), &done, &task)?);
        if ending.arrived() {
            // The remaining motions are not searched.
            break;
        }
    }
    for k in (1..=options.validate).take_while(|_| !ending.arrived()) {
        let plan = task
            .random(&Search { seed: search.seed + VALIDATION_SEED_OFFSET + k, ..search.clone() })
            .map_err(|error| no_plan("command line", error))?;
        written.push(options.write(&plan, &options.name("-validate", k, 100), &[], &task)?);
    }
    if options.json {
        say!("{}", serde_json::to_string_pretty(&written).map_err(Failure::job)?);
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
        let rounds = if self.seconds.is_some() { UNLIMITED_ROUNDS } else { self.rounds };
        let (period, harmonics, starts, seed) = (self.period, self.harmonics, self.starts, self.seed);
        Ok(Search { period, harmonics, criterion: self.criterion.into(), starts, rounds, seed, ..Search::default() })
    }

    /// One search with a progress bar. A time limit or ctrl-C ends it with the best motion so far.
    fn search_one(&self, task: &Task, search: &Search, prior: &[Fourier], ending: &Ending) -> Result<Plan, Failure> {
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
        let stop = || ending.arrived() || limit.is_some_and(|limit| start.elapsed() > limit);
        let watch = SearchControl { threads: threads(), stop: &stop, progress: &report };
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

    /// Writes a plan and prints its figures, or returns them for `--json`. `set` are the motions so far, this one the last.
    fn write(&self, plan: &Plan, path: &Path, set: &[Fourier], task: &Task) -> Result<Value, Failure> {
        save_plan(plan, path).map_err(Failure::job)?;
        let together =
            (set.len() > 1).then(|| task.with_problem(|problem| plumbline_excite::stacked_conditions(problem, set)));
        if self.json {
            let facts = crate::analysis::conditions_facts;
            return Ok(serde_json::json!({
                "file": path, "conditions": facts(&plan.conditions), "usage": plan.usage, "with_those_before": together.as_ref().map(facts),
            }));
        }
        say!("{}: condition {}", path.display(), crate::analysis::conditions_text(&plan.conditions));
        if let Some(usage) = &plan.usage {
            say!("  {}", usage_text(usage));
        }
        if let Some(together) = together {
            say!("  with the {} before it: condition {}", set.len() - 1, crate::analysis::conditions_text(&together));
        }
        Ok(Value::Null)
    }
}

/// Shares of range and speed per joint, in one line.
fn usage_text(usage: &PlanUsage) -> String {
    let percent = |shares: &[f64]| shares.iter().map(|x| format!("{:.0}", 100.0 * x)).collect::<Vec<_>>().join(" ");
    format!("used per joint [%]: range {}, speed {}", percent(&usage.range), percent(&usage.speed))
}
