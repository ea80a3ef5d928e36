//! Summary of a job in a few lines.

use super::{Band, Base, CounterExperiment, LoopReport, MotionUsage, Report, Round, TermCount, Validation, diagnosis};
use plumbline_ipc::GuestCounts;

use plumbline_identify::check::{Finding, State};

/// Ratio from which an RMS counts as changed. The scatter of an RMS over ten thousand samples is below 1 %.
pub(super) const CHANGED: f64 = 0.05;

/// Runs of one mounting, in the order of the report.
pub(super) struct Group<'r> {
    pub mounting: &'r str,
    pub band: Band,
    pub runs: Vec<&'r Validation>,
}

pub(super) fn groups(report: &Report) -> Vec<Group<'_>> {
    let mut groups: Vec<Group> = Vec::new();
    for run in &report.validate {
        match groups.iter_mut().find(|group| group.mounting == run.mounting.name) {
            Some(group) => group.runs.push(run),
            None => groups.push(Group { mounting: &run.mounting.name, band: report.band, runs: vec![run] }),
        }
    }
    groups
}

impl Group<'_> {
    /// Mean over the runs, per joint, in the report's band.
    pub fn per_joint(&self) -> Vec<f64> {
        self.mean_of(|run| Some(run.rms(&self.band)))
    }

    /// The same for raw samples; empty if the report has none.
    pub fn raw(&self) -> Vec<f64> {
        self.mean_of(|run| Some(&run.rms_raw))
    }

    /// The same for the served feed-forward; empty without one.
    pub fn served(&self) -> Vec<f64> {
        self.mean_of(|run| run.served_rms.as_ref())
    }

    fn mean_of<'r>(&'r self, of: impl Fn(&'r Validation) -> Option<&'r Vec<f64>>) -> Vec<f64> {
        let runs: Vec<&Vec<f64>> = self.runs.iter().filter_map(|run| of(run)).collect();
        let n = runs.iter().map(|rms| rms.len()).max().unwrap_or(0);
        (0..n).map(|j| mean(&runs.iter().filter_map(|rms| rms.get(j).copied()).collect::<Vec<_>>())).collect()
    }
}

pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Band of the errors as a suffix of "RMS": empty for raw samples.
pub(super) fn band(report: &Report) -> String {
    band_of(&report.band)
}

pub(super) fn band_of(band: &Band) -> String {
    match band {
        Band::Raw => String::new(),
        Band::Filtered { cutoff } => format!("after a {cutoff} Hz zero-phase low-pass"),
    }
}

/// Ratio of raw errors to the noise floor as text; `None` without a floor.
pub(super) fn against_floor(report: &Report, raw: &[f64]) -> Option<String> {
    let floor = mean(&report.noise_floor);
    (floor > 0.0 && !raw.is_empty()).then(|| format!("{:.2} of the noise floor", mean(raw) / floor))
}

/// A check of the data that did not pass.
fn warning(finding: &Finding) -> String {
    let Finding { check, run, place, found, expected, .. } = finding;
    format!("warning, check `{check}`: {run}, {place}: {found}; expected {expected}")
}

/// Number of parameters, with effects counted separately.
pub(super) fn counts(base: &Base) -> String {
    let one = |term: &TermCount| format!("{} {}", term.count, term.term.replace('-', " "));
    let terms = base.terms.iter().map(one).collect::<Vec<_>>().join(", ");
    let terms = if terms.is_empty() { String::new() } else { format!(": {terms}") };
    let effects = if base.effects == 0 { String::new() } else { format!(", and {} of effects", base.effects) };
    format!("{} base parameters ({}{terms}){effects}", base.count, base.kind)
}

/// What a round ended with and what was asked in the next one.
fn round_text(round: &Round) -> String {
    let found = if round.found.is_empty() { String::new() } else { format!(": {}", round.found.join(", ")) };
    let open: String = round.open.iter().map(|open| format!("; open: {}", diagnosis::open_question(open))).collect();
    let errors = round.validate_rms.iter().map(|rms| format!("{rms:.3}")).collect::<Vec<_>>().join(" ");
    let errors = if errors.is_empty() { String::new() } else { format!("; RMS on unseen runs [Nm]: {errors}") };
    format!("{}{found}{errors}{open}", round.verdict)
}

