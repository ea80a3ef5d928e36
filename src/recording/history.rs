//! The last seconds of a loop, in memory that is allocated before it runs.
//!
//! Whoever drains the loop's rings keeps here what came out of them. When something has happened, [`History::window`] gives the part that
//! goes to disk; what never came out of the rings (the ring was full, the drain stood still) comes from the loop's own flight recorder.

use super::about::{Given, Handed, Note, Point, UnderWay};
use plumbline_core::{JointVec, Record, Setpoint, State};
use plumbline_rt::{Event, TimedEvent, braked_from};
use std::collections::VecDeque;

/// Events that are kept; what they mean for the loop's state outlives them.
const EVENTS: usize = 4096;
/// Remarks that are kept.
const NOTES: usize = 256;

/// The last cycles and events of one loop, and everything it was given.
pub struct History {
    ring: Vec<Record>,
    next: usize,
    events: VecDeque<Happened>,
    /// Events from this place on wait for the record of their cycle.
    settled: usize,
    /// What the events that were dropped left behind.
    base: Fold,
    notes: VecDeque<Note>,
    orders: Vec<Given>,
    models: VecDeque<Handed>,
    /// Models before these, of which no replay has need.
    forgotten: u32,
    joints: usize,
    tracking: JointVec,
}

/// An event and the setpoint that was sent before it.
struct Happened {
    told: TimedEvent,
    from: Option<Setpoint>,
}

/// What events mean for the loop.
#[derive(Clone, Debug, Default)]
pub struct Fold {
    /// What it is in the middle of.
    pub under_way: UnderWay,
    /// Orders taken.
    pub orders: u32,
    /// Models taken.
    pub models: u32,
}

/// The setpoint that what `event` speaks of began from: the one of the cycle before, `last`, or where the arm had gone on alone to when
/// states were lost and a stop began in cycle `own`.
pub fn begun_from(event: &Event, last: &Record, own: Option<&Record>) -> Setpoint {
    match (event, own) {
        (Event::Stopping { .. }, Some(own)) => {
            let gap = own.state.seq.saturating_sub(last.state.seq);
            braked_from(&last.command.desired, gap, own.tick)
        }
        _ => last.command.desired,
    }
}

impl Fold {
    /// After one more event; `from` is the setpoint that was sent before it.
    pub fn after(&mut self, told: &TimedEvent, from: Option<Setpoint>) {
        self.orders = told.orders;
        let from = from.map(Point::from);
        match told.event {
            Event::Started { .. } => {
                self.under_way = UnderWay::Order { index: told.orders.saturating_sub(1), from };
            }
            Event::Ended { .. } | Event::Resumed => self.under_way = UnderWay::Hold,
            Event::Stopping { .. } => self.under_way = UnderWay::Brake { from },
            Event::Stopped => self.under_way = UnderWay::Stopped,
            Event::Serving { .. } => self.models += 1,
            Event::Discarded { .. } | Event::Distrusted { .. } => {}
        }
    }
}

/// The part of a history that goes to disk.
#[derive(Clone, Debug, Default)]
pub struct Window {
    /// The cycles, oldest first; numbers that are missing were never recorded.
    pub records: Vec<Record>,
    /// What happened in them.
    pub events: Vec<TimedEvent>,
    /// Remarks.
    pub notes: Vec<Note>,
    /// What the loop was in the middle of after the first of the cycles.
    pub before: Fold,
    /// Every order given to the loop.
    pub orders: Vec<Given>,
    /// Every model given to the loop that a replay may need; `before` counts these alone.
    pub models: Vec<Handed>,
}

impl History {
    /// Room for `depth` cycles (none for 0) of an arm with `joints` joints, allocated here; `tracking` is the guard's tolerance.
    pub fn new(depth: usize, joints: usize, tracking: JointVec) -> History {
        History {
            ring: Vec::with_capacity(depth),
            next: 0,
            events: VecDeque::with_capacity(if depth == 0 { 0 } else { EVENTS }),
            settled: 0,
            base: Fold::default(),
            notes: VecDeque::new(),
            orders: Vec::new(),
            models: VecDeque::new(),
            forgotten: 0,
            joints,
            tracking,
        }
    }

