//! What the live view knows of a daemon: the last status and record, residuals, latencies, events.

use plumbline_core::{JointVec, Limits, Record, Validity};
use plumbline_ipc::{Progress, Status};
use plumbline_model::Robot;
use std::collections::VecDeque;
use std::time::Instant;

/// Lines of events that are kept.
const EVENTS: usize = 100;
/// Share of a new sample in the mean square of a residual: a time constant of half a second at 1 kHz.
const NEW_SHARE: f64 = 1.0 / 500.0;
/// Bins of latencies: a third of a decade each, from 1 us on.
pub const BINS: usize = 16;
const BINS_PER_DECADE: f64 = 3.0;

/// A daemon as the view shows it.
pub struct Watched {
    pub status: Option<Status>,
    /// Whether a daemon runs.
    pub runs: bool,
    pub last: Record,
    pub limits: Option<Limits>,
    /// Noise floor of the served model, per joint \[Nm\]; empty where it is not known.
    pub floor: Vec<f64>,
    /// Mean square of measured torque minus served torque, per joint \[Nm^2\].
    square: JointVec,
    /// Wake-up latencies; execution times of an arm without a deadline.
    pub latencies: [u64; BINS],
    pub events: VecDeque<String>,
    start: Instant,
}

impl Default for Watched {
    fn default() -> Watched {
        Watched {
            status: None,
            runs: true,
            last: Record::default(),
            limits: None,
            floor: Vec::new(),
            square: JointVec::default(),
            latencies: [0; BINS],
            events: VecDeque::new(),
            start: Instant::now(),
        }
    }
}

impl Watched {
    /// Adds an event with its time.
    pub fn note(&mut self, event: impl std::fmt::Display) {
        if self.events.len() == EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(format!("{:7.1} s  {event}", self.start.elapsed().as_secs_f64()));
    }

    /// The daemon does not answer any more.
    pub fn gone(&mut self) {
        if std::mem::replace(&mut self.runs, false) {
            self.note("the daemon has ended");
        }
    }

    /// Takes a status, and notes what has changed since the last one.
    pub fn status(&mut self, new: Status) {
        if !std::mem::replace(&mut self.runs, true) {
            self.note("a daemon runs again");
        }
        if self.limits.is_none() {
            self.limits = Robot::load(&new.robot, None).ok().map(|robot| robot.limits);
        }
        let Some(old) = self.status.replace(new.clone()) else { return };
        let mut changes: Vec<String> = Vec::new();
        if old.job != new.job || old.progress != new.progress {
            changes.push(format!("{}: {}", progress(new.progress), new.job));
        }
        if old.model != new.model {
            changes.push(format!("model {:016x} is served", new.model));
        }
        if old.stopped != new.stopped {
            changes.extend(new.stopped.as_ref().map(|why| format!("stopped: {why}")));
        }
        if old.doubt != new.doubt {
            changes.push(
                new.doubt.as_ref().map_or("the torque is trusted again".into(), |why| format!("doubtful: {why}")),
            );
        }
        if old.offered != new.offered {
            changes.extend(new.offered.as_ref().map(|offered| format!("proposed: {}", offered.proposal.what)));
        }
        if new.lost > old.lost {
            changes.push(format!("{} states lost", new.lost - old.lost));
        }
        changes.into_iter().for_each(|change| self.note(change));
    }

    pub fn record(&mut self, record: &Record) {
        let served = record.model != 0 && matches!(record.validity, Validity::Valid | Validity::Doubtful);
        for ((square, measured), served_torque) in
            self.square.iter_mut().zip(&record.state.tau).zip(&record.command.tau_ff.0)
        {
            let error = if served { measured - served_torque } else { 0.0 };
            *square += NEW_SHARE * (error * error - *square);
        }
        let ns = if record.wake_ns > 0 { record.wake_ns } else { record.work_ns };
        let bin = ((ns as f64 / 1e3).max(1.0).log10() * BINS_PER_DECADE) as usize;
        self.latencies[bin.min(BINS - 1)] += 1;
        self.last = *record;
    }

    /// RMS of measured minus served torque over the last half second \[Nm\].
    pub fn residual(&self, joint: usize) -> f64 {
        self.square[joint].sqrt()
    }

    pub fn joints(&self) -> usize {
        self.status.as_ref().map_or(0, |status| status.joints).min(self.last.state.q.len())
    }
}

/// The progress of a job in a word.
pub fn progress(progress: Progress) -> &'static str {
    match progress {
        Progress::Idle => "not started",
        Progress::Driving => "driving",
        Progress::AwaitingModel => "waits for a model",
        Progress::Done => "done",
        Progress::Stopped => "stopped",
    }
}

/// Lower end of a bin of latencies, as text.
pub fn bin_name(bin: usize) -> String {
    let us = 10f64.powf(bin as f64 / BINS_PER_DECADE);
    if us < 999.0 { format!("{us:.0}us") } else { format!("{:.0}ms", us / 1e3) }
}
