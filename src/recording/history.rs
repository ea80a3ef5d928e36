//! The last seconds of a loop in preallocated memory.
//!
//! The daemon stores the records and events from the loop's rings here. [`History::window`] returns the part to write to disk. Records
//! that did not pass through the rings (full ring, stalled reader) are taken from the loop's own flight recorder.

use super::about::{Activity, Note, RecordedModel, RecordedOrder};
use plumbline_core::{JointVec, Record, Setpoint, State};
use plumbline_rt::{Event, TimedEvent, braked_from};
use std::collections::VecDeque;

/// Capacity for events. The state that older events led to is kept in `base`.
const MAX_EVENTS: usize = 4096;
const MAX_NOTES: usize = 256;

/// The last cycles and events of one loop, and its inputs.
pub struct History {
    ring: Vec<Record>,
    next: usize,
    events: VecDeque<EventEntry>,
    /// Events from this place on wait for the record of their cycle.
    matched: usize,
    base: LoopState,
    notes: VecDeque<Note>,
    orders: Vec<RecordedOrder>,
    models: VecDeque<RecordedModel>,
    dropped_models: u32,
    joints: usize,
    tracking: JointVec,
}

struct EventEntry {
    timed: TimedEvent,
    from: Option<Setpoint>,
}

/// State of the loop that follows from its events.
#[derive(Clone, Debug, Default)]
pub struct LoopState {
    pub under_way: Activity,
    pub orders: u32,
    pub models: u32,
}

/// Setpoint at the start of `event`: that of the previous cycle `last`. For a stop after lost states, the setpoint is extrapolated to
/// cycle `own`.
pub fn start_setpoint(event: &Event, last: &Record, own: Option<&Record>) -> Setpoint {
    match (event, own) {
        (Event::Stopping { .. }, Some(own)) => {
            let gap = own.state.seq.saturating_sub(last.state.seq);
            braked_from(&last.command.desired, gap, own.tick)
        }
        _ => last.command.desired,
    }
}

impl LoopState {
    /// Updates the state with an event; `from` is the setpoint at its start.
    pub fn apply(&mut self, timed: &TimedEvent, from: Option<Setpoint>) {
        self.orders = timed.orders;
        match timed.event {
            Event::Started { .. } => {
                self.under_way = Activity::Order { index: timed.orders.saturating_sub(1), from };
            }
            Event::Ended { .. } | Event::Resumed => self.under_way = Activity::Hold,
            Event::Stopping { .. } => self.under_way = Activity::Brake { from },
            Event::Stopped => self.under_way = Activity::Stopped,
            Event::Serving { .. } => self.models += 1,
            Event::Discarded { .. } | Event::Distrusted { .. } => {}
        }
    }
}

/// The part of a history to write to disk.
#[derive(Clone, Debug, Default)]
pub struct Window {
    /// Records, oldest first, possibly with gaps.
    pub records: Vec<Record>,
    pub events: Vec<TimedEvent>,
    pub notes: Vec<Note>,
    /// State of the loop after the first of the cycles.
    pub before: LoopState,
    pub orders: Vec<RecordedOrder>,
    /// Models that a replay may need; `before` counts only these.
    pub models: Vec<RecordedModel>,
}

impl History {
    /// Allocates a history of `depth` cycles (none for 0) of an arm with `joints` joints. `tracking` is the guard's tolerance \[rad\].
    pub fn new(depth: usize, joints: usize, tracking: JointVec) -> History {
        History {
            ring: Vec::with_capacity(depth),
            next: 0,
            events: VecDeque::with_capacity(if depth == 0 { 0 } else { MAX_EVENTS }),
            matched: 0,
            base: LoopState::default(),
            notes: VecDeque::new(),
            orders: Vec::new(),
            models: VecDeque::new(),
            dropped_models: 0,
            joints,
            tracking,
        }
    }

    /// Adds records, overwriting the oldest.
    pub fn push_records(&mut self, records: &[Record]) {
        if self.ring.capacity() == 0 {
            return;
        }
        for record in records {
            if self.ring.len() < self.ring.capacity() {
                self.ring.push(*record);
            } else if let Some(slot) = self.ring.get_mut(self.next) {
                *slot = *record;
                self.next = (self.next + 1) % self.ring.len();
            }
        }
        self.match_events();
    }

