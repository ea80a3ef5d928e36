//! Start point of a replay, and the inputs of the loop in each cycle.

use super::{BuildResult, ReplayError};
use crate::recording::Recording;
use crate::recording::about::{Activity, RecordedModel, RecordedOrder, Series};
use crate::recording::history::{LoopState, start_setpoint};
use nalgebra::DMatrix;
use plumbline_core::{FeedForward, Record, Reference, Setpoint};
use plumbline_excite::{Fourier, PeriodicMotion};
use plumbline_rt::{Checkpoint, Doing, Event, Handles, Order, OrderKind, StopReason, Succession, TimedEvent};

pub(super) struct StartPoint {
    /// First record to run again.
    pub at: usize,
    /// State of the loop at the start point; `None` for the start of the loop.
    pub checkpoint: Option<Checkpoint>,
    before: LoopState,
}

const CHECKPOINT_CYCLES: usize = 3;

impl StartPoint {
    /// The earliest cycle in the last gapless part of the recording with a known state of the loop.
    pub fn find(
        recording: &Recording,
        model: &mut dyn FnMut(&RecordedModel) -> BuildResult,
    ) -> Result<StartPoint, ReplayError> {
        let records = &recording.records;
        let piece = records.windows(2).rposition(|pair| pair[1].cycle != pair[0].cycle + 1).map_or(0, |gap| gap + 1);
        let too_short = ReplayError::TooShort { cycles: records.len() - piece, needed: CHECKPOINT_CYCLES + 1 };
        if records.get(piece).is_some_and(|first| first.cycle == 0) {
            return Ok(StartPoint { at: piece, checkpoint: None, before: LoopState::default() });
        }
        if records.len() - piece <= CHECKPOINT_CYCLES {
            return Err(too_short);
        }
        let mut refused = too_short;
        // The state of the loop can become known after an event.
        let after_events = recording.events.iter().filter_map(|timed| {
            let place = records.partition_point(|record| record.cycle <= timed.cycle);
            (place > piece + CHECKPOINT_CYCLES && place < records.len()).then_some(place)
        });
        let mut places: Vec<usize> = std::iter::once(piece + CHECKPOINT_CYCLES).chain(after_events).collect();
        places.sort_unstable();
        for at in places {
            let before = loop_state(recording, records[at - 1].cycle);
            match activity(recording, &before) {
                Ok(doing) => {
                    let last = [records[at - 3], records[at - 2], records[at - 1]];
                    let models = serving(recording, last[2].cycle, last[2].model, model)?;
                    return Ok(StartPoint { at, checkpoint: Some(Checkpoint { doing, last, models }), before });
                }
                Err(error) => refused = error,
            }
        }
        Err(refused)
    }
}

/// State of the loop after the events up to and including `cycle`.
fn loop_state(recording: &Recording, cycle: u64) -> LoopState {
    let about = &recording.about;
    let begin = recording.records.first().map_or(0, |first| first.cycle);
    let mut state =
        LoopState { under_way: about.under_way.clone(), orders: about.orders_before, models: about.models_before };
    for timed in recording.events.iter().filter(|timed| timed.cycle > begin && timed.cycle <= cycle) {
        state.apply(timed, start_setpoint_of(&recording.records, timed));
    }
    state
}

fn start_setpoint_of(records: &[Record], timed: &TimedEvent) -> Option<Setpoint> {
    let find =
        |cycle: u64| records.binary_search_by_key(&cycle, |record| record.cycle).ok().map(|place| &records[place]);
    Some(start_setpoint(&timed.event, find(timed.cycle.checked_sub(1)?)?, find(timed.cycle)))
}

fn activity(recording: &Recording, before: &LoopState) -> Result<Doing, ReplayError> {
    let known = |from: &Option<_>, what: &str| {
        from.ok_or_else(|| ReplayError::Missing { what: format!("the setpoint at the start of {what}") })
    };
    Ok(match &before.under_way {
        Activity::Hold => Doing::Hold,
        Activity::Stopped => Doing::Stopped,
        Activity::Brake { from } => Doing::Brake { from: known(from, "the stop")? },
        Activity::Order { index, from } => match recorded_order(recording, *index)? {
            order @ RecordedOrder::Move { target, .. } => {
                Doing::Move { phase: order.phase(), from: known(from, "the motion")?, target: *target }
            }
            RecordedOrder::Follow { motion, series } => Doing::Follow(reference(*motion, series)?),
            RecordedOrder::Dwell { ticks, .. } => Doing::Dwell { ticks: *ticks },
            RecordedOrder::Opaque { motion } => return Err(ReplayError::Missing { what: format!("motion {motion}") }),
        },
    })
}

fn recorded_order(recording: &Recording, index: u32) -> Result<&RecordedOrder, ReplayError> {
    let missing = || ReplayError::Missing { what: format!("order {index}") };
    recording.about.orders.get(index as usize).ok_or_else(missing)
}

