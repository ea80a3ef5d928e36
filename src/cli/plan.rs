//! `plumbline plan`: searches excitations and writes them to plan files.

use crate::analysis::conditions_text;
use crate::cli::say::say;
use crate::failure::Failure;
use crate::offline::plan::{self, Planned, Purpose, plan};
use crate::process::signals::Ending;
use crate::store::save_plan;
use clap::Args;
use plumbline_excite::PlanUsage;
use plumbline_model::Robot;
use std::path::{Path, PathBuf};

/// Options of `plumbline plan`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    plan: plan::Options,
    /// Plan file to write; several motions become plan-1.toml, plan-2.toml, .., plan-validate-1.toml, ..
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
}

/// Writes each motion when it is found. Ctrl-C ends the search with the best motion so far.
pub fn run(options: Options) -> Result<(), Failure> {
    let robot = Robot::load(&options.plan.robot, None)?;
    crate::report::arm::unchecked(&robot).iter().for_each(|line| say!("note: {line}"));
    let ending = Ending::interrupts()?;
    plan(&options.plan, &|| ending.arrived(), &mut |planned| {
        if ending.arrived() {
            eprintln!("plumbline: interrupted; the best motion so far is kept");
        }
        write(&planned, &file_of(&options.out, planned.purpose))
    })
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

fn write(Planned { plan, purpose, together }: &Planned, path: &Path) -> Result<(), Failure> {
    save_plan(plan, path).map_err(Failure::job)?;
    say!("{}: condition {}", path.display(), conditions_text(&plan.conditions));
    if let Some(usage) = &plan.usage {
        say!("  {}", usage_text(usage));
    }
    if let (Purpose::Identify { number, .. }, Some(together)) = (purpose, together) {
        say!("  with the {} before it: condition {}", number - 1, conditions_text(together));
    }
    Ok(())
}

/// Shares of range and speed per joint, in one line.
fn usage_text(usage: &PlanUsage) -> String {
    let percent = |shares: &[f64]| shares.iter().map(|x| format!("{:.0}", 100.0 * x)).collect::<Vec<_>>().join(" ");
    format!("used per joint [%]: range {}, speed {}", percent(&usage.range), percent(&usage.speed))
}
