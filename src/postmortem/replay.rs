//! The recording through the loop again: the same states, orders and models at the same cycles must give the same commands, bit for bit.
//!
//! The loop is the one that drives arms, with its guard and its planner. It begins where the recording does: at the loop's own first cycle
//! where that is recorded, else in the middle, from a [`Checkpoint`]. A [`Playback`] in place of the arm hands out the recorded states and,
//! in the same read, what the loop took from its rings in that cycle, which the recorded events tell. What the outside only asked for (a
//! stop, a permission) is asked for again; what the loop decided by itself (the guard's stops, lost states) it has to decide by itself.
//!
//! Honest limits: the same program on the same kind of processor, because sines are not the same everywhere; a model with terms that
//! remember (hysteresis, delay) begins without its memory, so its torque may differ until it has forgotten, and only its torque.

use crate::recording::Recording;
use crate::recording::about::{Given, Handed, LogClock, Series, UnderWay, panic_message, panicked};
use crate::recording::history::{Fold, begun_from};
use nalgebra::DMatrix;
use plumbline_core::{
    Backend, Command, Fault, FeedForward, Kinematics, MAX_JOINTS, Record, Reference, Setpoint, Sink, State,
};
use plumbline_excite::{Fourier, PeriodicMotion};
use plumbline_rt::cycle::{Cycle, End};
use plumbline_rt::{Checkpoint, Doing, Event, Handles, Order, OrderKind, StopReason, Succession, TimedEvent, cycle};
use serde::Serialize;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};

/// Why a recording can't be run again.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReplayError {
    /// Too little of it is in one piece.
    #[error("only {cycles} cycles without a gap, and a replay needs {needed}")]
    TooShort {
        /// Cycles in the last piece.
        cycles: usize,
        /// Cycles needed.
        needed: usize,
    },
    /// The loop had no room to say what it did.
    #[error("{dropped_events} events never left the loop, so what it was given is not known")]
    DroppedEvents {
        /// How many.
        dropped_events: u64,
    },
    /// Something that the loop was given is not in the recording.
    #[error("{what} is not in the recording")]
    Missing {
        /// What.
        what: String,
    },
    /// Something in the recording can't be used.
    #[error("{what}: {why}")]
    Unusable {
        /// What.
        what: String,
        /// Why not.
        why: String,
    },
}

/// What came out.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Replayed {
    /// First cycle that was run again.
    pub first: u64,
    /// Cycles that were compared.
    pub compared: u64,
    /// Whether it began with the loop itself.
    pub from_the_start: bool,
    /// Cycles in which the loop commanded another motion, phase or model than in the recording.
    pub different: u64,
    /// The first of them, in words.
    pub first_difference: Option<String>,
    /// Cycles in which only the torque was another.
    pub torque_different: u64,
    /// The last of those.
    pub last_torque_difference: Option<u64>,
    /// Whether the same happened at the same cycles.
    pub same_events: bool,
    /// How the loop ended the second time, where the recording holds the state that ended it.
    pub end: Option<String>,
    /// Whether that is how it ended the first time.
    pub same_end: Option<bool>,
}

impl Replayed {
    /// Whether every command came out bit for bit, and everything else as it was.
    pub fn is_identical(&self) -> bool {
        self.different == 0 && self.torque_different == 0 && self.same_events && self.same_end != Some(false)
    }
}

/// A model that is ready to serve, or why there is none.
pub type Built = Result<Box<dyn FeedForward>, String>;

/// What the replay needs beside the recording.
pub struct Parts<'p> {
    /// Where the end effector is, for the guard.
    pub kinematics: Option<Box<dyn Kinematics>>,
    /// A model that the loop was given, ready to serve.
    pub model: &'p mut dyn FnMut(&Handed) -> Built,
}

