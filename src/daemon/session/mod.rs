//! One connection to the arm: the loop on a thread of its own, and its bridge to shared memory.

mod open;
mod thread;

pub use thread::stop_listener_rights;

use super::Daemon;
use super::gravity::Verdict;
use super::labels::GravityLabels;
use super::recorder::{LoopEnd, LoopRecorder};
use super::schedule::RecordSchedule;
use super::script::{Next, Planned, Script};
use super::state::DaemonState;
use crate::failure::Failure;
use crate::process::service;
use crate::recording::about::{Reason, ReasonKind, RecordedModel};
use nalgebra::Vector3;
use plumbline_core::{ArmMonitor, Histogram, Phase, Purpose, Record, TimeGate};
use plumbline_ipc::{FeedForwardMessage, Progress, Session as SessionStatistics, now_ns};
use plumbline_model::{Mounting, NoModel, ServedModel};
use plumbline_rt::cycle::{End, Outcome};
use plumbline_rt::recorder::Drain;
use plumbline_rt::{Event, Handles, TimedEvent, os};
use std::collections::VecDeque;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;
use thread::{await_end, catch_panic};

/// Records between the loop and the bridge thread: eight seconds at 1 kHz.
const RING: usize = 8192;
/// Records taken from the ring at once.
const DRAIN: usize = 512;
/// Pause of the bridge thread when there is nothing to do.
const PAUSE: Duration = Duration::from_micros(200);
/// Simulated time that a loop rests for a model. The loop has run on for a part of it, for as long as this thread took to notice: all that it may
/// run ahead \[ms\].
const REST_FOR_MODEL: u64 = (RING / 2 + 2 * DRAIN) as u64;
/// Records that simulated time may run ahead of an estimator that watches it: two seconds.
const MAX_AHEAD_OF_WATCH: u64 = 2000;

pub struct Session {
    name: String,
    mounting: Mounting,
    handles: Handles,
    drain: Drain,
    /// Pauses simulated time; `None` where the arm keeps wall-clock time.
    gate: Option<Arc<dyn TimeGate>>,
    monitor: Option<Box<dyn ArmMonitor>>,
    thread: Option<JoinHandle<LoopEnd>>,
    tape: LoopRecorder,
    script: Script,
    purpose: Purpose,
    /// Identity of the model handed to this loop, 0 for none.
    model: u64,
    /// The rights granted to the loop's thread were logged.
    rights_reported: bool,
    records_due: RecordSchedule,
    /// Gravity that the model was handed over with \[m/s2\].
    gravity: Vector3<f64>,
    /// Gravity that the arm's own controller compensates \[m/s2\].
    vendor: Vector3<f64>,
    /// Gravity of the records on their way from the loop.
    labels: GravityLabels,
    /// Events taken from the loop and not handled yet.
    events: VecDeque<TimedEvent>,
    paused: bool,
    /// Number of the newest record's cycle.
    newest: u64,
    /// The cycle in which the last motion before a model ended, of an arm whose simulated time is paused since.
    parked: Option<u64>,
    /// When the wait for a model ends, while the arm holds for one \[ns\].
    model_due_ns: Option<u64>,
    /// From state read to shared memory \[ns\].
    bridged: Histogram,
    records: Vec<Record>,
}

impl Session {
    /// Bridges until the loop ends.
    ///
    /// A panic on this thread would end the process, and the loop with it in mid-motion: the loop is ended first.
    pub fn run(mut self, daemon: &mut Daemon) -> Result<(SessionStatistics, End), Failure> {
        let controls = Arc::clone(&self.handles.controls);
        match catch_panic(&controls, || self.bridge_until_end(daemon)) {
            Ok(ended) => ended,
            Err(message) => self.end_after_panic(&message),
        }
    }