/// Smallest use of each joint's range and speed over all motions.
fn usage(report: &Report) -> Option<String> {
    let least = |of: fn(&MotionUsage) -> &Vec<f64>| {
        let joints = report.motions.iter().map(|motion| of(motion).len()).min().unwrap_or(0);
        let least = |j: usize| report.motions.iter().map(|motion| of(motion)[j]).fold(f64::INFINITY, f64::min);
        (0..joints).map(|j| format!("{:.0}", 100.0 * least(j))).collect::<Vec<_>>().join(" ")
    };
    let count = report.motions.len();
    (count > 0).then(|| {
        let (range, speed) = (least(|motion| &motion.range), least(|motion| &motion.speed));
        let motions = if count == 1 { "1 motion uses".into() } else { format!("{count} motions, each uses") };
        format!("{motions} per joint at least [%]: range {range}, speed {speed}")
    })
}

pub(super) fn lines(report: &Report) -> Vec<String> {
    let mut lines = without_diagnosis(report);
    let diagnosis: Vec<String> = report.diagnosis.iter().flat_map(diagnosis::lines).collect();
    lines.splice(1..1, diagnosis);
    lines
}

/// The lines without those of the diagnosis; the first names the robot.
pub(super) fn without_diagnosis(report: &Report) -> Vec<String> {
    let mut lines = vec![format!("{}, mounting {}: {}", report.robot, report.mounting.name, counts(&report.base))];
    if !report.conditions.is_empty() {
        let one = |c: &super::Condition| {
            format!("{} {} (rigid body alone {})", c.definition, digits(c.with_friction), digits(c.without_friction))
        };
        lines.push(format!("condition number: {}", report.conditions.iter().map(one).collect::<Vec<_>>().join(", ")));
    }
    lines.extend(usage(report));
    errors(report, &mut lines);
    lines.extend(report.consistency.as_ref().map(|facts| facts.sentence()));
    lines.extend(report.counter_experiment.as_ref().map(|of| format!("counter-experiment: {}", counter(of))));
    lines.extend(report.gravity.as_ref().map(|facts| format!("gravity: {}", facts.sentence())));
    lines.extend(report.control_loop.as_ref().map(control_loop));
    lines.extend(report.guest.as_ref().map(guest));
    if let Some(ipc) = &report.ipc {
        let verdict = if ipc.sent == ipc.counters.received { "none missing" } else { "NOT EQUAL" };
        lines.push(format!("samples: {} sent, {} received, {verdict}", ipc.sent, ipc.counters.received));
    }
    let names = |names: &[String]| names.join(", ");
    lines.extend(report.checks.iter().filter(|finding| finding.state > State::Pass).map(warning));
    if let Some(estimator) = report.estimator.as_ref().filter(|of| of.name != "wls" || !of.settled) {
        let end = if estimator.settled { "" } else { ", whose weights did not converge" };
        lines.push(format!("estimator: {}{end}", estimator.name));
    }
    if let Some(restricted) = report.estimator.as_ref().map(|of| &of.restricted).filter(|list| !list.is_empty()) {
        lines.push(format!("restricted to zero because not significant in this data: {}", names(restricted)));
    }
    if !report.identifiability.not_identifiable.is_empty() {
        lines.push(format!("not identifiable from this data: {}", names(&report.identifiability.not_identifiable)));
    }
    if !report.identifiability.untrusted_runs.is_empty() {
        lines.push(format!("runs in which the model is not valid: {}", names(&report.identifiability.untrusted_runs)));
    }
    lines.extend(report.rounds.iter().enumerate().map(|(k, round)| format!("round {}: {}", k + 1, round_text(round))));
    lines.extend(report.notes.iter().map(|note| format!("note: {note}")));
    lines
}

