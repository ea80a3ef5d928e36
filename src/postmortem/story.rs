//! The facts of a recording, in order. Times are seconds before the end of the recording, by the arm's own counter.

use super::advice;
use super::replay::Replayed;
use super::timing::Timing;
use crate::recording::Recording;
use crate::recording::about::{Given, ReasonKind};
use crate::recording::messages::{limit_name, words};
use plumbline_core::{PERIOD, Phase, Record};
use plumbline_rt::{Event, Limit, StopReason, TimedEvent, Violation};
use serde::Serialize;

/// Most lines of the timeline and of the lists of outliers.
pub(super) const LINES: usize = 60;

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Story {
    /// The file.
    pub file: String,
    /// The robot and how it was mounted.
    pub robot: String,
    /// How the arm was mounted.
    pub mounting: String,
    /// Version of the program that recorded it.
    pub plumbline: String,
    /// When it was recorded, UTC.
    pub recorded: String,
    /// The job's file and the beginning of its hash.
    pub job: String,
    /// The model that served last, in hexadecimal.
    pub model: Option<String>,
    /// Why it was recorded, in one word.
    pub kind: ReasonKind,
    /// Why it was recorded, in one sentence.
    pub reason: String,
    /// How the loop ended, where it did.
    pub end: Option<String>,
    /// What the arm was doing when it happened.
    pub during: Option<String>,
    /// The first limit that was crossed.
    pub first_limit: Option<Crossing>,
    /// The last controlled stop.
    pub stop: Option<Stop>,
    /// What happened, oldest first.
    pub timeline: Vec<Line>,
    /// Distance from the command, per joint.
    pub tracking: Vec<Joint>,
    /// Measured torque, per joint.
    pub torque: Vec<Joint>,
    /// Cycles and their times.
    pub timing: Timing,
    /// What the operator does next.
    pub next: Vec<String>,
    /// What is missing in the recording.
    pub gaps: Vec<String>,
    /// The recording through the loop again, where that was asked for.
    pub replay: Option<Replayed>,
}

/// A limit that was crossed.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Crossing {
    /// Name of the limit.
    pub limit: String,
    /// Joint, from 1 (axis of the base frame for the box).
    pub joint: usize,
    /// What was found.
    pub value: f64,
    /// What it was held against.
    pub bound: f64,
    /// When \[s before the end\].
    pub before: f64,
    /// The cycle.
    pub cycle: u64,
    /// In words.
    pub text: String,
}

/// A controlled stop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stop {
    /// When it began \[s before the end\].
    pub before: f64,
    /// How long it took \[s\]; until the end of the recording where the arm did not come to rest.
    pub seconds: f64,
    /// Whether the arm came to rest by it.
    pub at_rest: bool,
    /// Highest speed when it began \[rad/s\] and the joint, from 1.
    pub speed: (f64, usize),
    /// Longest way on the stop \[rad\] and the joint, from 1.
    pub travelled: (f64, usize),
}

/// Something that happened.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Line {
    /// When \[s before the end\].
    pub before: f64,
    /// The cycle.
    pub cycle: u64,
    /// What the arm was doing.
    pub phase: String,
    /// What happened.
    pub text: String,
    /// `plain`, `warn` or `bad`.
    pub weight: &'static str,
}

/// The worst of one joint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Joint {
    /// From 1.
    pub joint: usize,
    /// The largest value, without a sign \[rad\] or \[Nm\].
    pub worst: f64,
    /// When \[s before the end\].
    pub before: f64,
    /// The limit.
    pub limit: f64,
    /// Share of the limit.
    pub share: f64,
}

/// Name of a phase, for people.
pub fn phase_name(phase: Phase) -> &'static str {
    match phase {
        Phase::Hold => "hold",
        Phase::Approach => "approach",
        Phase::Excite => "excitation",
        Phase::Return => "return",
        Phase::Stop => "stop",
        Phase::Stopped => "stopped",
    }
}

/// Clock of a story: seconds before its end by the arm's counter.
pub(super) struct Before {
    last: u64,
}