    /// Keeps records in place of the oldest.
    pub fn keep(&mut self, records: &[Record]) {
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
        self.settle();
    }

    /// Keeps an event.
    pub fn tell(&mut self, told: TimedEvent) {
        if self.ring.capacity() == 0 {
            return;
        }
        if self.events.len() == EVENTS
            && let Some(oldest) = self.events.pop_front()
        {
            self.base.after(&oldest.told, oldest.from);
            self.settled = self.settled.saturating_sub(1);
            // The one that served then is still needed.
            while self.base.models > self.forgotten + 1 && self.models.pop_front().is_some() {
                self.forgotten += 1;
            }
        }
        self.events.push_back(Happened { told, from: None });
        self.settle();
    }

    /// Keeps a remark.
    pub fn note(&mut self, note: Note) {
        if self.notes.len() == NOTES {
            self.notes.pop_front();
        }
        self.notes.push_back(note);
    }

    /// The loop was given an order.
    pub fn ordered(&mut self, order: Given) {
        self.orders.push(order);
    }

    /// The loop was given a model.
    pub fn handed(&mut self, model: Handed) {
        self.models.push_back(model);
    }

    /// The newest record.
    pub fn newest(&self) -> Option<&Record> {
        self.at(self.ring.len().checked_sub(1)?)
    }

    /// Record at a place counted from the oldest.
    fn at(&self, place: usize) -> Option<&Record> {
        self.ring.get((self.next + place) % self.ring.len().max(1))
    }

    /// The record of a cycle.
    fn find(&self, cycle: u64) -> Option<&Record> {
        let (mut low, mut high) = (0, self.ring.len());
        while low < high {
            let middle = (low + high) / 2;
            if self.at(middle)?.cycle < cycle { low = middle + 1 } else { high = middle }
        }
        self.at(low).filter(|record| record.cycle == cycle)
    }

    /// Notes for every event whose cycle is here what had been sent before it.
    fn settle(&mut self) {
        let Some(newest) = self.newest().map(|record| record.cycle) else { return };
        while let Some(told) = self.events.get(self.settled).map(|waiting| waiting.told) {
            let cycle = told.cycle;
            if cycle > newest {
                return;
            }
            let from = match cycle.checked_sub(1) {
                Some(before) => self.find(before).map(|last| begun_from(&told.event, last, self.find(cycle))),
                None => self.find(0).map(|record| start(&record.state, self.joints, &self.tracking)),
            };
            if let Some(waiting) = self.events.get_mut(self.settled) {
                waiting.from = from;
            }
            self.settled += 1;
        }
    }