fn reference(motion: u32, series: &Series) -> Result<Box<dyn Reference>, ReplayError> {
    let unusable = |why: String| ReplayError::Unusable { what: format!("motion {motion}"), why };
    let Series { period, periods, q0, a, b } = series;
    let columns = a.first().map_or(0, Vec::len);
    if a.len() != q0.len() || b.len() != q0.len() || a.iter().chain(b).any(|row| row.len() != columns) {
        return Err(unusable("its amplitudes are not matrices with one row per joint".into()));
    }
    let matrix = |rows: &[Vec<f64>]| DMatrix::from_fn(rows.len(), columns, |row, column| rows[row][column]);
    let fourier =
        Fourier::new(*period, q0.clone(), matrix(a), matrix(b)).map_err(|error| unusable(error.to_string()))?;
    let motion = PeriodicMotion::new(&fourier, *periods).map_err(|error| unusable(error.to_string()))?;
    Ok(Box::new(motion))
}

/// The model served in `cycle`, which has to be `id`, and its fall-back.
fn serving(
    recording: &Recording,
    cycle: u64,
    id: u64,
    model: &mut dyn FnMut(&RecordedModel) -> BuildResult,
) -> Result<Succession<Box<dyn FeedForward>>, ReplayError> {
    let about = &recording.about;
    let (begin, first) = recording.records.first().map_or((0, 0), |first| (first.cycle, first.model));
    let mut left = about.models.iter();
    let mut models = Succession::default();
    for handed in left.by_ref().take(about.models_before as usize) {
        models.serve(handed.id, handed);
    }
    // Models withdrawn before the recording began.
    while models.id() != 0 && models.id() != first {
        models.fall_back();
    }
    for timed in recording.events.iter().filter(|timed| timed.cycle > begin && timed.cycle <= cycle) {
        match timed.event {
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

fn build(
    handed: &RecordedModel,
    model: &mut dyn FnMut(&RecordedModel) -> BuildResult,
) -> Result<Box<dyn FeedForward>, ReplayError> {
    model(handed).map_err(|why| ReplayError::Unusable { what: format!("model {:016x}", handed.id), why })
}

enum Input {
    Stop,
    Resume,
    Order(Order),
    Model(Box<dyn FeedForward>),
}

/// Everything that the loop is handed, by cycle.
pub(super) struct InputSchedule {
    inputs: Vec<(u64, Option<Input>)>,
    next: usize,
}

impl InputSchedule {
    pub fn plan(
        recording: &Recording,
        start: &StartPoint,
        model: &mut dyn FnMut(&RecordedModel) -> BuildResult,
    ) -> Result<InputSchedule, ReplayError> {
        let first = recording.records.get(start.at).map_or(0, |record| record.cycle);
        let (mut orders, mut models) = (start.before.orders, start.before.models as usize);
        let mut inputs = Vec::new();
        for timed in recording.events.iter().filter(|timed| timed.cycle >= first) {
            let mut hand = |hand| inputs.push((timed.cycle, Some(hand)));
            if timed.orders > orders {
                if timed.orders > orders + 1 {
                    return Err(ReplayError::Missing { what: format!("the outcome of order {orders}") });
                }
                // A discarded order has no effect.
                if !matches!(timed.event, Event::Discarded { .. }) {
                    hand(Input::Order(order(recorded_order(recording, orders)?)?));
                }
                orders = timed.orders;
            }
            match timed.event {
                Event::Stopping {
                    reason: StopReason::Requested | StopReason::Quit | StopReason::HeartbeatLost { .. },
                    ..
                } => hand(Input::Stop),
                Event::Resumed => hand(Input::Resume),
                Event::Serving { model: id } => {
                    let missing = || ReplayError::Missing { what: format!("model {id:016x}") };
                    let handed = recording.about.models.get(models).ok_or_else(missing)?;
                    hand(Input::Model(build(handed, model)?));
                    models += 1;
                }
                _ => {}
            }
        }
        Ok(InputSchedule { inputs, next: 0 })
    }

    /// Hands over what the loop took in `cycle`.
    pub fn apply(&mut self, cycle: u64, handles: &mut Handles) {
        while let Some((at, hand)) = self.inputs.get_mut(self.next) {
            if *at > cycle {
                return;
            }
            self.next += 1;
            match hand.take() {
                Some(Input::Stop) => handles.controls.stop(),
                Some(Input::Resume) => {
                    handles.controls.resume();
                }
                // A full ring means that the replay has diverged, which the comparison shows.
                Some(Input::Order(order)) => drop(handles.orders.give(order)),
                Some(Input::Model(model)) => drop(handles.models.serve(model)),
                None => {}
            }
        }
    }
}

fn order(given: &RecordedOrder) -> Result<Order, ReplayError> {
    Ok(match given {
        RecordedOrder::Move { motion, target, .. } => {
            Order { motion: *motion, kind: OrderKind::MoveTo { target: *target, phase: given.phase() } }
        }
        RecordedOrder::Follow { motion, series } => {
            Order { motion: *motion, kind: OrderKind::Follow(reference(*motion, series)?) }
        }
        RecordedOrder::Dwell { motion, ticks } => Order { motion: *motion, kind: OrderKind::Dwell { ticks: *ticks } },
        RecordedOrder::Opaque { motion } => return Err(ReplayError::Missing { what: format!("motion {motion}") }),
    })
}
