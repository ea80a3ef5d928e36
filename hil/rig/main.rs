//! The first hour with a real arm: four steps, each of which does one thing and ends with a verdict. README.md beside this file is the
//! procedure; nothing here starts without `--i-am-at-the-robot`.

mod communication;
mod excitation;
mod gravity;
mod verdict;

use clap::{Args, Parser, Subcommand};
use plumbline::config::job::{Franka, Job};
use plumbline::config::robot::Robot;
use std::error::Error;
use std::path::PathBuf;
use std::process::ExitCode;
use verdict::Verdict;

/// Steps towards the first excitation of a real Franka arm
#[derive(Parser)]
#[command(name = "rig", version)]
struct Cli {
    #[command(subcommand)]
    step: Step,
}

#[derive(Subcommand)]
enum Step {
    /// 1. Watch the robot, then hold its pose: does this machine answer in time?
    Communication(Given),
    /// 2. Read torques at rest: do signs, gravity and the declared mounting agree? Starts no motion
    Gravity(gravity::Options),
    /// 3. Drive a small, slow excitation
    Slow(Given),
    /// 4. Run the whole job
    Full(Given),
}

/// What every step is given.
#[derive(Args, Clone)]
struct Given {
    /// The job, with `backend.kind = "franka"`
    config: PathBuf,
    /// You stand at the robot, nobody is in its reach, and your hand is on the stop button
    #[arg(long)]
    i_am_at_the_robot: bool,
    /// Override one key of the job (repeatable)
    #[arg(long = "set", value_name = "KEY.PATH=VALUE")]
    sets: Vec<String>,
}

/// A job for a Franka, loaded.
struct Rig {
    job: Job,
    robot: Robot,
    franka: Franka,
}

impl Given {
    /// Loads the job; refuses where nobody said that somebody is there.
    fn load(&self) -> Result<Rig, Box<dyn Error>> {
        if !self.i_am_at_the_robot {
            return Err("this step drives or energises a real arm: read hil/rig/README.md, stand at the robot with your hand on the stop \
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
        Ok(Rig { job, robot, franka })
    }
}

fn main() -> ExitCode {
    let outcome = match Cli::parse().step {
        Step::Communication(given) => given.load().and_then(|rig| communication::run(&rig)),
        Step::Gravity(options) => options.given.load().and_then(|rig| gravity::run(&rig, &options)),
        Step::Slow(given) => given.load().and_then(|rig| excitation::slow(&rig, &given)),
        Step::Full(given) => given.load().and_then(|rig| excitation::full(&rig, &given)),
    };
    match outcome {
        Ok(verdict) => {
            println!("{verdict}");
            if matches!(verdict, Verdict::Pass(_)) { ExitCode::SUCCESS } else { ExitCode::FAILURE }
        }
        Err(error) => {
            eprintln!("rig: {error}");
            ExitCode::from(2)
        }
    }
}
