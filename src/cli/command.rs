//! `plumbline command`: one request to the daemon, for operators and scripts.

use crate::cli::say::say;
use crate::failure::Failure;
use clap::{Args, ValueEnum};
use plumbline_ipc::{Client, IpcError, Request, Response, RobotId, StopError, StopPath};
use std::time::Duration;

/// Options of `plumbline command`.
#[derive(Args)]
pub struct Options {
    /// What the daemon shall do
    what: What,
    /// Robot that the daemon drives
    #[arg(long, default_value = "panda")]
    robot: String,
}

#[derive(Clone, Copy, ValueEnum)]
enum What {
    /// Drive the programme of the job; the arm moves
    Start,
    /// Brake now and stay at rest
    Stop,
    /// Allow motion again after a stop
    Resume,
    /// Stop, then end the daemon
    Quit,
    /// Serve the model that the estimator proposed
    Adopt,
    /// Drop the model that the estimator proposed
    Reject,
    /// Write a recording of the last seconds, as after a fault
    Record,
    /// Print how the daemon is, as JSON
    Status,
}

const PATIENCE: Duration = Duration::from_secs(2);

/// Sends the request and prints the answer.
pub fn run(options: Options) -> Result<(), Failure> {
    let id = RobotId::parse("command line", "--robot", &options.robot)?;
    let request = match options.what {
        What::Stop => return stop(&id),
        What::Start => Request::Start {},
        What::Resume => Request::Resume {},
        What::Quit => Request::Quit {},
        What::Adopt => Request::Adopt {},
        What::Reject => Request::Reject {},
        What::Record => Request::Record {},
        What::Status => Request::Status {},
    };
    let mut client = Client::connect_operator(&id, PATIENCE).map_err(crate::cli::unreachable)?;
    let answer = match client.send(&request, PATIENCE) {
        // It was there a moment ago and has ended, which is what was asked for: its answer may have gone with it.
        Err(IpcError::NoDaemon { .. }) if request == (Request::Quit {}) => Response::Accepted {},
        answer => answer.map_err(Failure::job)?,
    };
    match answer {
        Response::Status(status) => {
            say!("{}", serde_json::to_string_pretty(&status).map_err(Failure::job)?);
            Ok(())
        }
        Response::Refused { reason } => Err(Failure::job(reason)),
        Response::Accepted {} | Response::ModelAccepted { .. } | Response::ModelHeld { .. } => {
            say!("accepted");
            Ok(())
        }
    }
}

/// Stops the arm by the stop's own way, and says which.
fn stop(id: &RobotId) -> Result<(), Failure> {
    let taken = plumbline_ipc::stop(id).map_err(|error| match error {
        StopError::NoDaemon { .. } => crate::cli::no_daemon(error),
        other => Failure::job(other),
    })?;
    match taken.way {
        StopPath::Socket => say!("accepted: the daemon (process {}) has taken the stop", taken.process),
        StopPath::Signal { because } => say!(
            "accepted: the daemon (process {}) has taken the stop by signal SIGUSR2, for its socket failed: {because}",
            taken.process
        ),
    }
    Ok(())
}
