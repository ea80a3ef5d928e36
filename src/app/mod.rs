//! Floor 4: one file per subcommand, wiring only.

mod changed;
mod changing;
mod collector;
mod command;
mod compare;
mod daemon;
mod diagnose;
mod diagnosed;
mod doctor;
mod effects;
mod estimator;
mod export;
mod failure;
mod identify;
mod inclinometer;
mod journal;
mod live;
mod models;
mod outbox;
mod owned;
mod pipeline;
mod plan;
mod postmortem;
mod predict;
mod programme;
mod progress;
mod results;
mod run;
mod say;
mod served;
mod service;
mod sessions;
mod signals;
mod torque;

pub use failure::Failure;

use crate::config::job::Job;
use crate::report::Condition;
use crate::store::Provenance;
use clap::{Args, Parser, Subcommand};
use plumbline_core::BadInput;
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_excite::limits::{Bounds, Margins, check_pose};
use plumbline_ipc::{ArmLock, IpcError, Lock, RobotId, place};
use plumbline_model::base::Reduction;
use plumbline_model::conditioning::Conditions;
use plumbline_model::gravity::Mounting;
use plumbline_model::robot::Robot;
use plumbline_model::structure::Structure;
use plumbline_sim::Truth;
use std::fmt::Display;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Identifies the dynamics of a serial robot arm for any mounting and serves the torques it needs at 1 kHz.
#[derive(Parser)]
#[command(name = "plumbline", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Subcommand)]
enum Verb {
    /// Optimise an excitation and write it to a plan file
    Plan(plan::Options),
    /// Do the whole job on one machine: daemon, estimator, report
    Run(run::Options),
    /// Run the real-time process (what the systemd service starts)
    Daemon(daemon::Options),
    /// Run the estimator process (what the systemd service starts)
    Estimator(estimator::Options),
    /// Identify from files, offline
    Identify(identify::Options),
    /// Say what changed since a model was identified: payload, tilt, friction, sensors
    Compare(compare::Options),
    /// Find out what a plain model of recorded data lacks, offline
    Diagnose(diagnose::Options),
    /// Compute the torques of a model along a recorded motion
    Predict(predict::Options),
    /// Write the identified arm as URDF, MuJoCo model or C function
    Export(export::Options),
    /// Say whether this machine is fit for 1 kHz, and what to change
    Doctor(doctor::Options),
    /// Say what happened before a fault, from its recording
    Postmortem(postmortem::Options),
    /// List the effects that diagnosis knows, with their equations
    Effects(effects::Options),
    /// Print the feed-forward torque that a daemon serves
    Torque(torque::Options),
    /// Listen to the inclinometer of a job and print what it says
    Inclinometer(inclinometer::Options),
    /// Tell a running daemon what to do: start, stop, resume, quit, status
    Command(command::Options),
}

/// A job file and what overrides it.
#[derive(Args, Clone)]
pub struct JobOptions {
    /// The job: a TOML file such as config/sim-panda-wall.toml
    pub config: PathBuf,
    /// Override one key of the job, as in --set backend.pace=wall-clock (repeatable)
    #[arg(long = "set", value_name = "KEY.PATH=VALUE")]
    pub sets: Vec<String>,
    /// Folder for the results instead of the one that the job names
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Refuse a job, robot, plan or model file that anybody but root can change, as the services do
    #[arg(long)]
    pub root_owned: bool,
}

/// Runs the command line and turns its outcome into an exit code: 0 success, 1 a failed job, 2 bad input.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    journal::start(matches!(cli.verb, Verb::Run(_) | Verb::Daemon(_) | Verb::Estimator(_)));
    let outcome = match cli.verb {
        Verb::Plan(options) => plan::run(options),
        Verb::Run(options) => run::run(options),
        Verb::Daemon(options) => daemon::run(options),
        Verb::Estimator(options) => estimator::run(options),
        Verb::Identify(options) => identify::run(options),
        Verb::Compare(options) => compare::run(options),
        Verb::Diagnose(options) => diagnose::run(options),
        Verb::Predict(options) => predict::run(options),
        Verb::Export(options) => export::run(options),
        Verb::Doctor(options) => doctor::run(options),
        Verb::Postmortem(options) => postmortem::run(options),
        Verb::Effects(options) => effects::run(options),
        Verb::Torque(options) => torque::run(options),
        Verb::Inclinometer(options) => inclinometer::run(options),
        Verb::Command(options) => command::run(options),
    };
    journal::finish(outcome.as_ref().err().map(|failure| failure as &dyn std::fmt::Display));
    outcome.map_or_else(|failure| ExitCode::from(failure.code()), |()| ExitCode::SUCCESS)
}

