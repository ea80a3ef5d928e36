//! `plumbline doctor`: is this machine fit for 1 kHz, and what to change.

use crate::cli::say::say;
use crate::config::job::Job;
use crate::failure::Failure;
use crate::machine::{self, Finding, Tree, Verdict, Wanted};
use crate::setup::{JobOptions, backend};
use clap::Args;
use plumbline_rt::Rights;
use std::net::IpAddr;
use std::path::PathBuf;

/// Options of `plumbline doctor`.
#[derive(Args)]
pub struct Options {
    /// The job that the machine is to be fit for; without one, the defaults of a job are taken
    config: Option<PathBuf>,
    /// Override one key of the job, as in --set realtime.cpu=3 (repeatable)
    #[arg(long = "set", value_name = "KEY.PATH=VALUE", requires = "config")]
    sets: Vec<String>,
    /// How long wake-ups are measured, in seconds
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    seconds: u64,
    /// Write the findings as JSON
    #[arg(long)]
    json: bool,
}

/// Looks, measures, and says what to change.
pub fn run(options: Options) -> Result<(), Failure> {
    let wanted = match &options.config {
        Some(config) => {
            let job = JobOptions { config: config.clone(), sets: options.sets.clone(), out: None, root_owned: false };
            let (job, robot, _) = job.load()?;
            let address = backend::connector(&job, &robot)?.address();
            wanted_by(&job, address)
        }
        None => Wanted { rights: Rights::default(), robot: None },
    };
    let mut findings = machine::rights(&wanted);
    findings.extend(machine::look(&Tree::default(), &wanted));
    findings.push(machine::wake_ups(&wanted, options.seconds));
    let unfit: Vec<&str> = findings.iter().filter(|one| one.verdict == Verdict::Unfit).map(|one| one.name).collect();
    if options.json {
        let report = serde_json::json!({ "fit": unfit.is_empty(), "unfit": unfit, "findings": findings });
        say!("{}", serde_json::to_string_pretty(&report).map_err(Failure::job)?);
    } else {
        findings.iter().for_each(show);
    }
    match unfit.is_empty() {
        true if options.json => Ok(()),
        true => {
            say!("fit for 1 kHz");
            Ok(())
        }
        false => Err(Failure::job(format!("unfit for 1 kHz: {}", unfit.join(", ")))),
    }
}

fn wanted_by(job: &Job, robot: Option<IpAddr>) -> Wanted {
    let realtime = &job.realtime;
    Wanted {
        rights: Rights {
            priority: Some(realtime.priority).filter(|&priority| priority > 0),
            cpu: realtime.cpu,
            lock_memory: realtime.lock_memory,
            preempt_rt: realtime.preempt_rt,
        },
        robot,
    }
}

fn show(finding: &Finding) {
    let mark = match finding.verdict {
        Verdict::Fit => "fit",
        Verdict::Unknown => "-",
        Verdict::Advice => "advice",
        Verdict::Unfit => "UNFIT",
    };
    say!("{mark:<7} {:<16} {}", finding.name, finding.found);
    if let Some(change) = &finding.change {
        say!("{:<7} {:<16} change: {change}", "", "");
    }
}
