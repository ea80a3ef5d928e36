//! Checks of recorded data before anything is fitted to it: [`plumbline_identify::check`] on a dataset.

use crate::dataset::{Dataset, Role, Run};
use plumbline_core::{BadInput, parallel, threads};
use plumbline_identify::check::{self, Finding, State};
use plumbline_model::Robot;
use std::path::Path;

/// Findings of every run of a dataset, those that fail first. The equations of motion are fitted only where no channel fails: they would repeat the
/// same mistake in other words.
pub fn findings(dataset: &Dataset, robot: &Robot) -> Vec<Finding> {
    let of_samples = parallel(&dataset.runs, threads(), |run| check::samples(robot, &run.data));
    let mut findings: Vec<Finding> = of_samples.into_iter().flatten().collect();
    if findings.iter().all(|finding| finding.state < State::Fail) {
        let known: Vec<Robot> = Robot::names().filter_map(|name| Robot::load(name, None).ok()).collect();
        let session = dataset.runs.iter().find(|run| run.role == Role::Identify).map(|run| run.session);
        // What changes between sessions is what a diagnosis looks for.
        let with = |role: Role| -> Vec<&plumbline_identify::Run> {
            let own = |run: &&Run| run.role == role && Some(run.session) == session;
            dataset.runs.iter().filter(own).map(|run| &run.data).collect()
        };
        findings.extend(check::dynamics(robot, &known, &with(Role::Identify), &with(Role::Validate)));
    }
    findings.sort_by_key(|finding| std::cmp::Reverse(finding.state));
    findings
}

/// The findings of a dataset in `folder`.
///
/// # Errors
/// The first one that fails, with the file of its run.
pub fn checked(folder: &Path, dataset: &Dataset, robot: &Robot) -> Result<Vec<Finding>, BadInput> {
    checked_findings(folder, findings(dataset, robot))
}

/// The same for findings that are known.
///
/// # Errors
/// As [`checked`].
pub fn checked_findings(folder: &Path, findings: Vec<Finding>) -> Result<Vec<Finding>, BadInput> {
    let failed: Vec<&Finding> = findings.iter().filter(|finding| finding.state == State::Fail).collect();
    let Some(first) = failed.first() else { return Ok(findings) };
    let mut bad = refusal(folder, first);
    if failed.len() > 1 {
        let others = failed.len() - 1;
        bad.expected.push_str(&format!("; {others} more: plumbline check {}", folder.display()));
    }
    Err(bad)
}

/// A finding as an error.
pub fn refusal(folder: &Path, finding: &Finding) -> BadInput {
    let file = folder.join(&finding.run).display().to_string();
    BadInput::new(file, format!("{} ({})", finding.place, finding.check), &finding.found, finding.expected.clone())
}

/// A finding in one line.
pub fn line(finding: &Finding) -> String {
    let state = if finding.state == State::Fail { "FAIL" } else { "warn" };
    let Finding { check, run, place, found, expected, .. } = finding;
    format!("{state} {check}: {run}, {place}: {found}; expected {expected}")
}

/// Refuses a folder of results that is a file.
pub fn is_folder(out: &Path) -> Result<(), BadInput> {
    if out.is_file() {
        let expected = "a folder for the results, or a name that does not exist yet";
        return Err(BadInput::new("command line", "--out", format!("the file {}", out.display()), expected));
    }
    Ok(())
}