/// Runs the recording again.
///
/// # Errors
/// [`ReplayError`] where something that the loop was given is not in the recording.
pub fn replay(recording: &Recording, parts: Parts) -> Result<Replayed, ReplayError> {
    let about = &recording.about;
    if about.dropped_events > 0 {
        return Err(ReplayError::DroppedEvents { dropped_events: about.dropped_events });
    }
    let start = Start::find(recording, parts.model)?;
    let handing = Handing::plan(recording, &start, parts.model)?;
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
        handing,
        shared: Arc::clone(&shared),
    };
    let kept: Arc<Mutex<Vec<Record>>> = Arc::new(Mutex::new(Vec::with_capacity(records.len() + 2)));
    let kinematics = parts.kinematics.filter(|_| settings.guard.workspace.is_some());
    let unusable = |what: &str, why: &dyn ToString| ReplayError::Unusable { what: what.into(), why: why.to_string() };
    let (mut again, handles) = cycle::new(playback, Kept(Arc::clone(&kept)), kinematics, settings)
        .map_err(|error| unusable("the loop's settings", &error))?;
    *lock(&shared) = Some(handles);
    let from_the_start = start.checkpoint.is_none();
    if let Some(checkpoint) = start.checkpoint {
        again.restore(checkpoint).map_err(|error| unusable("the motion under way", &error))?;
    }
    // A loop that panicked does so again.
    let end = catch_unwind(AssertUnwindSafe(|| Cycle::run(&mut again)))
        .map(|outcome| outcome.end)
        .map_err(|panic| panicked(&panic_message(&*panic)));
    drop(again);
    let mut handles = lock(&shared).take().ok_or_else(|| ReplayError::Missing { what: "the loop's end".into() })?;
    let told: Vec<TimedEvent> = std::iter::from_fn(|| handles.events.pop().ok()).collect();
    handles.free_retired();
    let kept = std::mem::take(&mut *lock(&kept));
    let mut result = compare(records, &kept, from_the_start);
    result.same_events = same_events(recording, &told, result.first);
    if unanswered.is_some() {
        let text = end.as_ref().map_or_else(String::clone, End::to_string);
        // A fault of the arm came from the arm, and is not the loop's doing.
        result.same_end = about.end.as_ref().filter(|_| !matches!(end, Ok(End::Fault(_)))).map(|end| *end == text);
        result.end = Some(text);
    }
    Ok(result)
}

type Shared = Arc<Mutex<Option<Handles>>>;

