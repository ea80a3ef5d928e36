//! `plumbline plan`: searches excitations and writes them to plan files.

use crate::analysis::{conditions_facts, conditions_text, drawn};
use crate::cli::say::say;
use crate::failure::Failure;
use crate::offline::plan::{self, Planned, Purpose, plan};
use crate::process::signals::Ending;
use crate::report::robot::unchecked;
use crate::report::{Figures, MotionUsage, Report};
use crate::setup::planner::motion;
use crate::store::trajectory::{Trajectory, ros_names};
use crate::store::{load_plan, save_plan};
use clap::Args;
use plumbline_core::BadInput;
use plumbline_excite::{Fourier, Plan, PlanUsage};
use plumbline_model::Robot;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Options of `plumbline plan`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    plan: plan::Options,
    /// Plan file to write; several motions become plan-1.toml, plan-2.toml, .., plan-validate-1.toml, ..
    #[arg(long, value_name = "FILE", required_unless_present = "of")]
    out: Option<PathBuf>,
    /// Plan nothing: write the motion of this plan file with --csv or --ros
    #[arg(long, value_name = "PLAN", conflicts_with_all = ["robot", "out"])]
    of: Option<PathBuf>,
    #[command(flatten)]
    trajectory: TrajectoryOptions,
    /// Write a page with the motion, the course of its search and its use of the limits, too
    #[arg(long, value_name = "FILE", conflicts_with = "of")]
    page: Option<PathBuf>,
    /// Print condition numbers and use of the limits as JSON, one entry per plan file
    #[arg(long)]
    json: bool,
}

/// Files of a motion sample by sample, for arms that plumbline does not drive.
#[derive(Args)]
struct TrajectoryOptions {
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
}

/// Sampling of a table: that of a controller's loop \[Hz\].
const CSV_RATE_HZ: f64 = 1000.0;
/// Sampling for ROS \[Hz\]: its controllers interpolate.
const ROS_RATE_HZ: f64 = 100.0;

/// Writes each motion when it is found. Ctrl-C ends the search with the best motion so far.
pub fn run(options: Options) -> Result<(), Failure> {
    options.trajectory.check(options.of.is_some())?;
    let Some(out) = &options.out else {
        let Some(of) = &options.of else {
            return Err(BadInput::new("command line", "--out", "no file", "--out FILE, or --of PLAN").into());
        };
        let written = options.trajectory.write(&load_plan(of)?, ALONE)?;
        if options.json {
            let files: Vec<Value> = written.iter().map(Sampled::facts).collect();
            say!("{}", serde_json::to_string_pretty(&files).map_err(Failure::job)?);
        } else {
            written.iter().for_each(|sampled| say!("{}", sampled.line()));
        }
        return Ok(());
    };
    let robot = options.plan.robot()?;
    options.trajectory.check_names(robot.chain.len())?;
    if !options.json {
        unchecked(&robot).iter().for_each(|line| say!("note: {line}"));
    }
    let ending = Ending::interrupts()?;
    let mut written: Vec<Value> = Vec::new();
    plan(&options.plan, &|| ending.arrived(), &mut |planned| {
        if ending.arrived() {
            eprintln!("plumbline: interrupted; the best motion so far is kept");
        }
        let path = file_of(out, planned.purpose);
        save_plan(&planned.plan, &path).map_err(Failure::job)?;
        let sampled = options.trajectory.write(&planned.plan, planned.purpose)?;
        let page = options.page.as_ref().map(|page| file_of(page, planned.purpose));
        if let Some(page) = &page {
            crate::atomic::write_result(page, html(&robot, &planned.plan, &path)?.as_bytes())?;
        }
        if options.json {
            written.push(facts(&planned, &path, &sampled));
        } else {
            show(&planned, &path);
            sampled.iter().for_each(|sampled| say!("  {}", sampled.line()));
            page.iter().for_each(|page| say!("  page: {}", page.display()));
        }
        Ok(())
    })?;
    if options.json {
        say!("{}", serde_json::to_string_pretty(&written).map_err(Failure::job)?);
    }
    Ok(())
}

/// The purpose of the motion of a plan file: its files have no number.
const ALONE: Purpose = Purpose::Identify { number: 1, of: 1 };

/// A written trajectory.
struct Sampled {
    path: PathBuf,
    /// Length of the motion \[s\].
    length: f64,
}

impl Sampled {
    fn line(&self) -> String {
        format!("{}: {} s", self.path.display(), self.length)
    }

    fn facts(&self) -> Value {
        serde_json::json!({ "file": self.path, "length": self.length })
    }
}

