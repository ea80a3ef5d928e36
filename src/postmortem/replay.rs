//! Replay of a recording: the same states, orders and models in the same cycles must give bitwise the same commands.
//!
//! The loop is the production loop with its guard and its planner. It starts at its first cycle if that is recorded, else from a
//! [`Checkpoint`](plumbline_rt::Checkpoint). [`Playback`] replaces the arm. It returns the recorded states and, in the same read, puts
//! the recorded inputs of that cycle into the loop's rings. Requests from outside (stop, resume) are repeated. The loop's own decisions
//! (guard stops, lost states) have to come out of the loop again.
//!
//! Limits: the same program on the same kind of processor is needed, because `sin` differs between platforms. A model with memory
//! (hysteresis, delay) starts without it, so its torque may differ at first.

mod compare;
mod schedule;

use crate::recording::Recording;
use crate::recording::about::{LogClock, RecordedModel, panic_message, panicked};
use compare::{compare, same_events};
use plumbline_core::{Backend, Command, Fault, FeedForward, Kinematics, Record, Sink, State};
use plumbline_rt::cycle::{Cycle, End};
use plumbline_rt::{Handles, TimedEvent, cycle};
use schedule::{InputSchedule, StartPoint};
use serde::Serialize;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};

/// Reason why a recording can't be replayed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReplayError {
    #[error("only {cycles} cycles without a gap, and a replay needs {needed}")]
    TooShort { cycles: usize, needed: usize },
    #[error("{count} events were dropped by the loop, so its inputs are not known")]
    DroppedEvents { count: u64 },
    #[error("{what} is not in the recording")]
    Missing { what: String },
    #[error("{what}: {why}")]
    Unusable { what: String, why: String },
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReplayResult {
    pub first: u64,
    pub compared: u64,
    /// Whether the replay began at the start of the loop.
    pub from_the_start: bool,
    /// Number of cycles with another commanded motion, phase, validity or model.
    pub different: u64,
    pub first_difference: Option<String>,
    pub torque_different: u64,
    pub last_torque_difference: Option<u64>,
    pub same_events: bool,
    /// End of the replayed loop, if the recording contains the state that ended the loop.
    pub end: Option<String>,
    pub same_end: Option<bool>,
}

impl ReplayResult {
    /// Whether commands, events and end are the recorded ones, bitwise.
    pub fn is_identical(&self) -> bool {
        self.different == 0 && self.torque_different == 0 && self.same_events && self.same_end != Some(false)
    }
}

/// A model ready to serve, or the reason why there is none.
pub type BuildResult = Result<Box<dyn FeedForward>, String>;

pub struct ReplayInputs<'p> {
    /// Kinematics for the guard's workspace check.
    pub kinematics: Option<Box<dyn Kinematics>>,
    pub model: &'p mut dyn FnMut(&RecordedModel) -> BuildResult,
}

/// Replays the recording.
pub fn replay(recording: &Recording, inputs: ReplayInputs) -> Result<ReplayResult, ReplayError> {
    let about = &recording.about;
    if about.dropped_events > 0 {
        return Err(ReplayError::DroppedEvents { count: about.dropped_events });
    }
    let start = StartPoint::find(recording, inputs.model)?;
    let schedule = InputSchedule::plan(recording, &start, inputs.model)?;
    let records = &recording.records[start.at..];
    let settings = about.settings.for_replay(about.orders.len() + about.models.len() + 16);
    let shared: Shared = Arc::default();
    let unanswered = recording
        .unanswered
        .filter(|one| records.last().is_none_or(|last| last.cycle.checked_add(1) == Some(one.cycle)));
    let playback = Playback {
        joints: about.joints,
        states: records.iter().chain(&unanswered).map(|record| (record.cycle, record.state)).collect(),
        next: 0,
        schedule,
        shared: Arc::clone(&shared),
    };
    let records_again: Arc<Mutex<Vec<Record>>> = Arc::new(Mutex::new(Vec::with_capacity(records.len() + 2)));
    let kinematics = inputs.kinematics.filter(|_| settings.guard.workspace.is_some());
    let unusable = |what: &str, why: &dyn ToString| ReplayError::Unusable { what: what.into(), why: why.to_string() };
    let (mut again, handles) = cycle::new(playback, RecordSink(Arc::clone(&records_again)), kinematics, settings)
        .map_err(|error| unusable("the loop's settings", &error))?;
    *lock(&shared) = Some(handles);
    let from_the_start = start.checkpoint.is_none();
    if let Some(checkpoint) = start.checkpoint {
        again.restore(checkpoint).map_err(|error| unusable("the motion under way", &error))?;
    }
    // A loop that panicked panics again.
    let end = catch_unwind(AssertUnwindSafe(|| Cycle::run(&mut again)))
        .map(|outcome| outcome.end)
        .map_err(|panic| panicked(&panic_message(&*panic)));
    drop(again);
    let mut handles = lock(&shared).take().ok_or_else(|| ReplayError::Missing { what: "the loop's end".into() })?;
    let timed: Vec<TimedEvent> = std::iter::from_fn(|| handles.events.pop().ok()).collect();
    handles.free_retired();
    let records_again = std::mem::take(&mut *lock(&records_again));
    let mut result = compare(records, &records_again, from_the_start);
    result.same_events = same_events(recording, &timed, result.first);
    if unanswered.is_some() {
        let text = end.as_ref().map_or_else(String::clone, End::to_string);
        // A fault of the arm is not an output of the loop and is not compared.
        result.same_end = about.end.as_ref().filter(|_| !matches!(end, Ok(End::Fault(_)))).map(|end| *end == text);
        result.end = Some(text);
    }
    Ok(result)
}

type Shared = Arc<Mutex<Option<Handles>>>;

fn lock<T>(shared: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A backend that returns the recorded states without waiting.
pub struct Playback {
    joints: usize,
    states: Vec<(u64, State)>,
    next: usize,
    schedule: InputSchedule,
    shared: Shared,
}

impl Backend for Playback {
    fn joints(&self) -> usize {
        self.joints
    }

    /// The next state; [`Fault::Disconnected`] after the last.
    fn read(&mut self) -> Result<State, Fault> {
        let (cycle, state) = self.states.get(self.next).copied().ok_or(Fault::Disconnected)?;
        self.next += 1;
        if let Some(handles) = lock(&self.shared).as_mut() {
            self.schedule.apply(cycle, handles);
        }
        Ok(state)
    }

    fn write(&mut self, _: &Command) -> Result<(), Fault> {
        Ok(())
    }

    fn stop(&mut self) {}
}

/// Keeps every record; the room was made before.
struct RecordSink(Arc<Mutex<Vec<Record>>>);

impl Sink for RecordSink {
    fn put(&mut self, record: &Record) -> bool {
        let mut records_again = lock(&self.0);
        let room = records_again.len() < records_again.capacity();
        if room {
            records_again.push(*record);
        }
        room
    }
}

pub fn is_simulated(recording: &Recording) -> bool {
    matches!(recording.about.clock, LogClock::Arm { .. })
}
