//! `plumbline plan`, and the planning of a job's motions.

use crate::cli::say::say;
use crate::config::units::parse_mounting;
use crate::failure::Failure;
use crate::process::progress;
use crate::process::signals::Ending;
use crate::setup::planner::{Room, Task, motion, no_plan, nominal};
use crate::store::trajectory::{Trajectory, ros_names};
use crate::store::{load_plan, save_plan};
use clap::{Args, ValueEnum};
use plumbline_core::{BadInput, threads};
use plumbline_excite::{Criterion, Fourier, Margins, Plan, PlanUsage, Progress, Search, SearchControl};
use plumbline_model::Robot;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Options of `plumbline plan`.
#[derive(Args)]
pub struct Options {
    /// Robot: a shipped name such as panda, or the path of a robot description
    #[arg(long, required_unless_present = "of")]
    robot: Option<String>,
    /// Mounting: upright, wall, ceiling, or RHO,PHI with units such as "60 deg,0 deg"
    #[arg(long, default_value = "upright")]
    mounting: String,
    /// Plan file to write; several motions become plan-1.toml, plan-2.toml, .., plan-validate-1.toml, ..
    #[arg(long, value_name = "FILE", required_unless_present = "of")]
    out: Option<PathBuf>,
    /// Plan nothing: write the motion of this plan file with --csv or --ros
    #[arg(long, value_name = "PLAN", conflicts_with_all = ["robot", "out"])]
    of: Option<PathBuf>,
    /// Write the motion as a table, too: t, q1..qn, dq1..dqn, ddq1..ddqn (s, rad)
    #[arg(long, value_name = "FILE")]
    csv: Option<PathBuf>,
    /// Write the motion as trajectory_msgs/JointTrajectory in YAML, too
    #[arg(long, value_name = "FILE")]
    ros: Option<PathBuf>,
    /// Samples a second of --csv and --ros in Hz; by default 1000 and 100
    #[arg(long, value_name = "HZ")]
    rate: Option<f64>,
    /// Periods in --csv and --ros
    #[arg(long, value_name = "K", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=10_000))]
    periods: u32,
    /// Names of the joints in --ros, base first; by default those of Universal Robots' driver, else panda_joint1, ..
    #[arg(long, value_name = "NAME,..", value_delimiter = ',')]
    joint_names: Option<Vec<String>>,
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

/// Sampling of a table: that of a controller's loop \[Hz\].
const CSV_RATE_HZ: f64 = 1000.0;
/// Sampling for ROS \[Hz\]: its controllers interpolate.
const ROS_RATE_HZ: f64 = 100.0;
const UNLIMITED_ROUNDS: usize = 100_000;
/// Offset of the seeds of validation motions from those of the search.
const VALIDATION_SEED_OFFSET: u64 = 1_000_003;

pub fn run(options: Options) -> Result<(), Failure> {
    options.check_trajectory()?;
    if let Some(of) = &options.of {
        let plan = load_plan(of)?;
        return options.write_trajectory(&plan, "", 1, 1);
    }
    let (Some(robot), Some(out)) = (&options.robot, &options.out) else {
        return Err(BadInput::new(
            "command line",
            "--robot",
            "no robot or no --out",
            "--robot R --out FILE, or --of PLAN",
        )
        .into());
    };
    let robot = Robot::load(robot, None)?;
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
        let plan =
            options.search_one(&task, &Search { seed: search.seed + (k - 1), ..search.clone() }, &done, &ending)?;
        done.push(motion(&plan)?);
        options.write(&plan, &options.name(out, "", k, options.trajectories), &done, &task)?;
        options.write_trajectory(&plan, "", k, options.trajectories)?;
        if ending.arrived() {
            // The remaining motions are not searched.
            return Ok(());
        }
    }
    for k in 1..=options.validate {
        let plan = task
            .random(&Search { seed: search.seed + VALIDATION_SEED_OFFSET + k, ..search.clone() })
            .map_err(|error| no_plan("command line", error))?;
        options.write(&plan, &options.name(out, "-validate", k, 100), &[], &task)?;
        options.write_trajectory(&plan, "-validate", k, 100)?;
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
    fn name(&self, out: &Path, kind: &str, k: u64, of: u64) -> PathBuf {
        if of == 1 && kind.is_empty() {
            return out.to_path_buf();
        }
        let stem = out.file_stem().map_or("plan".into(), |stem| stem.to_string_lossy().into_owned());
        let extension = out.extension().map_or("toml".into(), |extension| extension.to_string_lossy().into_owned());
        out.with_file_name(format!("{stem}{kind}-{k}.{extension}"))
    }

    /// Refuses options of a trajectory before the search.
    fn check_trajectory(&self) -> Result<(), BadInput> {
        let bad =
            |option: &str, found: &str, expected: &str| Err(BadInput::new("command line", option, found, expected));
        if self.csv.is_none() && self.ros.is_none() {
            let without =
                [(self.of.is_some(), "--of"), (self.rate.is_some(), "--rate"), (self.periods != 1, "--periods")];
            if let Some((_, option)) = without.into_iter().find(|(given, _)| *given) {
                return bad(option, "neither --csv nor --ros", "--csv FILE or --ros FILE");
            }
        }
        if let Some(rate) = self.rate.filter(|rate| !(0.1..=1e5).contains(rate)) {
            return bad("--rate", &rate.to_string(), "0.1 to 100000 Hz");
        }
        if self.ros.is_none() && self.joint_names.is_some() {
            return bad("--joint-names", "no --ros", "--ros FILE");
        }
        Ok(())
    }

    /// Writes a motion sample by sample where that is asked for, under the names of [`Options::name`].
    fn write_trajectory(&self, plan: &Plan, kind: &str, k: u64, of: u64) -> Result<(), Failure> {
        let motion = motion(plan)?;
        let trajectory =
            |usual: f64| Trajectory { motion: &motion, rate: self.rate.unwrap_or(usual), periods: self.periods };
        if let Some(csv) = &self.csv {
            let path = self.name(csv, kind, k, of);
            crate::atomic::write_result(&path, trajectory(CSV_RATE_HZ).csv().as_bytes())?;
            say!("{}: {} s", path.display(), motion.period * f64::from(self.periods));
        }
        if let Some(ros) = &self.ros {
            let n = motion.joints();
            let names = self.joint_names.clone().unwrap_or_else(|| ros_names(&plan.robot, n));
            if names.len() != n {
                let (found, expected) = (format!("{} names", names.len()), format!("{n}, one per joint"));
                return Err(BadInput::new("command line", "--joint-names", found, expected).into());
            }
            let path = self.name(ros, kind, k, of);
            crate::atomic::write_result(&path, trajectory(ROS_RATE_HZ).ros(&names).as_bytes())?;
            say!("{}: {} s, joints {}", path.display(), motion.period * f64::from(self.periods), names.join(" "));
        }
        Ok(())
    }

    fn write(&self, plan: &Plan, path: &Path, set: &[Fourier], task: &Task) -> Result<(), Failure> {
        save_plan(plan, path).map_err(Failure::job)?;
        say!("{}: condition {}", path.display(), crate::analysis::conditions_text(&plan.conditions));
        if let Some(usage) = &plan.usage {
            say!("  {}", usage_text(usage));
        }
        if set.len() > 1 {
            let together = task.with_problem(|problem| plumbline_excite::stacked_conditions(problem, set));
            say!("  with the {} before it: condition {}", set.len() - 1, crate::analysis::conditions_text(&together));
        }
        Ok(())
    }
}

/// Shares of range and speed per joint, in one line.
fn usage_text(usage: &PlanUsage) -> String {
    let percent = |shares: &[f64]| shares.iter().map(|x| format!("{:.0}", 100.0 * x)).collect::<Vec<_>>().join(" ");
    format!("used per joint [%]: range {}, speed {}", percent(&usage.range), percent(&usage.speed))
}
