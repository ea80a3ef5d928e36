//! The command line: one file per subcommand that reads options, calls a library function and prints the result.

mod command;
mod compare;
mod diagnose;
mod doctor;
mod effects;
mod export;
mod identify;
mod inclinometer;
mod plan;
mod postmortem;
mod predict;
mod run;
mod say;
mod torque;

use crate::failure::Failure;
use crate::process::journal;
use crate::{daemon, estimator};
use clap::{Parser, Subcommand};
use plumbline_ipc::{IpcError, place};
use std::fmt::Display;
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
    /// Run a whole job on one machine: daemon, estimator, report
    Run(run::Options),
    /// Run the real-time process (what the systemd service starts)
    Daemon(daemon::Options),
    /// Run the estimator process (what the systemd service starts)
    Estimator(estimator::Options),
    /// Identify from files, offline
    Identify(identify::Options),
    /// Show what changed since a model was identified: payload, tilt, friction, sensors
    Compare(compare::Options),
    /// Find effects that a plain model of recorded data lacks, offline
    Diagnose(diagnose::Options),
    /// Compute the torques of a model along a recorded motion
    Predict(predict::Options),
    /// Write the identified arm as URDF, MuJoCo model or C function
    Export(export::Options),
    /// Check whether this machine is fit for 1 kHz, and list what to change
    Doctor(doctor::Options),
    /// Analyse the recording of a fault
    Postmortem(postmortem::Options),
    /// List the effects of the diagnosis, with their equations
    Effects(effects::Options),
    /// Print the feed-forward torque that a daemon serves
    Torque(torque::Options),
    /// Print the readings of a job's inclinometer
    Inclinometer(inclinometer::Options),
    /// Send a request to a running daemon: start, stop, resume, quit, status, ...
    Command(command::Options),
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

/// Failure for a daemon that can't be reached, with a hint if another user runs one.
fn unreachable(error: IpcError) -> Failure {
    match error {
        IpcError::NoDaemon { .. } => no_daemon(error),
        _ => Failure::job(error),
    }
}

/// Failure for a missing daemon, with a hint if another user runs one.
fn no_daemon(error: impl Display) -> Failure {
    match place::served_by_another() {
        Some(owner) => Failure::job(format!(
            "{error}; the service on this machine belongs to user {owner}, and only that user may connect to it: `sudo -u plumbline plumbline ...`"
        )),
        None => Failure::job(error),
    }
}
