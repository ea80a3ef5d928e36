//! Facts of a recording. Times are seconds before its end, from the arm's sequence numbers.

use super::replay::ReplayResult;
use super::timing::{MAX_LINES, TimeBase, Timing};
use crate::recording::Recording;
use crate::recording::about::{ReasonKind, RecordedOrder};
use crate::recording::messages::{event_text_with, limit_name};
use plumbline_core::{PERIOD_S, Phase, Record};
use plumbline_rt::{Event, StopReason, TimedEvent, Violation};
use serde::Serialize;

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Facts {
    pub file: String,
    pub robot: String,
    pub mounting: String,
    pub plumbline: String,
    /// When it was recorded, UTC.
    pub recorded: String,
    pub job: String,
    /// Last served model, in hexadecimal.
    pub model: Option<String>,
    pub kind: ReasonKind,
    pub reason: String,
    pub end: Option<String>,
    pub during: Option<String>,
    pub first_limit: Option<LimitViolation>,
    pub stop: Option<Stop>,
    /// Events, oldest first.
    pub timeline: Vec<TimelineEntry>,
    pub tracking: Vec<JointPeak>,
    pub torque: Vec<JointPeak>,
    pub timing: Timing,
    pub next: Vec<String>,
    pub gaps: Vec<String>,
    pub replay: Option<ReplayResult>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LimitViolation {
    pub limit: String,
    /// Joint, from 1 (axis of the base frame for the box).
    pub joint: usize,
    pub value: f64,
    pub bound: f64,
    /// Time \[s before the end\].
    pub before: f64,
    pub cycle: u64,
    pub text: String,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stop {
    /// Start \[s before the end\].
    pub before: f64,
    /// Duration, up to the end of the recording if the arm did not come to rest \[s\].
    pub seconds: f64,
    pub at_rest: bool,
    /// Highest speed at the start \[rad/s\] and its joint, from 1.
    pub speed: (f64, usize),
    /// Longest travel during the stop \[rad\] and its joint, from 1.
    pub travelled: (f64, usize),
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TimelineEntry {
    /// Time \[s before the end\].
    pub before: f64,
    pub cycle: u64,
    pub phase: String,
    pub text: String,
    pub weight: Weight,
}

/// How much an entry of the timeline matters.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weight {
    Plain,
    Warn,
    /// A limit, a fault or a lost connection.
    Bad,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointPeak {
    /// Joint, from 1.
    pub joint: usize,
    /// Largest absolute value \[rad\] or \[Nm\].
    pub worst: f64,
    /// Time \[s before the end\].
    pub before: f64,
    pub limit: f64,
    pub share: f64,
}

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

impl Facts {
    pub(super) fn without_advice(file: &str, recording: &Recording, replay: Option<ReplayResult>) -> Facts {
        let about = &recording.about;
        let time = TimeBase::of(recording);
        let first_limit = first_limit(recording, &time);
        let stop = stop(recording, &time);
        let timing = Timing::of(recording, &time);
        let short: String = about.job_sha256.chars().take(12).collect();
        Facts {
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
            timeline: timeline(recording, &time),
            tracking: tracking(recording, &time),
            torque: torque(recording, &time),
            gaps: gaps(recording),
            next: Vec::new(),
            first_limit,
            stop,
            timing,
            replay,
        }
    }

    pub fn headline(&self) -> String {
        let during = self.during.as_ref().map_or(String::new(), |during| format!(", during {during}"));
        let happened = match self.kind {
            ReasonKind::Guard => "The guard stopped the arm",
            ReasonKind::LostStates => "The arm was stopped because states were lost",
            ReasonKind::Requested => "The arm was stopped on request",
            ReasonKind::HeartbeatLost => "The arm was stopped because the supervisor's heartbeat timed out",
            ReasonKind::NotRealTime => "The loop did not start because the computer is not real-time",
            ReasonKind::Mounting => "The arm was stopped because the mounting check failed",
            ReasonKind::EstimatorLost => "The arm was stopped because the estimator was lost",
            ReasonKind::NotAtStart | ReasonKind::NoPath => "A motion could not begin",
            ReasonKind::Reflex => "The arm stopped by itself",
            ReasonKind::Refused => "The arm refused a command",
            ReasonKind::Disconnected => "The connection to the arm was lost",
            ReasonKind::Silent => "The arm sent no more states",
            ReasonKind::Panic => "The loop's thread panicked",
            ReasonKind::Unsafe | ReasonKind::NoBrake => "No controlled stop was possible: the arm stopped itself",
            ReasonKind::Clock => "The arm's sequence number did not increase",
            ReasonKind::Signal => "A signal ended the program, and the arm was stopped",
            ReasonKind::ParentEnded => "The program that had started the daemon ended, and the arm was stopped",
            ReasonKind::OnDemand => "A recording was requested",
            ReasonKind::ModelTimeout => "The arm was stopped because no model came in time",
            ReasonKind::Unknown => return format!("{}{during}", self.reason),
        };
        format!("{happened}{during}")
    }
}

fn during(recording: &Recording) -> Option<String> {
    let braking = |record: &&Record| matches!(record.phase, Phase::Stop | Phase::Stopped);
    let moving = recording.records.iter().rev().find(|record| !braking(record))?;
    if moving.phase == Phase::Hold {
        return Some("a rest".to_string());
    }
    let name = recording.about.order_name(moving.motion, false);
    Some(match moving.phase {
        Phase::Return => "the way back".to_string(),
        phase => format!("{name} ({:.3} s into its {})", moving.tick as f64 * PERIOD_S, phase_name(phase)),
    })
}

fn first_limit(recording: &Recording, time: &TimeBase) -> Option<LimitViolation> {
    // Only the last stop counts, and only if no resume followed it.
    let of_a_stop = |timed: &&TimedEvent| matches!(timed.event, Event::Stopping { .. } | Event::Resumed);
    let timed = recording.events.iter().rfind(of_a_stop)?;
    let Event::Stopping { reason: StopReason::Guard(violation), .. } = timed.event else { return None };
    let Violation { limit, joint, value, bound } = violation;
    Some(LimitViolation {
        limit: limit_name(limit).to_string(),
        joint: joint + 1,
        value,
        bound,
        before: time.before_end(timed.seq),
        cycle: timed.cycle,
        text: violation.to_string(),
    })
}

fn stop(recording: &Recording, time: &TimeBase) -> Option<Stop> {
    let began = recording.events.iter().rfind(|timed| matches!(timed.event, Event::Stopping { .. }))?;
    let rest = recording.events.iter().find(|timed| timed.event == Event::Stopped && timed.cycle >= began.cycle);
    let records = &recording.records;
    let last = rest.map_or_else(|| records.last().map_or(began.seq, |last| last.state.seq), |timed| timed.seq);
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
    let seconds = last.saturating_sub(began.seq) as f64 * PERIOD_S;
    Some(Stop { before: time.before_end(began.seq), seconds, at_rest: rest.is_some(), speed, travelled })
}

fn timeline(recording: &Recording, time: &TimeBase) -> Vec<TimelineEntry> {
    let phase_at = |cycle: u64| {
        let place = recording.records.partition_point(|record| record.cycle < cycle);
        let record = recording.records.get(place).or(recording.records.last());
        record.map_or(String::new(), |record| phase_name(record.phase).to_string())
    };
    let mut lines: Vec<TimelineEntry> = Vec::new();
    if let Some(first) = recording.records.first() {
        let text = "the recording begins".to_string();
        let phase = phase_name(first.phase).to_string();
        lines.push(TimelineEntry {
            before: time.before_end(first.state.seq),
            cycle: first.cycle,
            phase,
            text,
            weight: Weight::Plain,
        });
    }
    for timed in &recording.events {
        let weight = match timed.event {
            Event::Stopping { reason: StopReason::Requested | StopReason::Quit, .. } => Weight::Warn,
            Event::Stopping { .. } | Event::Distrusted { .. } => Weight::Bad,
            Event::Stopped | Event::Resumed => Weight::Warn,
            Event::Discarded { .. } => continue,
            _ => Weight::Plain,
        };
        let resting = matches!(timed.event, Event::Started { .. } | Event::Ended { .. })
            && matches!(
                recording.about.orders.get(timed.orders.saturating_sub(1) as usize),
                Some(RecordedOrder::Dwell { .. })
            );
        let text = event_text_with(&timed.event, &|number| recording.about.order_name(number, resting));
        lines.push(TimelineEntry {
            before: time.before_end(timed.seq),
            cycle: timed.cycle,
            phase: phase_at(timed.cycle),
            text,
            weight,
        });
    }
    for note in &recording.about.notes {
        let place = recording.records.partition_point(|record| record.state.seq < note.seq);
        let cycle = recording.records.get(place).map_or(0, |record| record.cycle);
        let text = note.text.clone();
        lines.push(TimelineEntry {
            before: time.before_end(note.seq),
            cycle,
            phase: phase_at(cycle),
            text,
            weight: Weight::Warn,
        });
    }
    lines.sort_by(|a, b| b.before.total_cmp(&a.before));
    if let Some(end) = recording.about.end.as_ref().filter(|_| !recording.records.is_empty()) {
        let cycle = recording.unanswered.as_ref().or(recording.records.last()).map_or(0, |record| record.cycle);
        // The backend's description, if there is one.
        let text = if recording.about.reason.text.contains(end.as_str()) { &recording.about.reason.text } else { end };
        let text = format!("the loop ended: {text}");
        lines.push(TimelineEntry { before: 0.0, cycle, phase: phase_at(cycle), text, weight: Weight::Bad });
    }
    if lines.len() > MAX_LINES {
        let surplus = lines.len() - MAX_LINES;
        lines.drain(1..=surplus);
        if let Some(first) = lines.first_mut() {
            first.text = format!("the recording begins; {surplus} earlier events are left out here");
        }
    }
    lines
}

/// Peak of a value over the records, per joint.
fn worst(
    recording: &Recording,
    time: &TimeBase,
    limit: impl Fn(usize) -> f64,
    value: impl Fn(&Record, &Record, usize) -> f64,
) -> Vec<JointPeak> {
    let one = |j: usize| {
        let (mut worst, mut seq) = (0.0_f64, 0);
        for pair in recording.records.windows(2).filter(|pair| pair[1].cycle == pair[0].cycle + 1) {
            let found = value(&pair[0], &pair[1], j).abs();
            if found > worst || found.is_nan() {
                (worst, seq) = (found, pair[1].state.seq);
            }
        }
        let limit = limit(j);
        JointPeak { joint: j + 1, worst, before: time.before_end(seq), limit, share: worst / limit }
    };
    (0..recording.about.joints).map(one).collect()
}

/// Tracking error as in the guard: measured position minus previous command.
pub(super) fn tracking_error(earlier: &Record, later: &Record, j: usize) -> f64 {
    later.state.q[j] - earlier.command.desired.q[j]
}

fn tracking(recording: &Recording, time: &TimeBase) -> Vec<JointPeak> {
    let tolerance = recording.about.settings.tracking();
    worst(recording, time, |j| tolerance[j], tracking_error)
}

fn torque(recording: &Recording, time: &TimeBase) -> Vec<JointPeak> {
    let limits = recording.about.settings.limits();
    worst(recording, time, |j| limits.tau[j], |_, record, j| record.state.tau[j])
}

fn gaps(recording: &Recording) -> Vec<String> {
    let mut gaps = Vec::new();
    if let Some(cut) = &recording.cut {
        gaps.push(format!("The file is damaged or was cut short ({cut}); the part before that is shown."));
    }
    for pair in recording.records.windows(2) {
        let missing = pair[1].cycle.saturating_sub(pair[0].cycle).saturating_sub(1);
        if missing > 0 && gaps.len() < MAX_LINES {
            gaps.push(format!("Cycles {} to {} are missing.", pair[0].cycle + 1, pair[1].cycle - 1));
        }
    }
    if recording.about.dropped_events > 0 {
        gaps.push(format!("{} events were dropped by the loop.", recording.about.dropped_events));
    }
    if recording.records.is_empty() {
        gaps.push("The recording contains no cycle.".to_string());
    }
    gaps
}
