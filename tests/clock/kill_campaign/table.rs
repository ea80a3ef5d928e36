//! Results of the campaign and their table.

use plumbline_testkit::kill::Monitors;
use std::fmt::Write as _;
use std::sync::PoisonError;

/// Result of one fault injection.
#[derive(Debug, Default)]
pub struct Outcome {
    /// Whether the motion continued; otherwise it ended, by rule.
    pub continued: bool,
    /// Time until the restarted process was ready \[ms\].
    pub up: Option<f64>,
    /// Time from the fault to the arm's rest, by the arm's own states \[ms\].
    pub rest: Option<f64>,
}

/// Results of one process and one fault.
#[derive(Default)]
pub struct Row {
    pub name: String,
    pub continued: u32,
    pub stopped: u32,
    /// Rounds in which this machine stopped the motion before the fault.
    pub not_counted: u32,
    pub up: Vec<f64>,
    pub rest: Vec<f64>,
    pub samples: u64,
    pub torques: u64,
    pub violations: Vec<String>,
}

impl Row {
    pub fn take(&mut self, round: u32, outcome: Result<Option<Outcome>, String>) {
        match outcome {
            Ok(None) => self.not_counted += 1,
            Ok(Some(Outcome { continued, up, rest })) => {
                *(if continued { &mut self.continued } else { &mut self.stopped }) += 1;
                self.up.extend(up);
                self.rest.extend(rest);
            }
            Err(violation) => self.violations.push(format!("round {round}: {violation}")),
        }
    }

    pub fn line(&self) -> String {
        let times = |of: &[f64]| {
            let mut of = of.to_vec();
            of.sort_by(f64::total_cmp);
            let at = |share: f64| of.get(((of.len() - 1) as f64 * share) as usize).copied().unwrap_or(f64::NAN);
            if of.is_empty() { "-".into() } else { format!("{:.0} / {:.0}", at(0.5), at(1.0)) }
        };
        let (rest, up) = (times(&self.rest), times(&self.up));
        format!(
            "| {} | {} | {} | {} | {rest} | {up} | {} | {} | {} |",
            self.name,
            self.continued + self.stopped,
            self.continued,
            self.stopped,
            self.samples,
            self.torques,
            self.violations.len()
        )
    }

    /// Takes what the monitors have found since the round before.
    pub fn take_violations(&mut self, round: u32, monitors: &Monitors) {
        let found = std::mem::take(&mut *monitors.violations.lock().unwrap_or_else(PoisonError::into_inner));
        self.violations.extend(found.into_iter().map(|violation| format!("round {round}: {violation}")));
    }
}

/// The load average over five minutes, as the kernel prints it.
pub fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().nth(1).unwrap_or("unknown").to_string()
}

/// The block of docs/results/campaigns.md; `before` is the load before the campaign.
pub fn page(rounds: u32, seed: u64, before: &str, rows: &[Row]) -> String {
    let mut text = format!(
        "{rounds} of each kind, seeds {seed} to {}. Load of the machine before and after: {before}, {}; it has {} processors.\n\n\
         | killed | counted | the motion went on | the motion ended, by rule | the arm at rest after, median / worst \\[ms\\] | successor up, median / worst \\[ms\\] | samples witnessed, none \
         lost or twice | torques witnessed | promises broken |\n|---|---|---|---|---|---|---|---|---|\n",
        seed + 7,
        load(),
        std::thread::available_parallelism().map_or(0, usize::from)
    );
    for row in rows {
        writeln!(text, "{}", row.line()).unwrap();
    }
    if rows.iter().any(|row| row.not_counted > 0 || !row.violations.is_empty()) {
        text.push('\n');
    }
    for row in rows {
        for violation in &row.violations {
            writeln!(text, "- {}: {violation}", row.name).unwrap();
        }
        if row.not_counted > 0 {
            let Row { name, not_counted, .. } = row;
            writeln!(
                text,
                "- {name}: {not_counted} rounds did not count: this machine stopped the motion before the fault."
            )
            .unwrap();
        }
    }
    text
}