    fn bridge_until_end(&mut self, daemon: &mut Daemon) -> Result<(SessionStatistics, End), Failure> {
        daemon.state.mounting = self.mounting;
        while !self.thread.as_ref().is_none_or(JoinHandle::is_finished) {
            daemon.take_stop(Some(&self.handles.controls));
            let busy = self.bridge(daemon);
            self.report_rights(&mut daemon.state);
            self.handle_events(&mut daemon.state);
            daemon.state.poll_gravity(now_ns(), self.model != 0);
            self.unpark_stopped(&daemon.state);
            self.hand_over_model(&mut daemon.state);
            daemon.publish_model(self.model, self.gravity.into(), self.vendor.into());
            self.give_orders(&daemon.state);
            self.check_model_timeout(&mut daemon.state);
            self.keep_pace_with_watch(daemon);
            self.report_mode();
            self.answer_requests(daemon);
            daemon.service.beat(self.progress());
            if daemon.state.must_leave() {
                // Before the loop ends: the stop's event and recording carry the reason.
                daemon.state.announce_end();
                self.handles.controls.quit();
                self.open_gate();
            }
            if !busy {
                self.pause();
            }
        }
        let joined = self.thread.take().and_then(|thread| thread.join().ok());
        let left = joined.ok_or(Failure::job("the loop's thread is gone"))?;
        // A stop that came after the loop's last cycle holds all the same.
        daemon.take_stop(Some(&self.handles.controls));
        while self.bridge(daemon) {}
        self.report_rights(&mut daemon.state);
        self.handle_events(&mut daemon.state);
        self.handles.free_retired();
        match left {
            LoopEnd::Panicked { ref message, .. } => {
                let failure = format!("the loop's thread panicked; the arm was stopped by its own means: {message}");
                self.tape.close(&left, &failure, Vec::new(), false);
                Err(Failure::job(failure))
            }
            LoopEnd::Ended(ref outcome) => {
                let statistics = self.statistics(outcome);
                let words = end_words(&statistics, &outcome.end);
                let recovers = daemon.state.may_recover(&outcome.end);
                self.tape.close(&left, &words, self.next_step(&outcome.end), recovers);
                Ok((statistics, outcome.end))
            }
        }
    }

    /// Waits for a loop whose end was requested because the bridge thread panicked: it brakes an arm that moves. The recording comes after that,
    /// because the session may be half changed and the next panic ends the process.
    fn end_after_panic(&mut self, message: &str) -> Result<(SessionStatistics, End), Failure> {
        let failure = format!("the bridge thread panicked, and the arm was stopped: {message}");
        tracing::error!("{failure}");
        let thread = self.thread.take().inspect(|thread| await_end(thread, self.gate.as_deref()));
        if let Some(left) = thread.filter(JoinHandle::is_finished).and_then(|thread| thread.join().ok()) {
            self.tape.set_reason(Reason::new(ReasonKind::Panic, &failure));
            self.records.clear();
            self.drain.take_into(&mut self.records, RING);
            self.tape.keep(&self.records);
            while let Ok(event) = self.handles.events.pop() {
                self.tape.event(event);
            }
            self.tape.close(&left, &failure, Vec::new(), false);
        }
        Err(Failure::job(failure))
    }

    /// What an operator does after a fault of a physical arm.
    fn next_step(&self, end: &End) -> Vec<String> {
        match (end, &self.monitor) {
            (End::Fault(fault), Some(monitor)) => vec![monitor.explain(fault).next],
            _ => Vec::new(),
        }
    }

    /// Takes stops, then answers requests.
    fn answer_requests(&mut self, daemon: &mut Daemon) {
        let waited = self.handles.controls.is_waiting();
        daemon.answer_requests(Some(&self.handles.controls));
        self.handles.controls.doubt(daemon.state.models.doubted());
        if waited && !self.handles.controls.is_waiting() {
            // The loop takes its permission with its next state.
            self.open_gate();
        }
    }

    /// Sleeps until the next record is due. An arm in wall-clock time makes one every millisecond: this thread then wakes up right behind the
    /// loop, once, instead of polling.
    fn pause(&self) {
        match self.records_due.next_poll_ns(now_ns()).filter(|_| self.gate.is_none()) {
            Some(at_ns) => os::sleep_until(at_ns),
            None => std::thread::sleep(PAUSE),
        }
    }

