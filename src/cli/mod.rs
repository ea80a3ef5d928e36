//! The command line: one file per subcommand that reads options, calls a library function and prints the result.

mod check;
mod command;
mod compare;
mod diagnose;
mod doctor;
mod effects;
mod export;
mod identify;
mod import;
mod inclinometer;
mod manual;
mod monitor;
mod next;
mod output;
mod payload;
mod plan;
mod postmortem;
mod predict;
mod relay;
mod report;
mod robot;
mod run;
mod say;
mod torque;

use crate::failure::Failure;
use crate::process::journal;
use crate::process::progress::{self, Target};
use crate::{daemon, estimator};
use clap::Parser;
use plumbline_ipc::{IpcError, runtime_dir};
use std::fmt::Display;
use std::process::ExitCode;
use std::sync::LazyLock;

/// Identifies the dynamics of a serial robot arm for any mounting and serves the torques it needs at 1 kHz.
#[derive(Parser)]
#[command(name = "plumbline", version = version(), max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    subcommand: Subcommand,
}

/// The program's version with the rules of its diagnosis.
fn version() -> &'static str {
    static VERSION: LazyLock<String> =
        LazyLock::new(|| format!("{} (diagnosis rules {})", env!("CARGO_PKG_VERSION"), plumbline_diagnose::RULES));
    &VERSION
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
    /// Write the files of an arm from its URDF, or show a robot
    Robot => robot,
    /// Optimise an excitation and write it to a plan file
    Plan => plan,
    /// Run a whole job on one machine: daemon, estimator, report
    Run => run,
    /// Run the real-time process (what the systemd service starts)
    Daemon => daemon,
    /// Run the estimator process (what the systemd service starts)
    Estimator => estimator,
    /// Make a dataset of recordings: CSV, npz, ROS 2 bags
    Import => import,
    /// Check recorded data: units, signs, columns, times, mounting, robot
    Check => check,
    /// Identify from files, offline
    Identify => identify,
    /// Show what changed since a model was identified: payload, tilt, friction, sensors
    Compare => compare,
    /// Find effects that a plain model of recorded data lacks, offline
    Diagnose => diagnose,
    /// Diagnose recorded data and plan the motion that would answer what is left open
    Next => next,
    /// Compare two reports side by side
    Report => report,
    /// Compute the torques of a model along a recorded motion
    Predict => predict,
    /// Find the body on the flange from a short motion of the wrist, or plan that motion
    Payload => payload,
    /// Write the identified arm as URDF, MuJoCo model or C function, or its load in a maker's format
    Export => export,
    /// Check whether this machine is fit for 1 kHz, and list what to change
    Doctor => doctor,
    /// Analyse the recording of a fault
    Postmortem => postmortem,
    /// List the effects of the diagnosis, with their equations
    Effects => effects,
    /// Print the feed-forward torque that a daemon serves
    Torque => torque,
    /// Pass torque, model and states to and from other users of this machine
    Relay => relay,
    /// Watch a running daemon in the terminal
    Monitor => monitor,
    /// Print the readings of a job's inclinometer
    Inclinometer => inclinometer,
    /// Send a request to a running daemon: start, stop, resume, quit, status, ...
    Command => command,
    /// Write man pages, shell completions and JSON schemas of configuration files into a folder
    Manual => manual,
}

impl Subcommand {
    /// How results are shown, of a command that makes a report.
    fn output(&self) -> Option<&output::Output> {
        match self {
            Subcommand::Run(options) => Some(options.output()),
            Subcommand::Identify(options) => Some(options.output()),
            Subcommand::Diagnose(options) => Some(options.output()),
            Subcommand::Next(options) => Some(options.output()),
            Subcommand::Compare(options) => Some(options.output()),
            _ => None,
        }
    }
}

/// Runs the command line and turns its outcome into an exit code: 0 success, 1 a failed job, 2 bad input.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    let serves = matches!(
        cli.subcommand,
        Subcommand::Run(_) | Subcommand::Daemon(_) | Subcommand::Estimator(_) | Subcommand::Relay(_)
    );
    if cli.subcommand.output().is_some_and(|output| output.quiet) {
        progress::send_to(Target::Nowhere);
    }
    journal::start(serves, cli.subcommand.output().map_or(journal::FILTER, output::Output::log_filter));
    let outcome = cli.subcommand.run();
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
    match runtime_dir::other_serving_user() {
        Some(owner) => Failure::job(format!(
            "{error}; the service on this machine belongs to user {owner}, and only that user may connect to it: `sudo -u plumbline plumbline ...`"
        )),
        None => Failure::job(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The recipe "Add a subcommand" of CONTRIBUTING.md, with a made-up subcommand.
    mod recipe {
        use super::*;

        mod made_up {
            use crate::failure::Failure;

            /// Options of the made-up subcommand.
            #[derive(clap::Args)]
            pub struct Options {
                /// Whether the job fails
                #[arg(long)]
                fails: bool,
            }

            /// Succeeds, or fails with `--fails`.
            pub fn run(options: Options) -> Result<(), Failure> {
                if options.fails { Err(Failure::job("failed on request")) } else { Ok(()) }
            }
        }

        subcommands! {
            /// A made-up subcommand
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
            assert_eq!((failed.code(), failed.to_string().as_str()), (1, "failed on request"));
            assert!(run(&["plumbline", "other"]).is_err());
        }
    }
}
