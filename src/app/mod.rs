//! Floor 4: one file per subcommand, wiring only.

mod failure;

pub use failure::Failure;

use clap::{Args, Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// Identifies the dynamics of a serial robot arm for any mounting and serves the torques it needs at 1 kHz.
#[derive(Parser)]
#[command(name = "plumbline", version, max_term_width = 100)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Optimise an excitation and write it to a plan file
    Plan(plan::Options),
    /// Do the whole job on one machine: daemon, estimator, report
    Run(run::Options),
    /// Run the real-time process (what the systemd service starts)
    Daemon(daemon::Options),
    /// Run the estimator process (what the systemd service starts)
    Estimator(estimator::Options),
    /// Identify from files, offline
    Identify(identify::Options),
    /// Compute the torques of a model along a recorded motion
    Predict(predict::Options),
    /// Print the feed-forward torque that a daemon serves
    Torque(torque::Options),
}

/// A job file and what overrides it.
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
}

/// Runs the command line and turns its outcome into an exit code: 0 success, 1 a failed job, 2 bad input.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    logging();
    let outcome = match cli.command {
        Command::Plan(options) => plan::run(options),
        Command::Run(options) => run::run(options),
        Command::Daemon(options) => daemon::run(options),
        Command::Estimator(options) => estimator::run(options),
        Command::Identify(options) => identify::run(options),
        Command::Predict(options) => predict::run(options),
        Command::Torque(options) => torque::run(options),
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            eprintln!("plumbline: {failure}");
            ExitCode::from(failure.code())
        }
    }
}

/// Log lines go to standard error; `PLUMBLINE_LOG` takes a tracing filter such as `plumbline=debug`.
fn logging() {
    let filter = tracing_subscriber::EnvFilter::try_from_env("PLUMBLINE_LOG")
        .unwrap_or_else(|_| tracing_subscriber::EnvFilter::new("warn,plumbline=info"));
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).with_target(false).init();
}
