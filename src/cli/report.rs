//! `plumbline report`: two reports side by side.

use crate::cli::say::say;
use crate::failure::Failure;
use crate::report::Report;
use crate::report::compared::Compared;
use clap::Args;
use plumbline_core::BadInput;
use std::path::{Path, PathBuf};

/// Options of `plumbline report`.
#[derive(Args)]
pub struct Options {
    /// Folder with a report.json, of the reference
    before: PathBuf,
    /// Folder with a report.json, to compare with it
    after: PathBuf,
    /// Page to write
    #[arg(long, value_name = "FILE", default_value = "compared.html")]
    out: PathBuf,
    /// Print the comparison as JSON instead of a summary
    #[arg(long)]
    json: bool,
}

/// Writes the page and prints what differs most.
pub fn run(options: Options) -> Result<(), Failure> {
    let (before, after) = (read(&options.before)?, read(&options.after)?);
    if before.robot != after.robot {
        let expected = format!("`{}`, the robot of {}", before.robot, options.before.display());
        let file = options.after.join("report.json").display().to_string();
        return Err(BadInput::new(file, "key `robot`", format!("`{}`", after.robot), expected).into());
    }
    let compared = Compared::of([(name(&options.before), before), (name(&options.after), after)]);
    crate::atomic::write_result(&options.out, compared.to_html().map_err(Failure::job)?.as_bytes())?;
    if options.json {
        say!("{}", serde_json::to_string_pretty(&compared.facts()).map_err(Failure::job)?);
        return Ok(());
    }
    compared.summary().iter().for_each(|line| say!("{line}"));
    say!("page: {}", options.out.display());
    Ok(())
}

fn name(dir: &Path) -> String {
    dir.display().to_string()
}

/// A report that a person has named: one that can't be read is bad input.
fn read(dir: &Path) -> Result<Report, Failure> {
    let file = dir.join("report.json");
    let bad = |found: &dyn std::fmt::Display| {
        let expected = "a folder with the report.json of identify, diagnose, compare or run";
        Failure::from(BadInput::new(file.display().to_string(), "file", found, expected))
    };
    let text = std::fs::read_to_string(&file).map_err(|error| bad(&error))?;
    serde_json::from_str(&text).map_err(|error| bad(&error))
}