/// Two gravity directions closer than this are one mounting \[rad\].
const SAME_MOUNTING: f64 = 1e-3;

/// Simulated arms that the program carries.
const ARMS: [(&str, &str); 3] = [
    ("sim-panda", include_str!("../../config/arms/sim-panda.toml")),
    ("sim-panda-effect", include_str!("../../config/arms/sim-panda-effect.toml")),
    ("sim-paper-2dof", include_str!("../../config/arms/sim-paper-2dof.toml")),
];

impl JobOptions {
    /// The job, its robot, and the folder for the results.
    fn load(&self) -> Result<(Job, Robot, PathBuf), Failure> {
        if self.root_owned {
            owned::trusted(&self.config)?;
        }
        let job = Job::load(&self.config, &self.sets)?;
        if self.root_owned && job.robot.ends_with(".toml") {
            owned::trusted(&job.dir().join(&job.robot))?;
        }
        for file in [&job.excitation.plan, &job.excitation.model].into_iter().flatten().filter(|_| self.root_owned) {
            owned::trusted(file)?;
        }
        let robot = Robot::load(&job.robot, Some(job.dir()))?;
        let out = self.out.clone().unwrap_or_else(|| job.output.dir.clone());
        if self.root_owned {
            owned::plans(&out)?;
        }
        Ok((job, robot, out))
    }
}

/// The robot's identity in shared memory.
fn robot_id(job: &Job) -> Result<RobotId, Failure> {
    let name = job.serve.id.as_ref().unwrap_or(&job.robot);
    Ok(RobotId::parse(&job.file.display().to_string(), "key `serve.id`", name)?)
}

/// A daemon that can't be reached; says so where it may be another user's.
fn unreachable(error: IpcError) -> Failure {
    match error {
        IpcError::NoDaemon { .. } => no_daemon(error),
        _ => Failure::job(error),
    }
}

/// There is no daemon for this user.
fn no_daemon(error: impl Display) -> Failure {
    match place::served_by_another() {
        Some(owner) => Failure::job(format!(
            "{error}; the service on this machine belongs to user {owner}, and only that user may talk to it: `sudo -u plumbline plumbline ...`"
        )),
        None => Failure::job(error),
    }
}

/// Takes the robot for this process. A held lock passes: it is no bad input, after which a service would stay down.
fn lock(id: &RobotId) -> Result<Lock, Failure> {
    Lock::take(id).map_err(Failure::job)
}

/// Takes the robot over from the process that has started this one and passed its lock on.
fn adopted_lock(id: &RobotId) -> Result<Lock, Failure> {
    Lock::adopt(id).map_err(Failure::job)
}

/// Takes the arm for this process, where there is one: a simulated arm is each daemon's own.
fn arm_lock(job: &Job) -> Result<Option<ArmLock>, Failure> {
    let Some(franka) = &job.backend.franka else { return Ok(None) };
    let arm = format!("franka/{}", franka.address.to_canonical());
    ArmLock::take(&arm).map(Some).map_err(Failure::job)
}

/// What the simulated arm is made of.
fn truth(job: &Job) -> Result<Option<Truth>, Failure> {
    let Some(arm) = &job.backend.arm else { return Ok(None) };
    let (file, text) = arm.read("backend.arm", &ARMS)?;
    Ok(Some(Truth::parse(&file, &text)?))
}