    /// Progress for the watchdog: the cycles of an arm in wall-clock time. Simulated time may pause on purpose.
    fn progress(&self) -> service::Progress {
        match self.gate {
            Some(_) => service::Progress::Waiting,
            None => service::Progress::Count(self.handles.controls.cycles()),
        }
    }

    /// Moves records from the ring to shared memory; whether there were any.
    fn bridge(&mut self, daemon: &mut Daemon) -> bool {
        self.records.clear();
        let taken = self.drain.take_into(&mut self.records, DRAIN);
        let Some(&last) = self.records.last() else { return false };
        self.newest = last.cycle;
        self.take_events();
        // The torque first: its reader controls an arm.
        let gravity = self.labels.at(last.cycle).into();
        daemon.server.feed_forward(FeedForwardMessage::new(
            &last,
            daemon.state.setup.robot.chain.len(),
            gravity,
            self.vendor.into(),
        ));
        daemon.server.publish(&self.records);
        self.tape.keep(&self.records);
        daemon.state.take_records(&self.records, Some(&self.handles.controls));
        self.records_due.record_read(last.stamp_ns, last.work_ns);
        let now = now_ns();
        for record in &self.records {
            self.bridged.add(now.saturating_sub(record.stamp_ns));
        }
        if let Some(gate) = &self.gate {
            gate.consumed(taken as u64);
        }
        true
    }

    /// Logs whether this loop is real-time or degraded, as soon as its thread has its rights.
    fn report_rights(&mut self, state: &mut DaemonState) {
        let Some(granted) = self.handles.granted.get().filter(|_| !self.rights_reported) else { return };
        self.rights_reported = true;
        state.history.degraded = granted.refusals().map(str::to_string).collect();
        for refusal in &state.history.degraded {
            tracing::warn!("degraded, not real-time: {refusal}");
        }
    }

    /// Logs a change of the mode of an arm that is only monitored: nothing else would show it.
    fn report_mode(&mut self) {
        let Some(monitor) = self.monitor.as_mut().filter(|_| self.purpose == Purpose::Monitor) else { return };
        let Some(change) = monitor.mode_change() else { return };
        let mode = change.mode;
        match change.next {
            Some(next) => tracing::warn!("the arm's mode is now `{mode}`, no motion can start. {next}"),
            None => tracing::info!("the arm's mode is now `{mode}`"),
        }
    }

    /// Pauses simulated time for an estimator that watches the served model and is behind.
    fn keep_pace_with_watch(&mut self, daemon: &Daemon) {
        let watches = daemon.state.setup.job.live.watch && self.model != 0;
        let Some(gate) = self.gate.as_ref().filter(|_| watches && self.parked.is_none()) else { return };
        let served = daemon.server.served();
        let behind = served.published.saturating_sub(served.acknowledged);
        let watched = !served.followers.is_empty();
        if !self.paused && watched && behind > MAX_AHEAD_OF_WATCH {
            self.paused = true;
            gate.shut();
        } else if self.paused && (!watched || behind < MAX_AHEAD_OF_WATCH / 2) && !self.handles.controls.is_waiting() {
            self.paused = false;
            gate.open();
        }
    }

    /// Lets simulated time go on for a stop that came while it was paused for a model, and for a pause, which ends the connection.
    fn unpark_stopped(&mut self, state: &DaemonState) {
        if (self.parked.is_some() && state.is_over()) || state.is_paused() {
            self.parked = None;
            self.open_gate();
        }
    }

