//! The recorder's thread: takes messages and records, keeps the last seconds, writes recordings.

use super::folder::Folder;
use super::{Close, Message, PAUSE, Requests};
use crate::date::utc;
use crate::recording::about::{About, LogClock, Note, Reason, ReasonKind};
use crate::recording::history::History;
use crate::recording::{Recording, model_name};
use plumbline_core::{PERIOD_NS, Record, State};
use plumbline_rt::os::now_ns;
use plumbline_rt::{Controls, Event, StopReason, TimedEvent};
use rtrb::Consumer;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// Longest delay of a stop's last record on its way to the recorder.
const RECORD_TIMEOUT: Duration = Duration::from_secs(2);

/// The recorder's end, for one loop.
pub(super) struct RecorderThread {
    pub records: Consumer<Record>,
    pub history: History,
    pub about: About,
    pub texts: Vec<(String, String)>,
    pub before: u64,
    pub simulated: bool,
    pub controls: Arc<Controls>,
    pub stop_reason: Option<Reason>,
    /// A stop under way: why, and the cycle it began in.
    pub pending: Option<(Reason, u64)>,
}

pub(super) fn work(messages: &Receiver<Message>, folder: &Folder, requests: &Requests) {
    let mut open_loop: Option<Box<RecorderThread>> = None;
    loop {
        match messages.recv_timeout(PAUSE) {
            Ok(Message::Open(new)) => open_loop = Some(new),
            Ok(message) => {
                let on_demand = matches!(message, Message::OnDemand(_));
                if let Some(open) = &mut open_loop
                    && open.handle(message, folder)
                {
                    open_loop = None;
                }
                if on_demand {
                    requests.end(now_ns());
                }
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return,
        }
        if let Some(open) = &mut open_loop {
            open.drain();
        }
    }
}

impl RecorderThread {
    fn drain(&mut self) {
        while let Ok(record) = self.records.pop() {
            self.history.push_records(&[record]);
        }
    }

    fn handle(&mut self, message: Message, folder: &Folder) -> bool {
        match message {
            Message::Open(_) => {}
            Message::Event(event) => self.take_event(event, folder),
            Message::Order(given) => self.history.push_order(given),
            Message::Model(handed, text) => {
                let name = model_name(handed.id);
                self.history.push_model(handed);
                if !text.is_empty() && self.texts.iter().all(|(other, _)| *other != name) {
                    self.texts.push((name, text));
                }
            }
            Message::Note(text) => {
                self.drain();
                let seq = self.history.newest().map_or(0, |record| record.state.seq);
                self.history.push_note(Note { stamp_ns: now_ns(), seq, text });
            }
            Message::StopReason(reason) => self.stop_reason = Some(reason),
            Message::OnDemand(newest) => {
                self.drain();
                let reason = Reason::new(ReasonKind::OnDemand, "a recording was asked for");
                // Of another loop where this one has none yet.
                let newest = self.history.newest().map_or(0, |record| record.cycle.min(newest));
                self.write(reason, newest, newest, None, folder);
            }
            Message::Close(close) => {
                self.close(*close, folder);
                return true;
            }
        }
        false
    }

    fn take_event(&mut self, timed: TimedEvent, folder: &Folder) {
        self.history.push_event(timed);
        match timed.event {
            Event::Stopping { reason, .. } => {
                let asked = matches!(reason, StopReason::Requested | StopReason::Quit);
                let given = self.stop_reason.take().filter(|_| asked);
                let own = kind_of_stop(&reason).map(|kind| Reason::new(kind, reason.to_string()));
                self.pending = given.or(own).map(|reason| (reason, timed.cycle));
            }
            Event::Stopped => {
                if let Some((reason, cycle)) = self.pending.take() {
                    self.wait_for(timed.cycle);
                    self.write(reason, cycle, timed.cycle, None, folder);
                }
            }
            Event::Resumed => self.stop_reason = None,
            _ => {}
        }
    }

    /// Until the record of `cycle` is here; an event overtakes it, and a record that found no room never comes.
    fn wait_for(&mut self, cycle: u64) {
        let since = std::time::Instant::now();
        self.drain();
        while self.history.newest().is_none_or(|newest| newest.cycle < cycle) && since.elapsed() < RECORD_TIMEOUT {
            std::thread::sleep(PAUSE);
            self.drain();
        }
    }

    fn close(&mut self, close: Close, folder: &Folder) {
        self.drain();
        let last = close.flight.last().or(self.history.newest()).map_or(0, |record| record.cycle);
        let stop = self.pending.take();
        let reason = match (&close.reason, stop) {
            (Some(Reason { kind, text }), Some((stop, _))) => {
                let text = format!("{text}; the arm was being stopped then: {}", stop.text);
                Some((Reason::new(*kind, text), last))
            }
            (Some(reason), None) => Some((reason.clone(), last)),
            (None, stop) => stop,
        };
        if let Some((reason, cycle)) = reason {
            self.write(reason, cycle, u64::MAX, Some(close), folder);
        }
    }

    fn moved(records: &[Record], cycle: u64) -> bool {
        let speeds = |record: &Record| record.command.desired.dq.iter().any(|&dq| dq != 0.0);
        records.iter().any(|record| record.cycle.saturating_add(1) >= cycle && speeds(record))
    }

    /// Writes the cycles from some time before `cycle` on up to `newest`. Records of later ones may have overtaken what happened in them.
    fn write(&mut self, reason: Reason, cycle: u64, newest: u64, close: Option<Close>, folder: &Folder) {
        let flight = close.as_ref().map_or(&[][..], |close| close.flight.as_slice());
        let mut window = self.history.window(cycle.saturating_sub(self.before), flight);
        window.records.retain(|record| record.cycle <= newest);
        window.events.retain(|timed| timed.cycle <= newest);
        if reason.kind == ReasonKind::Requested && !RecorderThread::moved(&window.records, cycle) {
            // Nothing happened, and repeated stops of an arm at rest would remove all other recordings.
            return;
        }
        let mut about = self.about.clone();
        about.recorded = utc();
        (about.lost, about.late) = (self.controls.lost(), self.controls.late());
        about.reason = reason;
        about.clock = self.clock(window.records.last());
        (about.notes, about.orders, about.models) = (window.notes, window.orders, window.models);
        about.under_way = window.before.under_way;
        (about.orders_before, about.models_before) = (window.before.orders, window.before.models);
        let mut unanswered = None;
        if let Some(Close { end, next, goes_on, dropped_events, unanswered: state, .. }) = close {
            (about.end, about.next, about.automatic_recovery, about.dropped_events) =
                (Some(end), next, goes_on, dropped_events);
            unanswered = state.map(|state| after(window.records.last(), state));
        }
        let recording = Recording {
            about,
            records: window.records,
            unanswered,
            events: window.events,
            texts: self.texts.clone(),
            cut: None,
        };
        match folder.put(&recording) {
            Ok(path) => {
                let path = path.display();
                tracing::warn!("what led to it is recorded: `plumbline postmortem {path}` tells it");
            }
            Err(error) => tracing::error!("the recording of the fault could not be written: {error}"),
        }
    }

    fn clock(&self, newest: Option<&Record>) -> LogClock {
        let now = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos() as u64);
        match newest {
            Some(newest) if self.simulated => LogClock::Arm { seq: newest.state.seq, epoch_ns: now },
            _ => LogClock::Wall { epoch_ns: now.saturating_sub(now_ns()) },
        }
    }
}

/// The cycle that was begun with `state` and not answered, behind `last`.
fn after(last: Option<&Record>, state: State) -> Record {
    let last = last.copied().unwrap_or_default();
    let passed = state.seq.saturating_sub(last.state.seq).saturating_mul(PERIOD_NS);
    let stamp_ns = last.stamp_ns.saturating_add(passed);
    Record { cycle: last.cycle + 1, state, stamp_ns, wake_ns: 0, work_ns: 0, ..last }
}

/// Kind of a stop that is recorded by itself. The end of the program is recorded where a signal requested it.
fn kind_of_stop(reason: &StopReason) -> Option<ReasonKind> {
    Some(match reason {
        StopReason::Quit => return None,
        StopReason::Guard(_) => ReasonKind::Guard,
        StopReason::Requested => ReasonKind::Requested,
        StopReason::LostStates { .. } => ReasonKind::LostStates,
        StopReason::HeartbeatLost { .. } => ReasonKind::HeartbeatLost,
        StopReason::NotAtStart { .. } => ReasonKind::NotAtStart,
        StopReason::NoPath { .. } => ReasonKind::NoPath,
    })
}
