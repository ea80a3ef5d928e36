//! Contacts in a run that repeats only once: which of two periods deviates is not known, so what deviates there deviates from the model.
//! Runs without repeats are not searched: what the model lacks cannot be told from a contact there.

use super::contact::{self, Contact, Noise};
use super::drift::friction;
use super::record::{Record, blocks, spread};
use super::transient::{self, Event};
use super::{EVENT_MARGIN_S, left_out};
use nalgebra::DMatrix;
use plumbline_identify::{ExcludedSpan, Experiment};
use plumbline_model::term::effect::OperatingPoint;

/// Largest number of periods without a majority.
pub(super) const MAX_PERIODS: usize = 2;

/// Smallest difference of a contact's score to that of what is no contact: what the model lacks is here too.
const MIN_GAP: f64 = 30.0;
/// Largest energy of another event, or of the other period at the same time, as a share of the contact's.
const MAX_OTHERS_RATIO: f64 = 0.5;

/// Contacts and the stretches to be left out; none where there are more periods, or one.
pub(super) fn contacts(experiment: &Experiment, operating_point: &OperatingPoint) -> (Vec<Contact>, Vec<ExcludedSpan>) {
    let record = Record::of(experiment, 0.0).filter(|record| record.periods() == MAX_PERIODS);
    let Some(mut record) = record else { return Default::default() };
    let mean = blocks(&unmodelled(experiment, operating_point), record.step);
    let samples = record.samples;
    for (joint, mut column) in record.tau.column_iter_mut().enumerate() {
        column.iter_mut().enumerate().for_each(|(row, tau)| *tau += mean[(row % samples, joint)]);
    }
    let record = record;
    let x = &contact::visible(&record, &record.tau);
    let noise = Noise { record: &record, rest: &record.tau, ratio: 1.0 };
    let scale = transient::scales(x);
    let energy = |first: usize, last: usize| transient::energy(x, &scale, first..last);
    // What comes again in the other period is what the model lacks.
    let comes_again = |event: &Event| {
        let rows = x.nrows();
        let [first, last] = [event.first, event.last].map(|row| (row + record.samples) % rows);
        first < last && energy(first, last) > MAX_OTHERS_RATIO * energy(event.first, event.last)
    };
    let (mut touched, mut others) = (Vec::new(), 0.0_f64);
    for event in contact::candidates(&record, x, &[]) {
        let size = energy(event.first, event.last);
        let contact = || contact::contact(operating_point, &record, x, &noise, &event);
        match (!comes_again(&event)).then(contact).flatten().filter(|contact| contact.gap >= MIN_GAP) {
            Some(contact) => touched.push((size, event, contact)),
            None => others = others.max(size),
        }
    }
    // Where as much happens that is no contact, the model lacks something.
    touched.retain(|(size, ..)| others < MAX_OTHERS_RATIO * size);
    let events = touched.iter().map(|(_, event, _)| event);
    let spans = left_out(&record, &transient::mask(&record, events, EVENT_MARGIN_S));
    (touched.into_iter().map(|(.., contact)| contact).collect(), spans)
}

/// Torques that rigid bodies and friction leave, without their median, N x n \[Nm\].
fn unmodelled(experiment: &Experiment, operating_point: &OperatingPoint) -> DMatrix<f64> {
    let motion = &experiment.motion;
    let mut left = &experiment.tau - &*operating_point.load.along(motion);
    for (joint, mut column) in left.column_iter_mut().enumerate() {
        if !operating_point.friction.is_empty() {
            let friction = friction(joint, motion, operating_point);
            column.iter_mut().zip(friction).for_each(|(left, friction)| *left -= friction);
        }
        let (middle, _) = spread(column.as_slice());
        column.add_scalar_mut(-middle);
    }
    left
}
