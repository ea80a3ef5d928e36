//! What a job needs before anything moves: its options, its robot and arm, the locks, the rest pose, the programme of motions.

pub mod backend;
pub mod planner;
pub mod programme;

use crate::config::job::Job;
use crate::failure::Failure;
use crate::process::owned;
use clap::Args;
use plumbline_core::{ArmConnector, BadInput, JointVec, MAX_JOINTS};
use plumbline_excite::{Bounds, Margins, check_pose};
use plumbline_ipc::{ArmLock, Lock, RobotId};
use plumbline_model::{Mounting, Reduction, Robot, Structure};
use std::path::PathBuf;

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

impl JobOptions {
    pub fn load(&self) -> Result<(Job, Robot, PathBuf), Failure> {
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
pub fn robot_id(job: &Job) -> Result<RobotId, Failure> {
    let name = job.serve.id.as_ref().unwrap_or(&job.robot);
    Ok(RobotId::parse(&job.file.display().to_string(), "key `serve.id`", name)?)
}

/// Takes the robot for this process. A held lock passes: it is no bad input, after which a service would stay down.
pub fn lock(id: &RobotId) -> Result<Lock, Failure> {
    Lock::take(id).map_err(Failure::job)
}

/// Takes the robot over from the process that has started this one and passed its lock on.
pub fn adopted_lock(id: &RobotId) -> Result<Lock, Failure> {
    Lock::adopt(id).map_err(Failure::job)
}

/// Takes the physical arm for this process; `None` for a simulated arm, of which each daemon has its own.
pub fn arm_lock(arm: &dyn ArmConnector) -> Result<Option<ArmLock>, Failure> {
    arm.lock_name().map(|name| ArmLock::take(&name)).transpose().map_err(Failure::job)
}

/// Where the arm starts and returns to: the job's own pose, inside every limit. Zero for an arm that is not driven.
pub fn rest(job: &Job, robot: &Robot) -> Result<JointVec, Failure> {
    if job.backend.guest().is_some() {
        return Ok(JointVec::default());
    }
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
pub fn friction_structure(robot: &Robot, mounting: &Mounting) -> Structure {
    let reduction = Reduction::in_mounting(&robot.chain, mounting);
    Structure::of(robot.chain.clone(), reduction, &["friction"]).expect("friction is a known term")
}
