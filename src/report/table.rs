//! The table that a command prints at the end: joints as columns, one row per kind of error, the verdict above.

use super::diagnosis::{self, Diagnosis, Verdict};
use super::summary::{Group, groups, mean};
use super::{Band, Report};
use plumbline_identify::check::State;

/// Most lines of a table.
pub const MAX_LINES: usize = 14;
/// Columns of a terminal that the table fits into.
pub const WIDTH: usize = 80;
/// Width of a joint's column.
const CELL: usize = 6;
/// Width of the column of means.
const MEAN: usize = 8;
/// Lines about findings.
const MAX_FINDINGS: usize = 3;

/// How good a verdict is, which a terminal shows as a colour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    Good,
    Warn,
    Bad,
}

impl Tone {
    pub fn of(verdict: Verdict) -> Tone {
        match verdict {
            Verdict::NothingSignificant | Verdict::Diagnosed => Tone::Good,
            Verdict::NotDetermined | Verdict::Ambiguous | Verdict::Partly => Tone::Warn,
            Verdict::Unexplained => Tone::Bad,
        }
    }
}

/// A table as lines, with the words that have a colour on a terminal.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    pub lines: Vec<String>,
    /// Line of the verdict, its length in bytes from the line's begin, and its tone.
    pub verdict: Option<(usize, usize, Tone)>,
}

impl Table {
    pub(super) fn of(report: &Report) -> Table {
        let mut table = Table::default();
        table.push(format!("{}, {}: {}", report.robot, report.mounting.name, count(report)));
        if let Some(of) = &report.diagnosis {
            let verdict = of.verdict.to_string();
            table.verdict = Some((table.lines.len(), verdict.len(), Tone::of(of.verdict)));
            let headline = diagnosis::headline(of);
            let of_verdict = if headline.is_empty() { verdict } else { format!("{verdict}: {headline}") };
            let confirmed = diagnosis::confirmation_of_one(of).map_or(String::new(), |text| format!(", {text}"));
            table.push(of_verdict + &confirmed);
            details(of).into_iter().for_each(|line| table.push(format!("  {line}")));
        }
        let below = [counter(report), care(report), counters(report)];
        let below: Vec<String> = below.into_iter().flatten().collect();
        table.errors(report, MAX_LINES.saturating_sub(below.len()));
        below.into_iter().for_each(|line| table.push(line));
        table
    }

    fn push(&mut self, line: String) {
        self.lines.push(cut(&line, WIDTH));
    }

    /// Rows of errors up to line `end`, under a row that numbers the joints.
    fn errors(&mut self, report: &Report, end: usize) {
        let rows = rows(report);
        let Some(joints) = rows.iter().map(|(_, values)| values.len()).max().filter(|joints| *joints > 0) else {
            return;
        };
        let label = WIDTH.saturating_sub(CELL * joints + MEAN).clamp(12, 26);
        let room = end.saturating_sub(self.lines.len() + 1);
        let head: String = (1..=joints).map(|j| format!("{j:>CELL$}")).collect();
        let unit = match report.band {
            Band::Raw => "RMS / Nm, joint".to_string(),
            Band::Filtered { cutoff } => format!("RMS / Nm to {cutoff} Hz"),
        };
        self.push(format!("{:label$}{head}{:>MEAN$}", cut(&unit, label), "mean"));
        let hidden = if rows.len() > room { rows.len() + 1 - room } else { 0 };
        for (name, values) in &rows[..rows.len() - hidden] {
            let cells: String = values.iter().map(|value| format!("{:>CELL$}", number(*value))).collect();
            let mean = number(mean(values));
            self.push(format!("{:label$}{cells}{mean:>MEAN$}", cut(name, label - 1)));
        }
        if hidden > 0 {
            self.push(format!("{hidden} more rows with --verbose"));
        }
    }
}

/// `59 base parameters (GBS), 2 of effects`.
fn count(report: &Report) -> String {
    let effects =
        if report.base.effects == 0 { String::new() } else { format!(", {} of effects", report.base.effects) };
    format!("{} base parameters ({}){effects}", report.base.count, report.base.kind)
}

/// Noise floor, fit, every mounting's unseen runs, and what the mean period lacks.
fn rows(report: &Report) -> Vec<(String, Vec<f64>)> {
    let mut rows: Vec<(String, Vec<f64>)> = Vec::new();
    let of = report.diagnosis.as_ref();
    // The floor of raw samples is none of filtered ones.
    let floor = match report.band {
        Band::Raw => report.noise_floor.clone(),
        Band::Filtered { .. } => of.map_or(Vec::new(), |of| of.noise_floor.clone()),
    };
    rows.push(("noise floor".into(), floor));
    rows.push(("fit".into(), report.identify.rms(&report.band).clone()));
    let runs = |group: &Group| {
        let count = group.runs.len();
        format!("{}, {count} unseen {}", group.mounting, if count == 1 { "run" } else { "runs" })
    };
    rows.extend(groups(report).iter().map(|group| (runs(group), group.per_joint())));
    if let Some(of) = of.filter(|of| diagnosis::grown(of)) {
        let (before, after) = unmodelled(of);
        if before.iter().all(|value| value.is_finite()) {
            rows.push(("unmodelled, before".into(), before));
            rows.push(("unmodelled, after".into(), after));
        } else {
            rows.push(("unseen, before effects".into(), of.before.validate_rms.clone()));
        }
    }
    rows.retain(|(_, values)| !values.is_empty());
    rows
}