impl Before {
    pub fn of(recording: &Recording) -> Before {
        let newest = recording.records.last().map_or(0, |record| record.state.seq);
        let unanswered = recording.unanswered.as_ref().map_or(0, |record| record.state.seq);
        let told = recording.events.iter().map(|told| told.seq).max().unwrap_or(0);
        Before { last: newest.max(unanswered).max(told) }
    }

    pub fn at(&self, seq: u64) -> f64 {
        self.last.saturating_sub(seq) as f64 * PERIOD
    }
}

impl Story {
    /// Of a recording in `file`.
    pub fn of(file: &str, recording: &Recording, replay: Option<Replayed>) -> Story {
        let about = &recording.about;
        let before = Before::of(recording);
        let first_limit = first_limit(recording, &before);
        let stop = stop(recording, &before);
        let timing = Timing::of(recording, &before);
        let short: String = about.job_sha256.chars().take(12).collect();
        let mut story = Story {
            file: file.to_string(),
            robot: if about.id == about.robot {
                about.robot.clone()
            } else {
                format!("{} ({})", about.robot, about.id)
            },
            mounting: about.mounting.clone(),
            plumbline: about.plumbline.clone(),
            recorded: about.recorded.clone(),
            job: format!("{} (SHA-256 {short}...)", about.job),
            model: recording.records.iter().rev().map(|r| r.model).find(|&id| id != 0).map(|id| format!("{id:016x}")),
            kind: about.reason.kind,
            reason: about.reason.text.clone(),
            end: about.end.clone(),
            during: during(recording),
            timeline: timeline(recording, &before),
            tracking: tracking(recording, &before),
            torque: torque(recording, &before),
            gaps: gaps(recording),
            next: Vec::new(),
            first_limit,
            stop,
            timing,
            replay,
        };
        story.next = advice::next(&story, about);
        story
    }

    /// The one sentence that says what happened.
    pub fn headline(&self) -> String {
        let during = self.during.as_ref().map_or(String::new(), |during| format!(", during {during}"));
        let happened = match self.kind {
            ReasonKind::Guard => "The guard stopped the arm",
            ReasonKind::LostStates => "The arm was stopped because states were lost",
            ReasonKind::Requested => "A stop was requested",
            ReasonKind::HeartbeatLost => "The arm was stopped because the supervisor's heartbeat timed out",
            ReasonKind::NotRealTime => "The loop did not begin, for the machine is not real-time",
            ReasonKind::Mounting => "The arm was stopped because its mounting was in doubt",
            ReasonKind::EstimatorLost => "The arm was stopped because the estimator was lost",
            ReasonKind::NotAtStart | ReasonKind::NoPath => "A motion could not begin",
            ReasonKind::Reflex => "The arm stopped by itself",
            ReasonKind::Refused => "The arm refused a command",
            ReasonKind::Disconnected => "The connection to the arm was lost",
            ReasonKind::Silent => "No state came from the arm in time",
            ReasonKind::Panic => "The loop's thread panicked",
            ReasonKind::Unsafe | ReasonKind::NoBrake => {
                "No controlled stop was possible: the arm was stopped by its own means"
            }
            ReasonKind::Clock => "The arm's counter did not go forward",
            ReasonKind::Signal => "A signal ended the program, and the arm was stopped",
            ReasonKind::ParentEnded => "The program that had started the daemon ended, and the arm was stopped",
            ReasonKind::OnDemand => "A recording was requested",
            ReasonKind::ModelTimeout => "The arm was stopped because no model came in time",
            ReasonKind::Unknown => return format!("{}{during}", self.reason),
        };
        format!("{happened}{during}")
    }
}

