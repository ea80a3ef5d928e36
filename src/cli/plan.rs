//! `plumbline plan`: searches excitations and writes them to plan files.

use crate::analysis::{conditions_facts, conditions_text};
use crate::cli::say::say;
use crate::failure::Failure;
use crate::offline::plan::{self, Planned, Purpose, plan};
use crate::process::signals::Ending;
use crate::report::robot::unchecked;
use crate::store::save_plan;
use clap::Args;
use plumbline_excite::PlanUsage;
use plumbline_model::Robot;
use serde_json::Value;
use std::path::{Path, PathBuf};

/// Options of `plumbline plan`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    plan: plan::Options,
    /// Plan file to write; several motions become plan-1.toml, plan-2.toml, .., plan-validate-1.toml, ..
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Print condition numbers and use of the limits as JSON, one entry per plan file
    #[arg(long)]
    json: bool,
}

/// Writes each motion when it is found. Ctrl-C ends the search with the best motion so far.
pub fn run(options: Options) -> Result<(), Failure> {
    let robot = Robot::load(&options.plan.robot, None)?;
    if !options.json {
        unchecked(&robot).iter().for_each(|line| say!("note: {line}"));
    }
    let ending = Ending::interrupts()?;
    let mut written: Vec<Value> = Vec::new();
    plan(&options.plan, &|| ending.arrived(), &mut |planned| {
        if ending.arrived() {
            eprintln!("plumbline: interrupted; the best motion so far is kept");
        }
        let path = file_of(&options.out, planned.purpose);
        save_plan(&planned.plan, &path).map_err(Failure::job)?;
        if options.json {
            written.push(facts(&planned, &path));
        } else {
            show(&planned, &path);
        }
        Ok(())
    })?;
    if options.json {
        say!("{}", serde_json::to_string_pretty(&written).map_err(Failure::job)?);
    }
    Ok(())
}

/// `plan.toml` for a motion alone, else `plan-2.toml` or `plan-validate-2.toml`.
fn file_of(out: &Path, purpose: Purpose) -> PathBuf {
    let (kind, k) = match purpose {
        Purpose::Identify { of: 1, .. } => return out.to_path_buf(),
        Purpose::Identify { number, .. } => ("", number),
        Purpose::Validate { number } => ("-validate", number),
    };
    let stem = out.file_stem().map_or("plan".into(), |stem| stem.to_string_lossy().into_owned());
    let extension = out.extension().map_or("toml".into(), |extension| extension.to_string_lossy().into_owned());
    out.with_file_name(format!("{stem}{kind}-{k}.{extension}"))
}

/// Condition numbers and use of the limits, as `--json` prints them.
fn facts(Planned { plan, together, .. }: &Planned, path: &Path) -> Value {
    serde_json::json!({
        "file": path, "conditions": conditions_facts(&plan.conditions), "usage": plan.usage,
        "with_those_before": together.as_ref().map(conditions_facts),
    })
}

fn show(Planned { plan, purpose, together }: &Planned, path: &Path) {
    say!("{}: condition {}", path.display(), conditions_text(&plan.conditions));
    if let Some(usage) = &plan.usage {
        say!("  {}", usage_text(usage));
    }
    if let (Purpose::Identify { number, .. }, Some(together)) = (purpose, together) {
        say!("  with the {} before it: condition {}", number - 1, conditions_text(together));
    }
}

/// Shares of range and speed per joint, in one line.
fn usage_text(usage: &PlanUsage) -> String {
    let percent = |shares: &[f64]| shares.iter().map(|x| format!("{:.0}", 100.0 * x)).collect::<Vec<_>>().join(" ");
    format!("used per joint [%]: range {}, speed {}", percent(&usage.range), percent(&usage.speed))
}