    /// Adds an event, overwriting the oldest.
    pub fn push_event(&mut self, timed: TimedEvent) {
        if self.ring.capacity() == 0 {
            return;
        }
        if self.events.len() == MAX_EVENTS
            && let Some(oldest) = self.events.pop_front()
        {
            self.base.apply(&oldest.timed, oldest.from);
            self.matched = self.matched.saturating_sub(1);
            // The model that served at that time is still needed.
            while self.base.models > self.dropped_models + 1 && self.models.pop_front().is_some() {
                self.dropped_models += 1;
            }
        }
        self.events.push_back(EventEntry { timed, from: None });
        self.match_events();
    }

    /// Adds a remark, overwriting the oldest.
    pub fn push_note(&mut self, note: Note) {
        if self.notes.len() == MAX_NOTES {
            self.notes.pop_front();
        }
        self.notes.push_back(note);
    }

    pub fn push_order(&mut self, order: RecordedOrder) {
        self.orders.push(order);
    }

    pub fn push_model(&mut self, model: RecordedModel) {
        self.models.push_back(model);
    }

    pub fn newest(&self) -> Option<&Record> {
        self.at(self.ring.len().checked_sub(1)?)
    }

    /// Record at index `place` from the oldest.
    fn at(&self, place: usize) -> Option<&Record> {
        self.ring.get((self.next + place) % self.ring.len().max(1))
    }

    fn find(&self, cycle: u64) -> Option<&Record> {
        let (mut low, mut high) = (0, self.ring.len());
        while low < high {
            let middle = (low + high) / 2;
            if self.at(middle)?.cycle < cycle { low = middle + 1 } else { high = middle }
        }
        self.at(low).filter(|record| record.cycle == cycle)
    }

    /// Stores the start setpoint of every event whose record has arrived.
    fn match_events(&mut self) {
        let Some(newest) = self.newest().map(|record| record.cycle) else { return };
        while let Some(timed) = self.events.get(self.matched).map(|waiting| waiting.timed) {
            let cycle = timed.cycle;
            if cycle > newest {
                return;
            }
            let from = match cycle.checked_sub(1) {
                Some(before) => self.find(before).map(|last| start_setpoint(&timed.event, last, self.find(cycle))),
                None => self.find(0).map(|record| start(&record.state, self.joints, &self.tracking)),
            };
            if let Some(waiting) = self.events.get_mut(self.matched) {
                waiting.from = from;
            }
            self.matched += 1;
        }
    }

    /// The cycles from number `first` on, with their events and remarks.
    ///
    /// `flight` are records of the loop's own flight recorder, oldest first. Records missing here are taken from it. With `flight`
    /// records the loop has ended, and they overwrite the oldest.
    pub fn window(&mut self, first: u64, flight: &[Record]) -> Window {
        let missing: Vec<Record> = flight
            .iter()
            .filter(|record| record.cycle >= first && self.find(record.cycle).is_none())
            .copied()
            .collect();
        let places = (0..self.ring.len()).filter_map(|place| self.at(place));
        let mut records: Vec<Record> = places.filter(|record| record.cycle >= first).copied().collect();
        // Records after the newest one also give the start setpoints of the last events.
        let newest = self.newest().map_or(0, |record| record.cycle);
        records.extend(&missing);
        records.sort_by_key(|record| record.cycle);
        let later: Vec<Record> = missing.into_iter().filter(|record| record.cycle > newest).collect();
        self.push_records(&later);
        let begin = records.first().map_or(first, |record| record.cycle);
        let mut before = self.base.clone();
        let mut events = Vec::new();
        for EventEntry { timed, from } in &self.events {
            if timed.cycle <= begin {
                before.apply(timed, *from);
            }
            if timed.cycle >= begin {
                events.push(*timed);
            }
        }
        let since = records.first().map_or(0, |record| record.stamp_ns);
        let notes = self.notes.iter().filter(|note| note.stamp_ns >= since).cloned().collect();
        before.models = before.models.saturating_sub(self.dropped_models);
        Window {
            records,
            events,
            notes,
            before,
            orders: self.orders.clone(),
            models: self.models.iter().cloned().collect(),
        }
    }
}

