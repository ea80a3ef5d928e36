//! `plumbline doctor`: checks whether this computer is fit for 1 kHz, and lists what to change.

use crate::cli::say::say;
use crate::config::job::Job;
use crate::failure::Failure;
use crate::machine::{self, Finding, Requirements, Tree, Verdict};
use crate::setup::{JobOptions, backend};
use clap::Args;
use plumbline_rt::Rights;
use std::net::IpAddr;
use std::path::PathBuf;

/// Options of `plumbline doctor`.
#[derive(Args)]
pub struct Options {
    /// Job with the real-time settings; without one, the defaults are used
    config: Option<PathBuf>,
    /// Override one key of the job, as in --set realtime.cpu=3 (repeatable)
    #[arg(long = "set", value_name = "KEY.PATH=VALUE", requires = "config")]
    sets: Vec<String>,
    /// Duration of the wake-up measurement in s
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(1..=86_400))]
    seconds: u64,
    /// Write the findings as JSON
    #[arg(long)]
    json: bool,
}

/// Inspects, measures and prints the findings.
pub fn run(options: Options) -> Result<(), Failure> {
    let requirements = match &options.config {
        Some(config) => {
            let job = JobOptions { config: config.clone(), sets: options.sets.clone(), out: None, root_owned: false };
            let (job, robot, _) = job.load()?;
            let address = backend::connector(&job, &robot)?.address();
            requirements_of(&job, address)
        }
        None => Requirements { rights: Rights::default(), robot: None },
    };
    let mut findings = machine::rights(&requirements);
    findings.extend(machine::inspect(&Tree::default(), &requirements));
    findings.push(machine::wake_ups(&requirements, options.seconds));
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

fn requirements_of(job: &Job, robot: Option<IpAddr>) -> Requirements {
    let realtime = &job.realtime;
    Requirements {
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