/// Where the arm starts and returns to: the job's own pose, inside every limit.
fn rest(job: &Job, robot: &Robot) -> Result<JointVec, Failure> {
    let n = robot.chain.len();
    let file = job.file.display().to_string();
    let key = "key `backend.start`";
    let middle = |j: usize| 0.5 * (robot.limits.q_min[j] + robot.limits.q_max[j]);
    let start = job.backend.start.clone().unwrap_or_else(|| (0..n).map(middle).collect());
    if start.len() != n {
        return Err(
            BadInput::new(file, key, format!("{} positions", start.len()), format!("{n}, one per joint")).into()
        );
    }
    let limits = job.guard_limits(&robot.limits, n)?;
    for (j, &q) in start.iter().enumerate() {
        if !(limits.q_min[j]..=limits.q_max[j]).contains(&q) {
            let expected = format!("{} to {} rad for joint {}", limits.q_min[j], limits.q_max[j], j + 1);
            return Err(BadInput::new(file, key, format!("{q} rad"), expected).into());
        }
    }
    let at = robot.chain.end_effector(&start);
    let space = job.workspace(&robot.workspace);
    let inside = (0..3).all(|axis| (space.box_min[axis]..=space.box_max[axis]).contains(&at[axis]));
    if !inside || at.norm() < space.base_radius {
        let found = format!("the end effector at [{:.3}, {:.3}, {:.3}] m", at.x, at.y, at.z);
        let expected = format!(
            "a pose that holds it in the box {:?} to {:?} m and {} m away from the base",
            space.box_min, space.box_max, space.base_radius
        );
        return Err(BadInput::new(file, key, found, expected).into());
    }
    let bounds = Bounds { shape: Some(&robot.shape), ..Bounds::new(&robot.chain, &limits, Margins::none()) };
    if let Some(peak) = check_pose(&bounds, &start).violations().next() {
        return Err(BadInput::new(file, key, peak, "a pose in which the arm does not touch itself").into());
    }
    let mut rest = [0.0; MAX_JOINTS];
    rest[..n].copy_from_slice(&start);
    Ok(rest)
}

/// The paper's model: rigid body and friction, in the base set of a mounting.
fn friction_structure(robot: &Robot, mounting: &Mounting) -> Structure {
    let reduction = Reduction::in_mounting(&robot.chain, mounting);
    Structure::of(robot.chain.clone(), reduction, &["friction"]).expect("friction is a known term")
}

/// Condition numbers as the report has them.
fn conditions_facts(conditions: &Conditions) -> Vec<Condition> {
    let fact = |definition: &str, with_friction, without_friction| Condition {
        definition: definition.to_string(),
        with_friction,
        without_friction,
    };
    vec![
        fact("raw", conditions.raw, conditions.raw_rigid),
        fact("column-equilibrated", conditions.equilibrated, conditions.equilibrated_rigid),
        fact("noise-weighted", conditions.weighted, conditions.weighted_rigid),
    ]
}

/// Condition numbers in one line.
fn conditions_text(conditions: &Conditions) -> String {
    let one = |fact: Condition| {
        format!("{} {:.1} (rigid body alone {:.1})", fact.definition, fact.with_friction, fact.without_friction)
    };
    conditions_facts(conditions).into_iter().map(one).collect::<Vec<_>>().join(", ")
}

/// Writes a result aside, then renames it.
fn write(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    crate::atomic::write_file(path, bytes).map_err(Failure::job)
}

/// Where numbers of a `robot` that this program identified come from; `dataset` is the hash of the data's content, where it is known already.
fn provenance(robot: &Robot, dataset: Option<String>) -> Provenance {
    let plumbline = Some(env!("CARGO_PKG_VERSION").to_string());
    let robot_description = robot.description.clone();
    Provenance { dataset, plumbline, date: Some(today()), source: None, robot_description }
}

/// Now in UTC, as in 2026-11-20T08:15:00Z.
fn utc() -> String {
    let seconds = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_secs());
    let (hour, minute, second) = (seconds / 3600 % 24, seconds / 60 % 60, seconds % 60);
    format!("{}T{hour:02}:{minute:02}:{second:02}Z", date(seconds))
}

/// Today's date in UTC, as in 2026-11-20.
fn today() -> String {
    date(std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).map_or(0, |since| since.as_secs()))
}

/// The date of a moment, seconds after 1970.
fn date(seconds: u64) -> String {
    // Days to a civil date (Howard Hinnant's algorithm): years are counted from March, so that the leap day is the last.
    let days = (seconds / 86_400) as i64 + 719_468;
    let era = days.div_euclid(146_097);
    let day_of_era = days.rem_euclid(146_097);
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let shifted = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * shifted + 2) / 5 + 1;
    let month = if shifted < 10 { shifted + 3 } else { shifted - 9 };
    let year = year_of_era + era * 400 + i64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}