/// Setpoint that a loop holds at its start with `state`, by the rule of the loop.
fn start(state: &State, joints: usize, tracking: &JointVec) -> Setpoint {
    let agrees = (0..joints).all(|j| (state.q_d[j] - state.q[j]).abs() <= tracking[j]);
    let mut q = if agrees { state.q_d } else { state.q };
    q.iter_mut().skip(joints).for_each(|q| *q = 0.0);
    Setpoint { q, ..Setpoint::default() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(cycle: u64) -> Record {
        let mut record = Record { cycle, stamp_ns: cycle * 1_000_000, ..Record::default() };
        record.command.desired.q[0] = cycle as f64;
        record
    }

    fn timed(cycle: u64, orders: u32, event: Event) -> TimedEvent {
        TimedEvent { cycle, seq: cycle + 1, stamp_ns: 0, orders, event }
    }

    fn cycles(window: &Window) -> Vec<u64> {
        window.records.iter().map(|record| record.cycle).collect()
    }

    #[test]
    fn missing_records_come_from_the_flight_recorder() {
        let mut history = History::new(8, 1, [0.1; 8]);
        // Cycles 0 to 11 arrived without 9; 12 and 13 did not arrive.
        for cycle in (0..12).filter(|&cycle| cycle != 9) {
            history.push_records(&[record(cycle)]);
        }
        let flight: Vec<Record> = (8..14).map(record).collect();
        assert_eq!(cycles(&history.window(6, &[])), [6, 7, 8, 10, 11]);
        assert_eq!(cycles(&history.window(0, &[]))[0], 3, "overwritten records are gone");
        assert_eq!(cycles(&history.window(6, &flight)), (6..14).collect::<Vec<_>>());
    }

    #[test]
    fn activity_is_known_after_its_event_was_overwritten() {
        let mut history = History::new(4, 1, [0.1; 8]);
        history.push_records(&[record(0), record(1)]);
        history.push_event(timed(2, 1, Event::Started { motion: 5 }));
        history.push_event(timed(2, 1, Event::Serving { model: 9 }));
        for cycle in 2..50 {
            history.push_records(&[record(cycle)]);
        }
        let window = history.window(0, &[]);
        assert_eq!(cycles(&window), [46, 47, 48, 49]);
        assert!(window.events.is_empty());
        let LoopState { under_way, orders, models } = window.before;
        assert_eq!((orders, models), (1, 1));
        let Activity::Order { index: 0, from: Some(from) } = under_way else { panic!("{under_way:?}") };
        assert_eq!(from.q[0], 1.0, "the setpoint of the cycle before it began");
        // An event may arrive before its record.
        history.push_event(timed(51, 1, Event::Stopping { motion: 5, reason: plumbline_rt::StopReason::Requested }));
        assert_eq!(history.window(0, &[]).before.models, 1);
        history.push_records(&[record(50), record(51)]);
        history.push_records(&[record(52), record(53), record(54)]);
        let Activity::Brake { from: Some(from) } = history.window(53, &[]).before.under_way else { panic!() };
        assert_eq!(from.q[0], 50.0);
    }

    #[test]
    fn state_survives_the_overwriting_of_events() {
        let mut history = History::new(4, 1, [0.1; 8]);
        for cycle in 0..3 * MAX_EVENTS as u64 {
            // As with a moving base: another model every few cycles.
            let event = if cycle % 3 == 0 { Event::Serving { model: cycle } } else { Event::Started { motion: 1 } };
            if cycle % 3 == 0 {
                history.push_model(RecordedModel { id: cycle, gravity: [0.0; 3], vendor: None });
            }
            history.push_event(timed(cycle, cycle as u32 + 1, event));
            history.push_records(&[record(cycle)]);
        }
        let window = history.window(3 * MAX_EVENTS as u64 - 1, &[]);
        assert!(window.models.len() <= MAX_EVENTS / 3 + 2, "{}", window.models.len());
        // The model taken last serves.
        let serving = &window.models[window.before.models as usize - 1];
        assert_eq!((window.before.models as usize, serving.id), (window.models.len(), 3 * MAX_EVENTS as u64 - 3));
        assert_eq!(history.events.len(), MAX_EVENTS);
        let last = 3 * MAX_EVENTS as u64 - 1;
        let Activity::Order { index, from: Some(from) } = history.window(last, &[]).before.under_way else { panic!() };
        assert_eq!((u64::from(index), from.q[0]), (last, last as f64 - 1.0));
    }
}
