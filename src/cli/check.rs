//! `plumbline check`: checks recorded data without identifying anything.

use crate::analysis::checks;
use crate::cli::say::say;
use crate::dataset::Dataset;
use crate::failure::Failure;
use clap::Args;
use plumbline_identify::check::State;
use plumbline_model::Robot;
use std::path::PathBuf;

/// Options of `plumbline check`.
#[derive(Args)]
pub struct Options {
    /// Folder with dataset.toml and one CSV file per run
    dataset: PathBuf,
}

/// Prints every finding that does not pass and a line of all checks; exit code 2 where one fails.
pub fn run(options: Options) -> Result<(), Failure> {
    let dataset = Dataset::read(&options.dataset)?;
    let robot = Robot::load(&dataset.robot, Some(&options.dataset))?;
    dataset.expect_joints(robot.chain.len())?;
    let findings = checks::findings(&dataset, &robot);
    for finding in findings.iter().filter(|finding| finding.state > State::Pass) {
        say!("{}", checks::line(finding));
    }
    let mut names: Vec<&str> = findings.iter().map(|finding| finding.check.as_str()).collect();
    names.sort_unstable();
    names.dedup();
    let count = |state: State| findings.iter().filter(|finding| finding.state == state).count();
    let (passed, warned, failed) = (count(State::Pass), count(State::Warn), count(State::Fail));
    say!("{} runs, checks {}: {passed} passed, {warned} warned, {failed} failed", dataset.runs.len(), names.join(", "));
    checks::checked_findings(&options.dataset, findings).map(|_| ()).map_err(Failure::from)
}