/// Motion and phase in which it happened.
fn during(recording: &Recording) -> Option<String> {
    let braking = |record: &&Record| matches!(record.phase, Phase::Stop | Phase::Stopped);
    let moving = recording.records.iter().rev().find(|record| !braking(record))?;
    if moving.phase == Phase::Hold {
        return Some("a rest".to_string());
    }
    let names = &recording.about.motions;
    let own = names.iter().find(|(number, _)| *number == moving.motion).map(|(_, name)| name.clone());
    // Approaches carry a number beyond those of the motions that they lead to.
    let to = names.iter().find(|(number, _)| moving.motion.checked_sub(1 << 16) == Some(*number));
    let name = own.or(to.map(|(_, name)| format!("the way to {name}")));
    Some(match (moving.phase, name) {
        (Phase::Return, _) => "the way back".to_string(),
        (phase, Some(name)) => format!("{name} ({:.3} s into its {})", moving.tick as f64 * PERIOD, phase_name(phase)),
        (phase, None) => format!("motion {} ({})", moving.motion, phase_name(phase)),
    })
}

fn first_limit(recording: &Recording, before: &Before) -> Option<Crossing> {
    // Of the stop that this is about: one that an operator has lifted is another story.
    let of_a_stop = |told: &&TimedEvent| matches!(told.event, Event::Stopping { .. } | Event::Resumed);
    let told = recording.events.iter().rfind(of_a_stop)?;
    let Event::Stopping { reason: StopReason::Guard(violation), .. } = told.event else { return None };
    let Violation { limit, joint, value, bound } = violation;
    Some(Crossing {
        limit: limit_name(limit).to_string(),
        joint: joint + 1,
        value,
        bound,
        before: before.at(told.seq),
        cycle: told.cycle,
        text: violation.to_string(),
    })
}

fn stop(recording: &Recording, before: &Before) -> Option<Stop> {
    let began = recording.events.iter().rfind(|told| matches!(told.event, Event::Stopping { .. }))?;
    let rest = recording.events.iter().find(|told| told.event == Event::Stopped && told.cycle >= began.cycle);
    let records = &recording.records;
    let last = rest.map_or_else(|| records.last().map_or(began.seq, |last| last.state.seq), |told| told.seq);
    let within: Vec<&Record> =
        records.iter().filter(|r| r.cycle.saturating_add(1) >= began.cycle && r.state.seq <= last).collect();
    let joints = recording.about.joints;
    let (mut speed, mut travelled) = ((0.0, 1), (0.0, 1));
    if let (Some(first), Some(end)) = (within.first(), within.last()) {
        for j in 0..joints {
            let (dq, way) = (first.command.desired.dq[j].abs(), (end.state.q[j] - first.state.q[j]).abs());
            if dq > speed.0 {
                speed = (dq, j + 1);
            }
            if way > travelled.0 {
                travelled = (way, j + 1);
            }
        }
    }
    let seconds = last.saturating_sub(began.seq) as f64 * PERIOD;
    Some(Stop { before: before.at(began.seq), seconds, at_rest: rest.is_some(), speed, travelled })
}

fn timeline(recording: &Recording, before: &Before) -> Vec<Line> {
    let phase_at = |cycle: u64| {
        let place = recording.records.partition_point(|record| record.cycle < cycle);
        let record = recording.records.get(place).or(recording.records.last());
        record.map_or(String::new(), |record| phase_name(record.phase).to_string())
    };
    let name = |text: String| {
        let mut text = text;
        for (number, name) in &recording.about.motions {
            for (from, to) in [
                (format!("motion {number} has"), format!("{name} has")),
                (format!("motion {} has", number.saturating_add(1 << 16)), format!("the way to {name} has")),
            ] {
                text = text.replace(&from, &to);
            }
        }
        text.replace(&format!("motion {} has", 1 << 17), "the way back has")
    };
    let mut lines: Vec<Line> = Vec::new();
    if let Some(first) = recording.records.first() {
        let text = "the recording begins".to_string();
        let phase = phase_name(first.phase).to_string();
        lines.push(Line { before: before.at(first.state.seq), cycle: first.cycle, phase, text, weight: "plain" });
    }
    for told in &recording.events {
        let weight = match told.event {
            Event::Stopping { reason: StopReason::Requested | StopReason::Quit, .. } => "warn",
            Event::Stopping { .. } | Event::Distrusted { .. } => "bad",
            Event::Stopped | Event::Resumed => "warn",
            Event::Discarded { .. } => continue,
            _ => "plain",
        };
        let resting = matches!(told.event, Event::Started { .. } | Event::Ended { .. })
            && matches!(recording.about.orders.get(told.orders.saturating_sub(1) as usize), Some(Given::Dwell { .. }));
        let text = name(words(&told.event));
        let text = if resting { text.replace("the way to ", "the rest before ") } else { text };
        lines.push(Line { before: before.at(told.seq), cycle: told.cycle, phase: phase_at(told.cycle), text, weight });
    }
    for note in &recording.about.notes {
        let place = recording.records.partition_point(|record| record.state.seq < note.seq);
        let cycle = recording.records.get(place).map_or(0, |record| record.cycle);
        let text = note.text.clone();
        lines.push(Line { before: before.at(note.seq), cycle, phase: phase_at(cycle), text, weight: "warn" });
    }
    lines.sort_by(|a, b| b.before.total_cmp(&a.before));
    if let Some(end) = recording.about.end.as_ref().filter(|_| !recording.records.is_empty()) {
        let cycle = recording.unanswered.as_ref().or(recording.records.last()).map_or(0, |record| record.cycle);
        // In the backend's own words where it has any.
        let text = if recording.about.reason.text.contains(end.as_str()) { &recording.about.reason.text } else { end };
        let text = format!("the loop ended: {text}");
        lines.push(Line { before: 0.0, cycle, phase: phase_at(cycle), text, weight: "bad" });
    }
    if lines.len() > LINES {
        let surplus = lines.len() - LINES;
        lines.drain(1..=surplus);
        if let Some(first) = lines.first_mut() {
            first.text = format!("the recording begins; {surplus} earlier events are left out here");
        }
    }
    lines
}

