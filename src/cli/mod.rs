//! The command line: one file per subcommand that reads options, calls what does the work, and prints what came of it.

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
use clap::Parser;
use plumbline_ipc::{IpcError, place};
use std::fmt::Display;
use std::process::ExitCode;

/// Identifies the dynamics of a serial robot arm for any mounting and serves the torques it needs at 1 kHz.
#[derive(Parser)]
#[command(name = "plumbline", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    subcommand: Subcommand,
}

/// The subcommands, each with the module that has its `Options` and its `run`.
macro_rules! subcommands {
    ($($(#[$doc:meta])* $name:ident => $module:ident,)+) => {
        #[derive(clap::Subcommand)]
        enum Subcommand {
            $($(#[$doc])* $name($module::Options),)+
        }

        impl Subcommand {
            fn run(self) -> Result<(), Failure> {
                match self {
                    $(Subcommand::$name(options) => $module::run(options),)+
                }
            }
        }
    };
}

subcommands! {
    /// Optimise an excitation and write it to a plan file
    Plan => plan,
    /// Do the whole job on one machine: daemon, estimator, report
    Run => run,
    /// Run the real-time process (what the systemd service starts)
    Daemon => daemon,
    /// Run the estimator process (what the systemd service starts)
    Estimator => estimator,
    /// Identify from files, offline
    Identify => identify,
    /// Say what changed since a model was identified: payload, tilt, friction, sensors
    Compare => compare,
    /// Find out what a plain model of recorded data lacks, offline
    Diagnose => diagnose,
    /// Compute the torques of a model along a recorded motion
    Predict => predict,
    /// Write the identified arm as URDF, MuJoCo model or C function
    Export => export,
    /// Say whether this machine is fit for 1 kHz, and what to change
    Doctor => doctor,
    /// Say what happened before a fault, from its recording
    Postmortem => postmortem,
    /// List the effects that diagnosis knows, with their equations
    Effects => effects,
    /// Print the feed-forward torque that a daemon serves
    Torque => torque,
    /// Listen to the inclinometer of a job and print what it says
    Inclinometer => inclinometer,
    /// Tell a running daemon what to do: start, stop, resume, quit, status
    Command => command,
}

/// Runs the command line and turns its outcome into an exit code: 0 success, 1 a failed job, 2 bad input.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let logs = matches!(cli.subcommand, Subcommand::Run(_) | Subcommand::Daemon(_) | Subcommand::Estimator(_));
    journal::start(logs);
    let outcome = cli.subcommand.run();
    journal::finish(outcome.as_ref().err().map(|failure| failure as &dyn std::fmt::Display));
    outcome.map_or_else(|failure| ExitCode::from(failure.code()), |()| ExitCode::SUCCESS)
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

#[cfg(test)]
mod tests {
    use super::*;

    /// Follows the recipe "Add a subcommand" of CONTRIBUTING.md with a subcommand that is made up.
    mod recipe {
        use super::*;

        mod made_up {
            use crate::failure::Failure;

            /// Options of the made-up subcommand.
            #[derive(clap::Args)]
            pub struct Options {
                /// Exit code that the job fails with where this is given
                #[arg(long)]
                fails: bool,
            }

            /// Succeeds, or fails where it was asked to.
            pub fn run(options: Options) -> Result<(), Failure> {
                if options.fails { Err(Failure::job("as asked")) } else { Ok(()) }
            }
        }

        subcommands! {
            /// Do what is asked
            MadeUp => made_up,
        }

        #[derive(Parser)]
        struct Cli {
            #[command(subcommand)]
            subcommand: Subcommand,
        }

        #[test]
        fn a_subcommand_is_a_module_and_a_line() {
            let run = |arguments: &[&str]| Cli::try_parse_from(arguments).map(|cli| cli.subcommand.run());
            assert!(run(&["plumbline", "made-up"]).is_ok_and(|outcome| outcome.is_ok()));
            let failed = run(&["plumbline", "made-up", "--fails"]).ok().and_then(Result::err).expect("a failure");
            assert_eq!((failed.code(), failed.to_string().as_str()), (1, "as asked"));
            assert!(run(&["plumbline", "other"]).is_err());
        }
    }
}
