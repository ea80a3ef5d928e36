//! The few lines that say how a job went.

use super::{Report, Validation};

/// Runs of one mounting, in the order of the report.
pub(super) struct Group<'r> {
    pub mounting: &'r str,
    pub runs: Vec<&'r Validation>,
}

/// Validation runs by mounting.
pub(super) fn groups(report: &Report) -> Vec<Group<'_>> {
    let mut groups: Vec<Group> = Vec::new();
    for run in &report.validate {
        match groups.iter_mut().find(|group| group.mounting == run.mounting.name) {
            Some(group) => group.runs.push(run),
            None => groups.push(Group { mounting: &run.mounting.name, runs: vec![run] }),
        }
    }
    groups
}

impl Group<'_> {
    /// Mean over the runs, per joint.
    pub fn per_joint(&self) -> Vec<f64> {
        let n = self.runs.first().map_or(0, |run| run.rms.len());
        (0..n).map(|j| mean(&self.runs.iter().filter_map(|run| run.rms.get(j).copied()).collect::<Vec<_>>())).collect()
    }
}

pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

pub(super) fn lines(report: &Report) -> Vec<String> {
    let (base, mounting) = (&report.base, &report.mounting.name);
    let mut lines = vec![format!("{}, mounting {mounting}: {} parameters ({})", report.robot, base.count, base.kind)];
    if !report.conditions.is_empty() {
        let one = |c: &super::Condition| {
            format!("{} {} (rigid body alone {})", c.definition, digits(c.with_friction), digits(c.without_friction))
        };
        lines.push(format!("condition number: {}", report.conditions.iter().map(one).collect::<Vec<_>>().join(", ")));
    }
    let floor = mean(&report.noise_floor);
    let against = |rms: &[f64]| {
        if report.noise_floor.is_empty() || floor == 0.0 {
            return String::new();
        }
        format!(", {:.2} of the noise floor", mean(rms) / floor)
    };
    let row = |values: &[f64]| values.iter().map(|value| format!("{value:.3}")).collect::<Vec<_>>().join(" ");
    if !report.noise_floor.is_empty() {
        lines.push(format!("noise floor [Nm]: {} | mean {floor:.3}", row(&report.noise_floor)));
    }
    for group in groups(report) {
        let rms = group.per_joint();
        let (name, count) = (group.mounting, group.runs.len());
        let runs = if count == 1 { "run" } else { "runs" };
        let relative = against(&rms);
        lines.push(format!("RMS {name} [Nm], {count} unseen {runs}: {} | mean {:.3}{relative}", row(&rms), mean(&rms)));
    }
    if let Some(cycle) = &report.cycle {
        lines.push(format!(
            "loop ({}): {} cycles, {} late, {} lost, {} allocations",
            cycle.pace, cycle.cycles, cycle.late, cycle.lost, cycle.allocations
        ));
    }
    if let Some(ipc) = &report.ipc {
        let verdict = if ipc.sent == ipc.received { "none missing" } else { "NOT EQUAL" };
        lines.push(format!("samples: {} sent, {} received, {verdict}", ipc.sent, ipc.received));
    }
    let names = |names: &[String]| names.join(", ");
    if !report.identifiability.not_identifiable.is_empty() {
        lines.push(format!("not identifiable from this data: {}", names(&report.identifiability.not_identifiable)));
    }
    if !report.identifiability.untrusted_runs.is_empty() {
        lines.push(format!("runs that the model can't vouch for: {}", names(&report.identifiability.untrusted_runs)));
    }
    lines
}

/// About three significant digits.
pub(super) fn digits(value: f64) -> String {
    if !value.is_finite() {
        return "-".to_string();
    }
    match value.abs() {
        0.0 => "0".to_string(),
        size if !(1e-4..1e6).contains(&size) => format!("{value:.2e}"),
        size => {
            let decimals = (2 - size.log10().floor() as i32).clamp(0, 6) as usize;
            format!("{value:.decimals$}")
        }
    }
}