    /// The cycles from number `first` on, and what belongs to them. `flight` are records of the loop's own flight recorder, oldest first:
    /// those that are missing here are taken from there. With such records this is the loop's end: they push out the oldest.
    pub fn window(&mut self, first: u64, flight: &[Record]) -> Window {
        let missing: Vec<Record> = flight
            .iter()
            .filter(|record| record.cycle >= first && self.find(record.cycle).is_none())
            .copied()
            .collect();
        let places = (0..self.ring.len()).filter_map(|place| self.at(place));
        let mut records: Vec<Record> = places.filter(|record| record.cycle >= first).copied().collect();
        // Behind the newest, they also say what had been sent before the last events.
        let newest = self.newest().map_or(0, |record| record.cycle);
        records.extend(&missing);
        records.sort_by_key(|record| record.cycle);
        let later: Vec<Record> = missing.into_iter().filter(|record| record.cycle > newest).collect();
        self.keep(&later);
        let begin = records.first().map_or(first, |record| record.cycle);
        let mut before = self.base.clone();
        let mut events = Vec::new();
        for Happened { told, from } in &self.events {
            if told.cycle <= begin {
                before.after(told, *from);
            }
            if told.cycle >= begin {
                events.push(*told);
            }
        }
        let since = records.first().map_or(0, |record| record.stamp_ns);
        let notes = self.notes.iter().filter(|note| note.stamp_ns >= since).cloned().collect();
        before.models = before.models.saturating_sub(self.forgotten);
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

/// Where a loop holds that begins with `state`, as the loop itself decides it.
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

    fn told(cycle: u64, orders: u32, event: Event) -> TimedEvent {
        TimedEvent { cycle, seq: cycle + 1, stamp_ns: 0, orders, event }
    }

    fn cycles(window: &Window) -> Vec<u64> {
        window.records.iter().map(|record| record.cycle).collect()
    }

    #[test]
    fn what_never_left_the_loop_comes_from_its_own_recorder() {
        let mut history = History::new(8, 1, [0.1; 8]);
        // Cycles 0 to 11 went by; 9 was lost on the way, 12 and 13 never came out.
        for cycle in (0..12).filter(|&cycle| cycle != 9) {
            history.keep(&[record(cycle)]);
        }
        let flight: Vec<Record> = (8..14).map(record).collect();
        assert_eq!(cycles(&history.window(6, &[])), [6, 7, 8, 10, 11]);
        assert_eq!(cycles(&history.window(0, &[]))[0], 3, "what has been overwritten is gone");
        assert_eq!(cycles(&history.window(6, &flight)), (6..14).collect::<Vec<_>>());
    }

    #[test]
    fn what_is_under_way_is_known_however_long_ago_it_began() {
        let mut history = History::new(4, 1, [0.1; 8]);
        history.keep(&[record(0), record(1)]);
        history.tell(told(2, 1, Event::Started { motion: 5 }));
        history.tell(told(2, 1, Event::Serving { model: 9 }));
        for cycle in 2..50 {
            history.keep(&[record(cycle)]);
        }
        let window = history.window(0, &[]);
        assert_eq!(cycles(&window), [46, 47, 48, 49]);
        assert!(window.events.is_empty());
        let Fold { under_way, orders, models } = window.before;
        assert_eq!((orders, models), (1, 1));
        let UnderWay::Order { index: 0, from: Some(from) } = under_way else { panic!("{under_way:?}") };
        assert_eq!(from.q[0], 1.0, "the setpoint of the cycle before it began");
        // An event that overtakes its record waits for it.
        history.tell(told(51, 1, Event::Stopping { motion: 5, reason: plumbline_rt::StopReason::Requested }));
        assert_eq!(history.window(0, &[]).before.models, 1);
        history.keep(&[record(50), record(51)]);
        history.keep(&[record(52), record(53), record(54)]);
        let UnderWay::Brake { from: Some(from) } = history.window(53, &[]).before.under_way else { panic!() };
        assert_eq!(from.q[0], 50.0);
    }

    #[test]
    fn thousands_of_events_change_nothing() {
        let mut history = History::new(4, 1, [0.1; 8]);
        for cycle in 0..3 * EVENTS as u64 {
            // A base that turns: another model every few cycles.
            let event = if cycle % 3 == 0 { Event::Serving { model: cycle } } else { Event::Started { motion: 1 } };
            if cycle % 3 == 0 {
                history.handed(Handed { id: cycle, gravity: [0.0; 3], vendor: None });
            }
            history.tell(told(cycle, cycle as u32 + 1, event));
            history.keep(&[record(cycle)]);
        }
        let window = history.window(3 * EVENTS as u64 - 1, &[]);
        assert!(window.models.len() <= EVENTS / 3 + 2, "{}", window.models.len());
        // The one that served last is the last that was taken.
        let serving = &window.models[window.before.models as usize - 1];
        assert_eq!((window.before.models as usize, serving.id), (window.models.len(), 3 * EVENTS as u64 - 3));
        assert_eq!(history.events.len(), EVENTS);
        let last = 3 * EVENTS as u64 - 1;
        let UnderWay::Order { index, from: Some(from) } = history.window(last, &[]).before.under_way else { panic!() };
        assert_eq!((u64::from(index), from.q[0]), (last, last as f64 - 1.0));
    }
}
