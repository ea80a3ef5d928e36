//! The steps of the bring-up and their arguments.

pub mod communication;
pub mod excitation;
pub mod gravity;
pub mod verdict;

use clap::{Args, Parser, Subcommand};
use plumbline::config::job::{Franka, Job};
use plumbline_model::Robot;
use std::error::Error;
use std::path::PathBuf;
use verdict::Verdict;

/// Steps towards the first excitation of a real Franka arm
#[derive(Parser)]
#[command(name = "rig", version)]
pub struct Cli {
    #[command(subcommand)]
    pub step: Step,
}

#[derive(Subcommand)]
pub enum Step {
    /// 1. Watch the robot, then hold its pose: does this machine answer in time?
    Communication(communication::Options),
    /// 2. Read torques at rest: do signs, gravity and the declared mounting agree? Starts no motion
    Gravity(gravity::Options),
    /// 3. Drive a small, slow excitation
    Slow(Given),
    /// 4. Run the whole job
    Full(Given),
}

#[derive(Args, Clone)]
pub struct Given {
    /// The job, with `backend.kind = "franka"`
    pub config: PathBuf,
    /// You stand at the robot, nobody is in its reach, and your hand is on the stop button
    #[arg(long)]
    pub i_am_at_the_robot: bool,
    /// Override one key of the job (repeatable)
    #[arg(long = "set", value_name = "KEY.PATH=VALUE")]
    pub sets: Vec<String>,
}

/// A job for a Franka, loaded.
pub struct Rig {
    pub job: Job,
    pub robot: Robot,
    pub franka: Franka,
    pub program: PathBuf,
}

impl Given {
    /// Loads the job; refused unless an operator is declared present.
    pub fn load(&self) -> Result<Rig, Box<dyn Error>> {
        if !self.i_am_at_the_robot {
            return Err("this step drives or energises a real arm: read docs/guide/franka.md, stand at the robot with your hand on the stop \
                        button, and give --i-am-at-the-robot"
                .into());
        }
        let job = Job::load(&self.config, &self.sets)?;
        let robot = Robot::load(&job.robot, Some(job.dir()))?;
        let Some(franka) = job.backend.franka.clone() else {
            return Err(format!(
                "{}: key `backend.kind`: expected franka: the rig is about a real arm",
                self.config.display()
            )
            .into());
        };
        Ok(Rig { job, robot, franka, program: crate::job::program() })
    }
}

impl Step {
    pub fn take(self) -> Result<Verdict, Box<dyn Error>> {
        match self {
            Step::Communication(options) => communication::run(&options.given.load()?, &options),
            Step::Gravity(options) => gravity::run(&options.given.load()?, &options),
            Step::Slow(given) => excitation::slow(&given.load()?, &given),
            Step::Full(given) => excitation::full(&given.load()?, &given),
        }
    }
}