fn lock<T>(shared: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Where the loop begins again.
struct Start {
    /// First record to run again.
    at: usize,
    /// Where it goes on from; `None` for the loop's own start.
    checkpoint: Option<Checkpoint>,
    /// What had been taken before.
    before: Fold,
}

/// Cycles that a checkpoint is made of.
const LEAD: usize = 3;

impl Start {
    /// The earliest place in the last piece of the recording without gaps at which everything is known.
    fn find(recording: &Recording, model: &mut dyn FnMut(&Handed) -> Built) -> Result<Start, ReplayError> {
        let records = &recording.records;
        let piece = records.windows(2).rposition(|pair| pair[1].cycle != pair[0].cycle + 1).map_or(0, |gap| gap + 1);
        let too_short = ReplayError::TooShort { cycles: records.len() - piece, needed: LEAD + 1 };
        if records.get(piece).is_some_and(|first| first.cycle == 0) {
            return Ok(Start { at: piece, checkpoint: None, before: Fold::default() });
        }
        if records.len() - piece <= LEAD {
            return Err(too_short);
        }
        let mut refused = too_short;
        // After every event the loop may be in the middle of something that is known.
        let after_events = recording.events.iter().filter_map(|told| {
            let place = records.partition_point(|record| record.cycle <= told.cycle);
            (place > piece + LEAD && place < records.len()).then_some(place)
        });
        let mut places: Vec<usize> = std::iter::once(piece + LEAD).chain(after_events).collect();
        places.sort_unstable();
        for at in places {
            let before = fold(recording, records[at - 1].cycle);
            match doing(recording, &before) {
                Ok(doing) => {
                    let last = [records[at - 3], records[at - 2], records[at - 1]];
                    let models = serving(recording, last[2].cycle, last[2].model, model)?;
                    return Ok(Start { at, checkpoint: Some(Checkpoint { doing, last, models }), before });
                }
                Err(error) => refused = error,
            }
        }
        Err(refused)
    }
}

/// What the events up to and with a cycle mean.
fn fold(recording: &Recording, cycle: u64) -> Fold {
    let about = &recording.about;
    let begin = recording.records.first().map_or(0, |first| first.cycle);
    let mut fold =
        Fold { under_way: about.under_way.clone(), orders: about.orders_before, models: about.models_before };
    for told in recording.events.iter().filter(|told| told.cycle > begin && told.cycle <= cycle) {
        fold.after(told, begun_before(&recording.records, told));
    }
    fold
}

/// The setpoint that what an event speaks of began from.
fn begun_before(records: &[Record], told: &TimedEvent) -> Option<Setpoint> {
    let find =
        |cycle: u64| records.binary_search_by_key(&cycle, |record| record.cycle).ok().map(|place| &records[place]);
    Some(begun_from(&told.event, find(told.cycle.checked_sub(1)?)?, find(told.cycle)))
}

fn doing(recording: &Recording, before: &Fold) -> Result<Doing, ReplayError> {
    let known = |from: &Option<_>, what: &str| {
        from.map(Setpoint::from)
            .ok_or_else(|| ReplayError::Missing { what: format!("the setpoint that {what} began at") })
    };
    Ok(match &before.under_way {
        UnderWay::Hold => Doing::Hold,
        UnderWay::Stopped => Doing::Stopped,
        UnderWay::Brake { from } => Doing::Brake { from: known(from, "the stop")? },
        UnderWay::Order { index, from } => match given(recording, *index)? {
            order @ Given::Move { target, .. } => {
                Doing::Move { phase: order.phase(), from: known(from, "the motion")?, target: *target }
            }
            Given::Follow { motion, series } => Doing::Follow(reference(*motion, series)?),
            Given::Dwell { ticks, .. } => Doing::Dwell { ticks: *ticks },
            Given::Opaque { motion } => return Err(ReplayError::Missing { what: format!("motion {motion}") }),
        },
    })
}

fn given(recording: &Recording, index: u32) -> Result<&Given, ReplayError> {
    let missing = || ReplayError::Missing { what: format!("order {index}") };
    recording.about.orders.get(index as usize).ok_or_else(missing)
}

/// A periodic motion from its series.
fn reference(motion: u32, series: &Series) -> Result<Box<dyn Reference>, ReplayError> {
    let unusable = |why: String| ReplayError::Unusable { what: format!("motion {motion}"), why };
    let Series { period, periods, q0, a, b } = series;
    let columns = a.first().map_or(0, Vec::len);
    if a.len() != q0.len() || b.len() != q0.len() || a.iter().chain(b).any(|row| row.len() != columns) {
        return Err(unusable("its amplitudes are no matrices with one row per joint".into()));
    }
    let matrix = |rows: &[Vec<f64>]| DMatrix::from_fn(rows.len(), columns, |row, column| rows[row][column]);
    let fourier =
        Fourier::new(*period, q0.clone(), matrix(a), matrix(b)).map_err(|error| unusable(error.to_string()))?;
    let motion = PeriodicMotion::new(&fourier, *periods).map_err(|error| unusable(error.to_string()))?;
    Ok(Box::new(motion))
}

/// The model that was asked in `cycle`, which has to be `id`, and the one behind it.
fn serving(
    recording: &Recording,
    cycle: u64,
    id: u64,
    model: &mut dyn FnMut(&Handed) -> Built,
) -> Result<Succession<Box<dyn FeedForward>>, ReplayError> {
    let about = &recording.about;
    let (begin, first) = recording.records.first().map_or((0, 0), |first| (first.cycle, first.model));
    let mut left = about.models.iter();
    let mut models = Succession::default();
    for handed in left.by_ref().take(about.models_before as usize) {
        models.serve(handed.id, handed);
    }
    // Models that broke a limit before the recording began.
    while models.id() != 0 && models.id() != first {
        models.fall_back();
    }
    for told in recording.events.iter().filter(|told| told.cycle > begin && told.cycle <= cycle) {
        match told.event {
            Event::Serving { .. } => drop(left.next().map(|handed| models.serve(handed.id, handed))),
            Event::Distrusted { .. } => drop(models.fall_back()),
            _ => {}
        }
    }
    if models.id() != id {
        return Err(ReplayError::Missing { what: format!("model {id:016x}") });
    }
    let mut built = Succession::default();
    let [serving, reserve] = models.into_parts();
    for (id, handed) in [reserve, serving].into_iter().flatten() {
        built.serve(id, build(handed, model)?);
    }
    Ok(built)
}

fn build(handed: &Handed, model: &mut dyn FnMut(&Handed) -> Built) -> Result<Box<dyn FeedForward>, ReplayError> {
    model(handed).map_err(|why| ReplayError::Unusable { what: format!("model {:016x}", handed.id), why })
}

/// What the loop is handed in one cycle.
enum Hand {
    Stop,
    Resume,
    Order(Order),
    Model(Box<dyn FeedForward>),
}

/// Everything that the loop is handed, by cycle.
struct Handing {
    hands: Vec<(u64, Option<Hand>)>,
    next: usize,
}

impl Handing {
    fn plan(
        recording: &Recording,
        start: &Start,
        model: &mut dyn FnMut(&Handed) -> Built,
    ) -> Result<Handing, ReplayError> {
        let first = recording.records.get(start.at).map_or(0, |record| record.cycle);
        let (mut orders, mut models) = (start.before.orders, start.before.models as usize);
        let mut hands = Vec::new();
        for told in recording.events.iter().filter(|told| told.cycle >= first) {
            let mut hand = |hand| hands.push((told.cycle, Some(hand)));
            if told.orders > orders {
                if told.orders > orders + 1 {
                    return Err(ReplayError::Missing { what: format!("what became of order {orders}") });
                }
                // One that was discarded changed nothing.
                if !matches!(told.event, Event::Discarded { .. }) {
                    hand(Hand::Order(order(given(recording, orders)?)?));
                }
                orders = told.orders;
            }
            match told.event {
                Event::Stopping {
                    reason: StopReason::Requested | StopReason::Quit | StopReason::HeartbeatLost { .. },
                    ..
                } => hand(Hand::Stop),
                Event::Resumed => hand(Hand::Resume),
                Event::Serving { model: id } => {
                    let missing = || ReplayError::Missing { what: format!("model {id:016x}") };
                    let handed = recording.about.models.get(models).ok_or_else(missing)?;
                    hand(Hand::Model(build(handed, model)?));
                    models += 1;
                }
                _ => {}
            }
        }
        Ok(Handing { hands, next: 0 })
    }

    /// Hands over what the loop took in `cycle`.
    fn hand_over(&mut self, cycle: u64, handles: &mut Handles) {
        while let Some((at, hand)) = self.hands.get_mut(self.next) {
            if *at > cycle {
                return;
            }
            self.next += 1;
            match hand.take() {
                Some(Hand::Stop) => handles.controls.stop(),
                Some(Hand::Resume) => {
                    handles.controls.resume();
                }
                // A ring that is full belongs to a loop that has left the recording's way: the comparison tells.
                Some(Hand::Order(order)) => drop(handles.orders.give(order)),
                Some(Hand::Model(model)) => drop(handles.models.serve(model)),
                None => {}
            }
        }
    }
}

fn order(given: &Given) -> Result<Order, ReplayError> {
    Ok(match given {
        Given::Move { motion, target, .. } => {
            Order { motion: *motion, kind: OrderKind::MoveTo { target: *target, phase: given.phase() } }
        }
        Given::Follow { motion, series } => {
            Order { motion: *motion, kind: OrderKind::Follow(reference(*motion, series)?) }
        }
        Given::Dwell { motion, ticks } => Order { motion: *motion, kind: OrderKind::Dwell { ticks: *ticks } },
        Given::Opaque { motion } => return Err(ReplayError::Missing { what: format!("motion {motion}") }),
    })
}

/// An arm that hands out recorded states, never waits, and moves nothing.
pub struct Playback {
    joints: usize,
    states: Vec<(u64, State)>,
    next: usize,
    handing: Handing,
    shared: Shared,
}

impl Backend for Playback {
    fn joints(&self) -> usize {
        self.joints
    }

    /// The next state; behind the last, the arm is gone.
    fn read(&mut self) -> Result<State, Fault> {
        let (cycle, state) = self.states.get(self.next).copied().ok_or(Fault::Disconnected)?;
        self.next += 1;
        if let Some(handles) = lock(&self.shared).as_mut() {
            self.handing.hand_over(cycle, handles);
        }
        Ok(state)
    }

    fn write(&mut self, _: &Command) -> Result<(), Fault> {
        Ok(())
    }

    fn stop(&mut self) {}
}

/// Keeps every record; the room was made before.
struct Kept(Arc<Mutex<Vec<Record>>>);

impl Sink for Kept {
    fn put(&mut self, record: &Record) -> bool {
        let mut kept = lock(&self.0);
        let room = kept.len() < kept.capacity();
        if room {
            kept.push(*record);
        }
        room
    }
}

fn same_bits(a: &[f64], b: &[f64]) -> bool {
    a.iter().map(|x| x.to_bits()).eq(b.iter().map(|x| x.to_bits()))
}

/// What of a cycle came out otherwise; `None` when nothing did.
fn difference(was: &Record, is: &Record) -> Option<String> {
    let (a, b) = (&was.command.desired, &is.command.desired);
    if was.command.seq != is.command.seq {
        return Some(format!("the command answers state {}, then {}", is.command.seq, was.command.seq));
    }
    for (what, x, y) in [("position", &a.q, &b.q), ("velocity", &a.dq, &b.dq), ("acceleration", &a.ddq, &b.ddq)] {
        if let Some(j) = (0..MAX_JOINTS).find(|&j| x[j].to_bits() != y[j].to_bits()) {
            return Some(format!("joint {}: desired {what} {:e}, then {:e}", j + 1, y[j], x[j]));
        }
    }
    if was.phase != is.phase {
        return Some(format!("phase {:?}, then {:?}", is.phase, was.phase));
    }
    if was.validity != is.validity {
        return Some(format!("validity {:?}, then {:?}", is.validity, was.validity));
    }
    (was.model != is.model).then(|| format!("model {:016x}, then {:016x}", is.model, was.model))
}

fn compare(were: &[Record], are: &[Record], from_the_start: bool) -> Replayed {
    let mut result = Replayed {
        first: were.first().map_or(0, |record| record.cycle),
        compared: 0,
        from_the_start,
        different: 0,
        first_difference: None,
        torque_different: 0,
        last_torque_difference: None,
        same_events: false,
        end: None,
        same_end: None,
    };
    for (place, was) in were.iter().enumerate() {
        let differs = match are.get(place) {
            Some(is) => {
                result.compared += 1;
                let torques = |of: &Record| [of.command.tau_ff.0, of.command.tau_vendor.0].concat();
                if !same_bits(&torques(was), &torques(is)) {
                    result.torque_different += 1;
                    result.last_torque_difference = Some(was.cycle);
                }
                difference(was, is)
            }
            None => Some("no command at all: the loop had ended".to_string()),
        };
        if let Some(words) = differs {
            result.different += 1;
            result.first_difference.get_or_insert_with(|| format!("cycle {}: {words}", was.cycle));
        }
    }
    result
}

/// Whether the loop told the same as in the recording from a cycle on. A stop before the program's end is asked for as any stop; what was
/// discarded is not handed over again.
fn same_events(recording: &Recording, told: &[TimedEvent], first: u64) -> bool {
    let plain = |told: &TimedEvent| match told.event {
        Event::Discarded { .. } => None,
        Event::Stopping { motion, reason: StopReason::Quit | StopReason::HeartbeatLost { .. } } => {
            Some((told.cycle, Event::Stopping { motion, reason: StopReason::Requested }))
        }
        event => Some((told.cycle, event)),
    };
    let were: Vec<_> = recording.events.iter().filter(|told| told.cycle >= first).filter_map(plain).collect();
    let are: Vec<_> = told.iter().filter_map(plain).collect();
    // A NaN in a violation is equal to itself here.
    format!("{were:?}") == format!("{are:?}")
}

/// Whether the recording's time is simulated.
pub fn is_simulated(recording: &Recording) -> bool {
    matches!(recording.about.clock, LogClock::Arm { .. })
}