    /// Stops an arm that has held for a model for too long. The clock is this machine's: simulated time is paused meanwhile.
    fn check_model_timeout(&mut self, state: &mut DaemonState) {
        let controls = &self.handles.controls;
        let holds = state.models.served().is_none() && self.script.awaits_model() && controls.phase() == Phase::Hold;
        if !holds || state.is_over() {
            self.model_due_ns = None;
            return;
        }
        let seconds = state.setup.job.safety.model_timeout;
        let due = *self.model_due_ns.get_or_insert(now_ns().saturating_add((1e9 * seconds) as u64));
        if now_ns() >= due {
            let why = format!("the estimator gave no model within {seconds} s (safety.model-timeout)");
            state.stop_because(Reason::new(ReasonKind::ModelTimeout, why), Some(controls));
            self.open_gate();
        }
    }

    /// Takes events from the loop. The event of a model's first cycle is there before that cycle's record, and the flight recorder gets the events of a
    /// cycle before its record, too.
    fn take_events(&mut self) {
        while let Ok(timed) = self.handles.events.pop() {
            self.tape.event(timed);
            match timed.event {
                Event::Serving { .. } => self.labels.serving(timed.cycle),
                Event::Distrusted { model, instead } => {
                    let gravity = self.labels.fell_back(timed.cycle);
                    // Unless another has been handed over since.
                    if let (Some(gravity), true) = (gravity, self.model == model) {
                        (self.model, self.gravity) = (instead, gravity);
                    }
                }
                _ => {}
            }
            self.events.push_back(timed);
        }
    }

    fn handle_events(&mut self, state: &mut DaemonState) {
        self.take_events();
        while let Some(TimedEvent { event, cycle, .. }) = self.events.pop_front() {
            state.take_event(&event);
            if self.gate.is_some() && self.needs_model(state) && self.script.is_idle_after(&event) {
                state.programme.progress = Progress::AwaitingModel;
                self.parked = Some(cycle);
                self.shut_gate();
            }
            if let Event::Ended { motion } = event {
                state.programme.ended.push(motion);
            }
            match self.script.after(&event) {
                Next::Continue => {}
                Next::AwaitModel if self.needs_model(state) => {
                    state.programme.progress = Progress::AwaitingModel;
                    // Simulated time is paused while the estimator works.
                    self.shut_gate();
                }
                Next::AwaitModel => {}
                Next::Over => self.handles.controls.quit(),
                // A stop before the programme began does not use it up.
                Next::Aborted if state.programme.start && !state.is_paused() => {
                    state.programme.progress = Progress::Stopped;
                }
                Next::Aborted => {}
            }
            match event {
                Event::Stopped if state.is_paused() => {
                    // The arm's own controller holds it meanwhile; the next connection checks it before it moves.
                    self.parked = None;
                    self.handles.controls.quit();
                    self.open_gate();
                }
                Event::Stopped => {
                    // Nothing is left to go on for when a model comes.
                    self.parked = None;
                    self.shut_gate();
                }
                Event::Resumed => self.open_gate(),
                _ => {}
            }
        }
        self.handles.free_retired();
    }

    /// Gives the loop the model that the daemon has accepted, for the gravity of now; takes it away where it may not be served.
    fn hand_over_model(&mut self, state: &mut DaemonState) {
        let refusal = match state.model_for_loop(&self.mounting) {
            Some((accepted, Verdict::Serve(gravity))) if accepted.id != self.model || gravity != self.gravity => {
                let served = ServedModel::new(accepted.id, &accepted.model, &gravity, &self.vendor);
                if self.handles.models.serve(Box::new(served)).is_ok() {
                    (self.model, self.gravity) = (accepted.id, gravity);
                    self.labels.handed(accepted.id, gravity);
                    let vendor = Some(self.vendor.into());
                    self.tape
                        .handed(RecordedModel { id: accepted.id, gravity: gravity.into(), vendor }, &accepted.text);
                    // A parked loop gets its orders with the model.
                    if self.parked.is_none() {
                        self.open_gate();
                    }
                }
                return;
            }
            Some((_, Verdict::Refuse(why))) => why,
            Some((_, Verdict::Serve(_) | Verdict::Wait)) | None => return,
        };
        self.withdraw_model(state, refusal.to_string());
    }