impl TrajectoryOptions {
    /// Refuses options before the search. `of`: the motion of a plan file is to be written.
    fn check(&self, of: bool) -> Result<(), BadInput> {
        let bad =
            |option: &str, found: &str, expected: &str| Err(BadInput::new("command line", option, found, expected));
        if self.csv.is_none() && self.ros.is_none() {
            let without = [(of, "--of"), (self.rate.is_some(), "--rate"), (self.periods != 1, "--periods")];
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

    /// Refuses another number of names than the `n` joints.
    fn check_names(&self, n: usize) -> Result<(), BadInput> {
        match &self.joint_names {
            Some(names) if names.len() != n => {
                let (found, expected) = (format!("{} names", names.len()), format!("{n}, one per joint"));
                Err(BadInput::new("command line", "--joint-names", found, expected))
            }
            _ => Ok(()),
        }
    }

    /// Writes a motion sample by sample where that was asked for, numbered as the plan files are.
    fn write(&self, plan: &Plan, purpose: Purpose) -> Result<Vec<Sampled>, Failure> {
        let motion: Fourier = motion(plan)?;
        let n = motion.joints();
        self.check_names(n)?;
        let trajectory =
            |usual: f64| Trajectory { motion: &motion, rate: self.rate.unwrap_or(usual), periods: self.periods };
        let names = || self.joint_names.clone().unwrap_or_else(|| ros_names(&plan.robot, n));
        let csv = self.csv.iter().map(|path| (path, trajectory(CSV_RATE_HZ).csv()));
        let ros = self.ros.iter().map(|path| (path, trajectory(ROS_RATE_HZ).ros(&names())));
        csv.chain(ros)
            .map(|(path, text)| {
                let path = file_of(path, purpose);
                crate::atomic::write_result(&path, text.as_bytes())?;
                Ok(Sampled { path, length: motion.period * f64::from(self.periods) })
            })
            .collect()
    }
}

/// `plan.toml` for a motion alone, else `plan-2.toml` or `plan-validate-2.toml`.
fn file_of(out: &Path, purpose: Purpose) -> PathBuf {
    let (kind, k) = match purpose {
        Purpose::Identify { of: 1, .. } => return out.to_path_buf(),
        Purpose::Identify { number, .. } => ("", number),
        Purpose::Validate { number } => ("-validate", number),
    };
    let stem = out.file_stem().map_or("plan".into(), |stem| stem.to_string_lossy().into_owned());
    let extension = out.extension().map_or("toml".into(), |extension| extension.to_string_lossy().into_owned());
    out.with_file_name(format!("{stem}{kind}-{k}.{extension}"))
}

/// The page of a motion: the parts of a report that need no recorded data.
fn html(robot: &Robot, plan: &Plan, path: &Path) -> Result<String, Failure> {
    let report = Report {
        robot: plan.robot.clone(),
        mounting: plan.mounting().into(),
        conditions: conditions_facts(&plan.conditions),
        motions: MotionUsage::of(&path.display().to_string(), plan).into_iter().collect(),
        ..Report::default()
    };
    let figures = Figures { plan: Some(drawn::plan(robot, robot.workspace, &motion(plan)?)), ..Figures::default() };
    report.to_html(&figures).map_err(Failure::job)
}

/// Condition numbers, use of the limits and course of the search, as `--json` prints them.
fn facts(Planned { plan, together, .. }: &Planned, path: &Path, sampled: &[Sampled]) -> Value {
    serde_json::json!({
        "file": path, "conditions": conditions_facts(&plan.conditions), "usage": plan.usage, "search": plan.search,
        "with_those_before": together.as_ref().map(conditions_facts),
        "trajectories": sampled.iter().map(Sampled::facts).collect::<Vec<_>>(),
    })
}

fn show(Planned { plan, purpose, together }: &Planned, path: &Path) {
    say!("{}: condition {}", path.display(), conditions_text(&plan.conditions));
    if let Some(usage) = &plan.usage {
        say!("  {}", usage_text(usage));
    }
    if let (Purpose::Identify { number, .. }, Some(together)) = (purpose, together) {
        say!("  with the {} before it: condition {}", number - 1, conditions_text(together));
    }
}

/// Shares of range and speed per joint, in one line.
fn usage_text(usage: &PlanUsage) -> String {
    let percent = |shares: &[f64]| shares.iter().map(|x| format!("{:.0}", 100.0 * x)).collect::<Vec<_>>().join(" ");
    format!("used per joint [%]: range {}, speed {}", percent(&usage.range), percent(&usage.speed))
}
