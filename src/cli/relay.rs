//! `plumbline relay`: torque, model and states across users of one machine.

use crate::failure::Failure;
use crate::relay;
use clap::{Args, ValueEnum};
use plumbline_ipc::RobotId;
use std::path::PathBuf;

/// Options of `plumbline relay`.
#[derive(Args)]
pub struct Options {
    /// End of the relay
    #[arg(value_name = "END")]
    end: End,
    /// Robot that the daemon serves
    #[arg(long, default_value = "panda")]
    robot: String,
    /// Folder of the sockets; its group decides who may connect
    #[arg(long, value_name = "DIR", default_value = relay::FOLDER)]
    folder: PathBuf,
}

#[derive(Clone, Copy, ValueEnum)]
enum End {
    /// As the daemon's user: sends torque and model, publishes the states that arrive
    Serve,
    /// As a user of the group: serves torque and model to this user's programs, sends the states that they publish
    Join,
}

/// Runs until a signal ends it.
pub fn run(options: Options) -> Result<(), Failure> {
    let robot = RobotId::parse("command line", "--robot", &options.robot)?;
    match options.end {
        End::Serve => relay::serve(&robot, &options.folder),
        End::Join => relay::join(&robot, &options.folder),
    }
}
