//! `plumbline command`: one request to the daemon, for operators and scripts.

use crate::cli::say::say;
use crate::failure::Failure;
use clap::{Args, ValueEnum};
use plumbline_ipc::{Client, IpcError, Progress, Request, Response, RobotId, Status, StopError, StopPath};
use serde_json::Value;
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
    /// Print the whole status as JSON, identities of models as hexadecimal text
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, ValueEnum)]
enum Action {
    /// Start the programme of the job; the arm moves
    Start,
    /// Controlled stop; the arm then stays at rest
    Stop,
    /// Brake the arm; `resume` drives the interrupted motion from its start, then the rest of the job
    Pause,
    /// Allow motion again after a stop, go on after a pause
    Resume,
    /// Stop, then end the daemon
    Quit,
    /// Serve the model proposed by the estimator
    Adopt,
    /// Reject the model proposed by the estimator
    Reject,
    /// Write a recording of the last seconds, as after a fault
    Record,
    /// Print the daemon's status
    Status,
}

const TIMEOUT: Duration = Duration::from_secs(2);

/// Sends the request and prints the response.
pub fn run(options: Options) -> Result<(), Failure> {
    let id = RobotId::parse("command line", "--robot", &options.robot)?;
    let request = match options.action {
        Action::Stop => return stop(&id),
        Action::Start => Request::Start {},
        Action::Pause => Request::Pause {},
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
        Response::Status(status) if options.json => {
            say!("{}", serde_json::to_string_pretty(&json(&status)?).map_err(Failure::job)?);
            Ok(())
        }
        Response::Status(status) => {
            words(&status).iter().for_each(|line| say!("{line}"));
            Ok(())
        }
        Response::Refused { reason } => Err(Failure::job(reason)),
        Response::Accepted {} | Response::ModelAccepted { .. } | Response::ModelHeld { .. } => {
            say!("accepted");
            Ok(())
        }
    }
}

/// A status as JSON. Identities of models are hexadecimal text, as in every log: many readers of JSON keep 53 bits of a number.
fn json(status: &Status) -> Result<Value, Failure> {
    let mut value = serde_json::to_value(status).map_err(Failure::job)?;
    value["model"] = identity(status.model).into();
    if let Some(offered) = &status.offered {
        value["offered"]["model"] = identity(offered.model).into();
    }
    Ok(value)
}

fn identity(model: u64) -> String {
    format!("{model:016x}")
}

/// A status in a few lines.
fn words(status: &Status) -> Vec<String> {
    let progress = match status.progress {
        Progress::Idle => "not started",
        Progress::Driving => "driving",
        Progress::AwaitingModel => "holding until the estimator gives a model",
        Progress::Paused => "paused until `resume`",
        Progress::Done => "everything was driven",
        Progress::Stopped => "stopped",
    };
    let mut lines = vec![format!("{}: {progress}; {} (process {})", status.robot, status.job, status.process)];
    let doubt = status.doubt.as_ref().map_or(String::new(), |why| format!(", doubtful: {why}"));
    lines.push(match (status.model, &status.without_model) {
        (0, Some(why)) => format!("model: none, the rest is driven without one: {why}"),
        (0, None) => "model: none".into(),
        (model, _) => format!("model: {}{doubt}", identity(model)),
    });
    lines.extend(status.offered.as_ref().map(|offered| {
        format!(
            "proposed: {} ({}); `adopt` serves it, `reject` drops it",
            identity(offered.model),
            offered.proposal.what
        )
    }));
    let Status { cycles, lost, late, dropped_records, .. } = status;
    lines.push(format!("loop: {cycles} cycles, {lost} lost, {late} late, {dropped_records} records dropped"));
    if let Some(gravity) = &status.gravity {
        let refused = gravity.refused.as_ref().map_or(String::new(), |why| format!("; the model is not served: {why}"));
        let sensor = gravity.inclinometer.as_ref().map_or(String::new(), |state| format!("; inclinometer: {state}"));
        lines.push(format!("gravity: {}{sensor}{refused}", gravity.source));
    }
    let followers: Vec<String> =
        status.served.followers.iter().map(|one| format!("{} (process {})", one.name, one.pid)).collect();
    if !followers.is_empty() {
        lines.push(format!("followers: {}", followers.join(", ")));
    }
    lines.extend(status.guest.as_ref().and_then(|guest| guest.problem.as_ref()).map(|why| format!("listening: {why}")));
    lines.extend(status.degraded.iter().map(|why| format!("degraded, not real-time: {why}")));
    lines.extend(status.stopped.as_ref().map(|why| format!("last stop: {why}")));
    lines
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

#[cfg(test)]
mod tests {
    use super::*;
    use plumbline_ipc::HeldModel;

    #[test]
    fn identities_of_models_are_text_that_every_reader_of_json_keeps() {
        let offered = HeldModel { model: 7, ..HeldModel::default() };
        let status = Status { model: u64::MAX - 1, offered: Some(offered), ..Status::default() };
        let value = json(&status).unwrap();
        assert_eq!(
            (&value["model"], &value["offered"]["model"]),
            (&"fffffffffffffffe".into(), &"0000000000000007".into())
        );
        let lines = words(&status).join("\n");
        assert!(lines.contains("model: fffffffffffffffe") && lines.contains("proposed: 0000000000000007"), "{lines}");
    }
}