/// Torque of the mean period that is neither modelled nor noise, per joint, before and after \[Nm\].
fn unmodelled(of: &Diagnosis) -> (Vec<f64>, Vec<f64>) {
    let known = |value: Option<f64>| value.unwrap_or(f64::NAN);
    let facts = of.joints.iter();
    facts.map(|joint| (known(joint.unmodelled.before), known(joint.unmodelled.after))).unzip()
}

/// The findings with their parameters; what would have been seen where there are none.
fn details(of: &Diagnosis) -> Vec<String> {
    let mut lines = diagnosis::findings_in_short(of);
    if lines.len() > MAX_FINDINGS {
        let more = lines.len() + 1 - MAX_FINDINGS;
        lines.truncate(MAX_FINDINGS - 1);
        lines.push(format!("and {more} more with --verbose"));
    }
    lines
}

/// The vertical set where it is not valid, in its worst joint.
fn counter(report: &Report) -> Option<String> {
    let of = report.counter_experiment.as_ref()?;
    let apart = of.forced_rms.iter().zip(&of.general_rms).enumerate();
    let (j, (forced, general)) = apart.max_by(|a, b| (a.1.0 / a.1.1).total_cmp(&(b.1.0 / b.1.1)))?;
    Some(format!(
        "{} {} parameters forced in {}: {} Nm in joint {} ({})",
        of.kind,
        of.count,
        of.refused_in.name,
        number(*forced),
        j + 1,
        number(*general)
    ))
}

/// What a reader should look at before the model is used.
fn care(report: &Report) -> Option<String> {
    let identifiability = &report.identifiability;
    let warned = report.checks.iter().filter(|finding| finding.state > State::Pass).count();
    let unsettled = report.estimator.as_ref().is_some_and(|of| !of.settled);
    let inconsistent = report.consistency.as_ref().filter(|of| !of.exact).map(|of| of.distance);
    let counted = |count: usize, what: &str| (count > 0).then(|| format!("{count} {what}"));
    let parts: Vec<String> = [
        counted(report.notes.len(), "remarks (--verbose)"),
        counted(warned, "warnings of the data's checks"),
        counted(identifiability.not_identifiable.len(), "parameters not identifiable"),
        counted(identifiability.weakly_determined.len(), "weakly determined"),
        counted(identifiability.untrusted_runs.len(), "runs where the model is not valid"),
        unsettled.then(|| "weights did not converge".to_string()),
        inconsistent.map(|distance| format!("nearest real bodies {distance:.1} deviations away")),
    ]
    .into_iter()
    .flatten()
    .collect();
    (!parts.is_empty()).then(|| format!("note: {}", parts.join(", ")))
}

/// Counters of loop and samples.
fn counters(report: &Report) -> Option<String> {
    let mut parts: Vec<String> = Vec::new();
    if let Some(of) = &report.control_loop {
        parts.push(format!("{} cycles", of.cycles));
        parts.extend(of.late.map(|late| format!("{late} late")));
        parts.push(format!("{} lost", of.lost));
        parts.extend((!of.refusals().is_empty()).then(|| "degraded, not real-time".to_string()));
    }
    if let Some(of) = &report.guest {
        parts.push(format!("{} states received, {} lost, {} late", of.received, of.lost, of.late));
    }
    if let Some(ipc) = &report.ipc {
        parts.push(format!("{} samples missing", ipc.sent.abs_diff(ipc.counters.received)));
    }
    (!parts.is_empty()).then(|| parts.join(", "))
}

/// Three digits at least, and never wider than a column.
fn number(value: f64) -> String {
    let size = value.abs();
    match value.is_finite() {
        false => "-".into(),
        // Adding zero takes the sign from a rounded zero.
        true if size < 9.9995 => format!("{:.3}", (value * 1e3).round() / 1e3 + 0.0),
        true if size < 99.995 => format!("{value:.2}"),
        true if size < 999.95 => format!("{value:.1}"),
        true if size < 99_999.5 => format!("{value:.0}"),
        true => format!("{value:.0e}"),
    }
}

/// The begin of a line that is too long.
fn cut(text: &str, width: usize) -> String {
    if text.chars().count() <= width {
        return text.to_string();
    }
    text.chars().take(width.saturating_sub(2)).collect::<String>().trim_end().to_string() + ".."
}