/// The largest of a value over the records, per joint.
fn worst(
    recording: &Recording,
    before: &Before,
    limit: impl Fn(usize) -> f64,
    value: impl Fn(&Record, &Record, usize) -> f64,
) -> Vec<Joint> {
    let one = |j: usize| {
        let (mut worst, mut seq) = (0.0_f64, 0);
        for pair in recording.records.windows(2).filter(|pair| pair[1].cycle == pair[0].cycle + 1) {
            let found = value(&pair[0], &pair[1], j).abs();
            if found > worst || found.is_nan() {
                (worst, seq) = (found, pair[1].state.seq);
            }
        }
        let limit = limit(j);
        Joint { joint: j + 1, worst, before: before.at(seq), limit, share: worst / limit }
    };
    (0..recording.about.joints).map(one).collect()
}

/// Distance of the measured position from the position sent last, as the guard takes it.
pub(super) fn tracking_error(earlier: &Record, later: &Record, j: usize) -> f64 {
    later.state.q[j] - earlier.command.desired.q[j]
}

fn tracking(recording: &Recording, before: &Before) -> Vec<Joint> {
    let tolerance = recording.about.settings.tracking();
    worst(recording, before, |j| tolerance[j], tracking_error)
}

fn torque(recording: &Recording, before: &Before) -> Vec<Joint> {
    let limits = recording.about.settings.limits();
    worst(recording, before, |j| limits.tau[j], |_, record, j| record.state.tau[j])
}

fn gaps(recording: &Recording) -> Vec<String> {
    let mut gaps = Vec::new();
    if let Some(cut) = &recording.cut {
        gaps.push(format!("The file is damaged or was cut short ({cut}); what is before that is told here."));
    }
    for pair in recording.records.windows(2) {
        let missing = pair[1].cycle.saturating_sub(pair[0].cycle).saturating_sub(1);
        if missing > 0 && gaps.len() < LINES {
            gaps.push(format!("Cycles {} to {} never reached the recorder.", pair[0].cycle + 1, pair[1].cycle - 1));
        }
    }
    if recording.about.dropped_events > 0 {
        gaps.push(format!("{} events never left the loop.", recording.about.dropped_events));
    }
    if recording.records.is_empty() {
        gaps.push("There is no cycle in it.".to_string());
    }
    gaps
}

/// Whether a limit is one of the measured state.
pub(super) fn is_measured(limit: &str) -> bool {
    [Limit::Tracking, Limit::MeasuredTorque, Limit::MeasuredNotFinite].iter().any(|one| limit_name(*one) == limit)
}
