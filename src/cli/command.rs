//! `plumbline command`: one request to the daemon, for operators and scripts.

use crate::cli::say::say;
use crate::failure::Failure;
use clap::{Args, ValueEnum};
use plumbline_ipc::{Client, IpcError, Request, Response, RobotId, StopError, StopPath};
use std::time::Duration;

/// Options of `plumbline command`.
#[derive(Args)]
pub struct Options {
    /// Request to the daemon
    #[arg(value_name = "WHAT")]
    action: Action,
    /// Robot that the daemon drives
    #[arg(long, default_value = "panda")]
    robot: String,
}

#[derive(Clone, Copy, ValueEnum)]
enum Action {
    /// Start the programme of the job; the arm moves
    Start,
    /// Controlled stop; the arm then stays at rest
    Stop,
    /// Allow motion again after a stop
    Resume,
    /// Stop, then end the daemon
    Quit,
    /// Serve the model proposed by the estimator
    Adopt,
    /// Reject the model proposed by the estimator
    Reject,
    /// Write a recording of the last seconds, as after a fault
    Record,
    /// Print the daemon's status as JSON
    Status,
}

const TIMEOUT: Duration = Duration::from_secs(2);

/// Sends the request and prints the response.
pub fn run(options: Options) -> Result<(), Failure> {
    let id = RobotId::parse("command line", "--robot", &options.robot)?;
    let request = match options.action {
        Action::Stop => return stop(&id),
        Action::Start => Request::Start {},
        Action::Resume => Request::Resume {},
        Action::Quit => Request::Quit {},
        Action::Adopt => Request::Adopt {},
        Action::Reject => Request::Reject {},
        Action::Record => Request::Record {},
        Action::Status => Request::Status {},
    };
    let mut client = Client::connect_operator(&id, TIMEOUT).map_err(crate::cli::unreachable)?;
    let answer = match client.send(&request, TIMEOUT) {
        // The daemon may end before its response arrives.
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

/// Stops the arm over the stop socket, or by a signal if that fails.
fn stop(id: &RobotId) -> Result<(), Failure> {
    let taken = plumbline_ipc::stop(id).map_err(|error| match error {
        StopError::NoDaemon { .. } => crate::cli::no_daemon(error),
        other => Failure::job(other),
    })?;
    match taken.way {
        StopPath::Socket => say!("accepted: the daemon (process {}) has received the stop", taken.process),
        StopPath::Signal { because } => say!(
            "accepted: the daemon (process {}) has received the stop by signal SIGUSR2; its socket failed: {because}",
            taken.process
        ),
    }
    Ok(())
}
