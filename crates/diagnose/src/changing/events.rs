//! What happens in one period of a run and not in the others: contacts and what is none.

use super::LEAST_PERIODS;
use super::contact::{self, Contact, MARGIN_S, Noise};
use super::once::MAX_PERIODS;
use super::record::{Record, either};
use super::step::Step;
use super::transient::{self, Event, Transient};
use nalgebra::DMatrix;
use plumbline_model::term::effect::OperatingPoint;

/// A contact that lasts longer may have come to stay \[s\].
const MAX_PASSING_S: f64 = 5.0;

/// Events of one run.
#[derive(Default)]
pub(super) struct Events {
    /// Contacts, and where they were sought.
    pub contacts: Vec<(Event, Contact)>,
    /// Events that are no contacts.
    pub others: Vec<(Event, Transient)>,
}

impl Events {
    /// Events of a run with at least three periods, in what is `left` of its torques, P N x n \[Nm\]; `level` as in [`transient::robust`].
    pub fn of(record: &Record, operating_point: &OperatingPoint, left: &DMatrix<f64>, level: bool) -> Self {
        let x = transient::robust(record, left, level);
        let rest = record.centred_all(left.clone());
        let periods = record.periods() as f64;
        let noise = Noise { record, rest: &rest, rows: 0..rest.nrows(), ratio: periods / (periods - 1.0) };
        let strong = match record.periods() < LEAST_PERIODS {
            true => Vec::new(),
            false => transient::events(&x, record.dt, transient::MIN_ENERGY_DEVIATIONS),
        };
        let weak = contact::candidates(record, &contact::visible(record, &x), &strong);
        let scale = transient::scales(&x);
        let energy = |event: &Event| transient::energy(&x, &scale, event.first..event.last);
        let mut events: Vec<(f64, bool, Event)> =
            strong.into_iter().map(|event| (energy(&event), true, event)).collect();
        events.extend(weak.into_iter().map(|event| (energy(&event), false, event)));
        // The strongest first: without its rows the other periods at the same place have nothing of it.
        events.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut found, mut taken) = (Events::default(), vec![false; x.nrows()]);
        for (_, strong, event) in events {
            let of_event = || transient::from_others(record, left, &event, &taken, MARGIN_S);
            let majority = record.has_majority(event.first..event.last);
            let touched = majority
                .then(|| contact::contact(operating_point, record, &of_event(), &noise, &event, contact::MIN_GAP));
            match touched.flatten() {
                Some(contact) => {
                    taken = either(&taken, &transient::mask(record, [&event], MARGIN_S));
                    found.contacts.push((event, contact));
                }
                None if strong => {
                    let transient = transient::transient(record, &x, &event);
                    found.others.push((event, transient));
                }
                None => {}
            }
        }
        found
    }

    /// Without the events that a step makes as it comes: an arm gives way under a tool that is picked up.
    pub fn without_those_of(mut self, steps: &[Step], record: &Record, margin: f64) -> Self {
        let of_step = |event: &Event| steps.iter().any(|step| step.has(event, record, margin));
        self.contacts.retain(|(event, _)| !of_step(event));
        self.others.retain(|(event, _)| !of_step(event));
        self
    }

    /// Rows of all events.
    pub fn mask(&self, record: &Record, margin: f64) -> Vec<bool> {
        transient::mask(record, self.all(), margin)
    }

    fn all(&self) -> impl Iterator<Item = &Event> {
        self.contacts.iter().map(|(event, _)| event).chain(self.others.iter().map(|(event, _)| event))
    }
}

/// Contacts that are over before their run is, so that they can't be the begin of something that stays.
pub(super) fn passing(record: &Record, operating_point: &OperatingPoint, margin: f64) -> Vec<Event> {
    if record.periods() <= MAX_PERIODS {
        return Vec::new();
    }
    let found = Events::of(record, operating_point, &record.tau, true);
    let room = (2.0 * margin / record.dt).round() as usize;
    let passes = |event: &Event| {
        let seconds = (event.last - event.first) as f64 * record.dt;
        event.first > room && event.last + room < record.tau.nrows() && seconds < MAX_PASSING_S
    };
    found.contacts.into_iter().map(|(event, _)| event).filter(passes).collect()
}