    /// Ends the service of a model: an arm that moves is stopped first, and then has none.
    fn withdraw_model(&mut self, state: &mut DaemonState, why: String) {
        let controls = &self.handles.controls;
        if self.model == 0 {
            return;
        }
        let phase = controls.phase();
        let moving = matches!(phase, Phase::Approach | Phase::Excite | Phase::Return);
        // Also where it holds between two motions: orders that wait would be driven without a model.
        if moving || (phase == Phase::Hold && self.purpose == Purpose::Drive) {
            state.stop_because(Reason::new(ReasonKind::Mounting, why), Some(controls));
        } else if phase != Phase::Stop && self.handles.models.serve(Box::new(NoModel)).is_ok() {
            self.model = 0;
            self.labels.handed(0, self.gravity);
            self.tape.handed(RecordedModel { id: 0, gravity: [0.0; 3], vendor: None }, "");
        }
    }

    /// Gives the loop what may be driven now. Simulated time that was paused for the model goes on when both are there, and the next motion begins
    /// the same number of cycles after the last one, however long the model took: a seed gives the same samples every time.
    fn give_orders(&mut self, state: &DaemonState) {
        let needs_model = self.needs_model(state);
        if let Some(ended) = self.parked {
            if needs_model || self.gate.as_ref().is_some_and(|gate| gate.under_way() > 0) {
                return;
            }
            let rest = REST_FOR_MODEL.saturating_sub(self.newest.saturating_sub(ended)).max(1);
            if let Some(Planned { order, given }) = self.script.rest(rest)
                && self.handles.orders.give(order).is_ok()
            {
                self.tape.ordered(given);
            }
        }
        let given = self.give_next_orders(needs_model);
        // With a model, the gate was opened when that was handed over.
        let without = self.model == 0 && state.programme.without_model.is_some();
        if self.parked.take().is_some() || (given && without) {
            self.open_gate();
        }
    }

    /// Whether the motions after the identification wait for a model: the loop has none, and the rest is not driven without.
    fn needs_model(&self, state: &DaemonState) -> bool {
        self.model == 0 && state.programme.without_model.is_none()
    }

    /// Whether there were any.
    fn give_next_orders(&mut self, needs_model: bool) -> bool {
        let mut given_any = false;
        while self.handles.orders.room() > 0 {
            let Some(Planned { order, given }) = self.script.next(!needs_model) else { break };
            // There is room: it was checked above, and this thread alone fills the ring.
            if self.handles.orders.give(order).is_ok() {
                self.tape.ordered(given);
                given_any = true;
            }
        }
        given_any
    }

    /// Lets simulated time go on, also where it had been paused for the watch: it is paused again where that is still behind.
    fn open_gate(&mut self) {
        self.paused = false;
        self.gate.iter().for_each(|gate| gate.open());
    }

    fn shut_gate(&self) {
        self.gate.iter().for_each(|gate| gate.shut());
    }

    fn statistics(&self, outcome: &Outcome) -> SessionStatistics {
        SessionStatistics {
            name: self.name.clone(),
            statistics: outcome.summary,
            allocations: outcome.allocations,
            bridge: self.bridged.distribution(),
            refusals: outcome.granted.refusals().map(str::to_string).collect(),
            end: match outcome.last_stop {
                Some(reason) if outcome.end == End::Quit => format!("stopped: {reason}"),
                _ => outcome.end.to_string(),
            },
            link: self.monitor.as_ref().map(|monitor| {
                let mut link = monitor.link();
                if let End::Fault(fault) = &outcome.end {
                    link.fault = Some(monitor.explain(fault).to_string());
                }
                link
            }),
        }
    }
}

/// The end of a session: the arm's own explanation of its fault, where there is one.
pub fn end_words(statistics: &SessionStatistics, end: &End) -> String {
    let fault = statistics.link.as_ref().and_then(|link| link.fault.clone());
    fault.unwrap_or_else(|| end.to_string())
}
