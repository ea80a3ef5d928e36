//! `plumbline torque`: a shared-memory client that prints the served feed-forward torque.

use crate::failure::Failure;
use clap::Args;
use plumbline_core::Validity;
use plumbline_ipc::{FeedForwardClient, FeedForwardSettings, Latest, Presence, RobotId};
use std::io::Write;
use std::time::{Duration, Instant};

/// Options of `plumbline torque`.
#[derive(Args)]
pub struct Options {
    /// Print until interrupted
    #[arg(long)]
    follow: bool,
    /// Robot that the daemon drives
    #[arg(long, default_value = "panda")]
    robot: String,
    /// Lines per second while following
    #[arg(long, default_value_t = 10.0, value_parser = rate)]
    rate: f64,
    /// End after this many lines
    #[arg(long)]
    count: Option<u64>,
}

fn rate(text: &str) -> Result<f64, String> {
    let rate = text.parse::<f64>().map_err(|error| error.to_string())?;
    if (0.01..=1000.0).contains(&rate) { Ok(rate) } else { Err("expected 0.01 to 1000 lines per second".into()) }
}

const TIMEOUT: Duration = Duration::from_secs(2);

/// Prints the latest value, or one after another.
pub fn run(options: Options) -> Result<(), Failure> {
    let id = RobotId::parse("command line", "--robot", &options.robot)?;
    let mut client =
        FeedForwardClient::connect(&id, FeedForwardSettings::default(), TIMEOUT).map_err(crate::cli::unreachable)?;
    let count = if options.follow { options.count.unwrap_or(u64::MAX) } else { options.count.unwrap_or(1) };
    let mut out = std::io::stdout();
    // A new subscriber receives its first value in the daemon's next cycle.
    let start = Instant::now();
    while client.latest().map_err(Failure::job)?.is_none() && start.elapsed() < TIMEOUT {
        std::thread::sleep(Duration::from_millis(1));
    }
    for _ in 0..count {
        let line = match client.latest().map_err(Failure::job)? {
            Some(latest) => line(&latest, client.daemon()),
            None => "no value yet".to_string(),
        };
        // The reader has closed the pipe.
        if writeln!(out, "{line}").is_err() {
            break;
        }
        std::thread::sleep(Duration::from_secs_f64(1.0 / options.rate));
    }
    Ok(())
}

/// One line: sequence number, age, model, torques, validity.
fn line(latest: &Latest, daemon: Presence) -> String {
    let torques: Vec<String> = latest.message.torque().iter().map(|tau| format!("{tau:9.4}")).collect();
    let state = match (daemon, latest.stale, latest.message.validity()) {
        (Presence::Gone, ..) => "  DAEMON GONE",
        (_, true, _) => "  STALE",
        (.., Ok(Validity::Valid)) => "",
        (.., Ok(Validity::HandOver)) => "  HAND-OVER",
        (.., Ok(Validity::Doubtful)) => "  DOUBTFUL",
        (.., Ok(Validity::Withdrawn)) => "  WITHDRAWN",
        (.., Ok(Validity::None) | Err(_)) => "  NO MODEL",
    };
    format!(
        "{:10}  age {:8.3} ms  model {:016x}  tau_ff {} Nm{state}",
        latest.message.sequence,
        latest.age_ns as f64 * 1e-6,
        latest.message.model,
        torques.join(" ")
    )
}