/// Noise floor, and the errors of every mounting against it.
fn errors(report: &Report, lines: &mut Vec<String>) {
    let row = |values: &[f64]| {
        let each = values.iter().map(|value| format!("{value:.3}")).collect::<Vec<_>>().join(" ");
        format!("{each} | mean {:.3}", mean(values))
    };
    let against = |raw: &[f64]| against_floor(report, raw).map_or(String::new(), |text| format!(", {text}"));
    if !report.noise_floor.is_empty() {
        lines.push(format!("noise floor [Nm]: {}", row(&report.noise_floor)));
    } else if !report.validate.is_empty() {
        lines.push("noise floor: unknown, because no motion of this data is periodic".to_string());
    }
    let filtered = band(report);
    let after = if filtered.is_empty() { String::new() } else { format!(" {filtered}") };
    let rms = report.identify.rms(&report.band);
    if !rms.is_empty() {
        let relative = if filtered.is_empty() { against(rms) } else { String::new() };
        lines.push(format!("RMS of the fit [Nm]{after}: {}{relative}", row(rms)));
    }
    for group in groups(report) {
        let (name, count) = (group.mounting, group.runs.len());
        let runs = if count == 1 { "run" } else { "runs" };
        let (rms, raw, served) = (group.per_joint(), group.raw(), group.served());
        let relative = if filtered.is_empty() { against(&raw) } else { String::new() };
        lines.push(format!("RMS {name} [Nm]{after}, {count} unseen {runs}: {}{relative}", row(&rms)));
        if !filtered.is_empty() && !raw.is_empty() {
            lines.push(format!("RMS {name} [Nm], raw samples: {}{}", row(&raw), against(&raw)));
        }
        if !served.is_empty() {
            lines.push(format!("RMS {name} [Nm], served feed-forward: {}{}", row(&served), against(&served)));
        }
    }
}

/// Errors of the vertical set in a mounting where it is not valid, in one sentence.
pub(super) fn counter(of: &CounterExperiment) -> String {
    let place = &of.refused_in.name;
    let change = |forced: f64, general: f64| (forced - general) / general.max(f64::MIN_POSITIVE);
    let (mut changed, mut most) = (Vec::new(), 0.0f64);
    let mut others = 0;
    for (j, (&forced, &general)) in of.forced_rms.iter().zip(&of.general_rms).enumerate() {
        let share = change(forced, general);
        if share.abs() > CHANGED {
            changed.push(format!("{forced:.3} Nm in joint {} (generalized set {general:.3})", j + 1));
        } else {
            most = most.max(share.abs());
            others += 1;
        }
    }
    let rest = format!("changes by at most {:.2} %", 100.0 * most);
    let outcome = match (changed.is_empty(), others) {
        (true, _) => format!("{rest} in any joint"),
        (false, 0) => format!("is {}", changed.join(", ")),
        (false, _) => format!("is {} and {rest} in the others", changed.join(", ")),
    };
    format!(
        "the vertical set ({} parameters, identified {}) is refused in mounting {place}; forced, its RMS there \
         {outcome}",
        of.count, of.identified_in.name
    )
}

/// Statistics of the loop. Simulated time has no late cycles.
pub(super) fn control_loop(of: &LoopReport) -> String {
    let degraded = (!of.refusals().is_empty()).then(|| "degraded".to_string());
    let mut parts: Vec<String> = degraded.into_iter().collect();
    parts.push(format!("{} cycles", of.cycles));
    parts.extend(of.late.map(|late| format!("{late} late")));
    parts.push(format!("{} lost", of.lost));
    if of.dropped_records > 0 {
        parts.push(format!("{} dropped records", of.dropped_records));
    }
    parts.push(of.allocations().map_or("allocations not watched".into(), |count| format!("{count} allocations")));
    if let Some(session) = of.longest() {
        for (what, times) in [("wake-up", session.statistics.wake_up), ("execution", session.statistics.execution)] {
            let three = |[p50, p99, _, max]: [f64; 4]| {
                format!("{what} p50 {} p99 {} max {} us", digits(p50), digits(p99), digits(max))
            };
            parts.extend(times.in_us().map(three));
        }
    }
    let pace = if of.is_fast() { "simulated time, as fast as possible" } else { "wall-clock" };
    format!("loop ({pace}): {}", parts.join(", "))
}

/// Counters of the states of an arm that another program controls.
pub(super) fn guest(of: &GuestCounts) -> String {
    let GuestCounts { received, lost, doubled, out_of_order, not_finite, malformed, other_joints, other_rate, .. } = of;
    let GuestCounts { late, pauses, publishers, .. } = of;
    let publishers = if *publishers == 1 { "1 publisher".to_string() } else { format!("{publishers} publishers") };
    format!(
        "listened to {publishers}, commanded nothing: {received} states received, {lost} lost, {late} late, {pauses} pauses, {doubled} doubled, \
         {out_of_order} out of order, {not_finite} not finite, {malformed} malformed, {other_joints} of another number of joints, {other_rate} at \
         another rate"
    )
}

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
