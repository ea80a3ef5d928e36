//! Contacts where no majority of periods tells which of them deviates: what deviates there deviates from the model.

use super::contact::{self, Contact, Noise};
use super::record::{Record, blocks, spread};
use super::step::Step;
use super::transient::{self, Event};
use super::{EVENT_MARGIN_S, left_out};
use crate::evidence::Trial;
use nalgebra::DMatrix;
use plumbline_identify::{ExcludedSpan, Experiment, Repeats};
use plumbline_model::term::Motion;
use plumbline_model::term::effect::OperatingPoint;
use std::borrow::Cow;
use std::cell::OnceCell;

/// Largest number of periods without a majority.
pub(super) const MAX_PERIODS: usize = 2;

/// Largest energy of another event, or of another period at the same time, as a share of the contact's.
const MAX_OTHERS_RATIO: f64 = 0.5;

/// Smallest difference of a contact's score to that of what is no contact: what the model lacks is no noise, and reaches 24.
const MIN_GAP: f64 = 30.0;
/// Smallest share of an event in which another period counts, to be held against it.
const MIN_COMPARABLE_RATIO: f64 = 0.25;
/// Length of the window of the low-pass behind which contacts are sought \[s\]: its gain is a half at 5 Hz.
const SOUGHT_S: f64 = 0.2;
/// Length of the window of the low-pass behind which they are fitted \[s\]: as long as two knots are apart.
const FITTED_S: f64 = 0.1;

/// Contacts, each with the stretches to be left out, by what the model that is `predict`ed with and `steps` leave.
pub(super) fn contacts_of(
    trials: &[Trial],
    operating_point: &OperatingPoint,
    steps: &[Step],
    predict: &impl Fn(&Motion) -> DMatrix<f64>,
) -> Vec<(Contact, Vec<ExcludedSpan>)> {
    let of_run = |trial: &Trial| {
        let own = steps.iter().filter(|step| step.run == trial.experiment.name);
        let experiment = own.fold(Cow::Borrowed(trial.experiment), |mut experiment, step| {
            let mean = step.of_mean(&experiment);
            step.take_off_deviations(experiment.to_mut());
            mean.inspect(|torque| experiment.to_mut().take_off(torque));
            experiment
        });
        contacts(&experiment, operating_point, || &experiment.tau - predict(&experiment.motion))
    };
    trials.iter().flat_map(of_run).collect()
}

/// The same of one run, by what is unmodelled of the mean torques, N x n \[Nm\].
fn contacts(
    experiment: &Experiment,
    operating_point: &OperatingPoint,
    unmodelled: impl FnOnce() -> DMatrix<f64>,
) -> Vec<(Contact, Vec<ExcludedSpan>)> {
    let Some(mut record) = Record::of(experiment, 0.0) else { return Default::default() };
    if record.has_majority(0..record.tau.nrows()) {
        return Default::default();
    }
    let mut mean = blocks(&unmodelled(), record.step);
    for mut column in mean.column_iter_mut() {
        let (middle, _) = spread(column.as_slice());
        column.add_scalar_mut(-middle);
    }
    let samples = record.samples;
    for (joint, mut column) in record.tau.column_iter_mut().enumerate() {
        column.iter_mut().enumerate().for_each(|(row, tau)| *tau += mean[(row % samples, joint)]);
    }
    let x = &contact::visible(&record, &record.smoothed(&record.tau, SOUGHT_S));
    record.tau = record.smoothed(&record.tau, FITTED_S);
    let record = record;
    let noise = Noise { record: &record, rest: &record.tau, rows: 0..record.tau.nrows(), ratio: 1.0 };
    let scale = transient::scales(x);
    let energy = |event: &Event| transient::energy(x, &scale, event.first..event.last);
    // What comes again in another period is what the model lacks.
    let comes_again = |event: &Event| {
        let rows = x.nrows();
        let in_period = |period: usize| {
            let [first, last] = [event.first, event.last].map(|row| (row + period * samples) % rows);
            first < last && energy(&Event { first, last, ..event.clone() }) > MAX_OTHERS_RATIO * energy(event)
        };
        (1..record.periods()).any(in_period)
    };
    // What the model lacks beside it may look like a contact, or make one of noise: where two periods count, they have to differ by one, too.
    let apart = OnceCell::new();
    let differs = |event: &Event| {
        let Some(apart) = apart.get_or_init(|| difference(experiment)) else { return true };
        let share = apart.counted(event.first..event.last) as f64 / (event.last - event.first) as f64;
        // The other period has the same once more.
        let period = event.first / samples * samples;
        let noise = Noise { record: apart, rest: &apart.tau, rows: period..period + samples, ratio: 1.0 };
        let gap = || contact::largest_gap(operating_point, apart, &apart.tau, &noise, event);
        share < MIN_COMPARABLE_RATIO || gap() >= share * contact::MIN_GAP
    };
    let (mut touched, mut others) = (Vec::new(), 0.0_f64);
    let by_model = |event: &Event| !record.has_majority(event.first..event.last);
    for event in contact::candidates(&record, x, &[]).into_iter().filter(by_model) {
        let contact = || contact::contact(operating_point, &record, &record.tau, &noise, &event, MIN_GAP);
        match (!comes_again(&event)).then(contact).flatten().filter(|_| differs(&event)) {
            Some(contact) => touched.push((energy(&event), event, contact)),
            None => others = others.max(energy(&event)),
        }
    }
    // Where as much happens that is no contact, the model lacks something.
    touched.retain(|(energy, ..)| others < MAX_OTHERS_RATIO * energy);
    let spans = |event: &Event| left_out(&record, &transient::mask(&record, [event], EVENT_MARGIN_S));
    touched.into_iter().map(|(_, event, contact)| (contact, spans(&event))).collect()
}

/// The same of a run without repeats.
pub(super) fn contacts_of_one_period(
    experiment: &Experiment,
    operating_point: &OperatingPoint,
    unmodelled: DMatrix<f64>,
) -> Vec<Contact> {
    let (rows, joints) = experiment.tau.shape();
    let none = DMatrix::zeros(rows, joints);
    let repeats = Repeats {
        periods: vec![0],
        q: none.clone(),
        tau: none,
        mean: experiment.tau.clone(),
        // Where the arm rests or samples were lost, torques tell nothing.
        counted: experiment.resting().iter().map(|out| !out).collect(),
    };
    let mut experiment = experiment.clone();
    experiment.repeats = Some(repeats);
    // What is there when the run begins or ends may be no contact but what came within the run, or went.
    let found = contacts(&experiment, operating_point, || unmodelled).into_iter().map(|(contact, _)| contact);
    found.filter(|contact| contact.at_ends == [false; 2]).collect()
}

/// What each period of a run has more than another one, where two count; the model has no part in it. `None` without repeats.
fn difference(experiment: &Experiment) -> Option<Record<'_>> {
    let mut record = Record::of(experiment, 0.0)?;
    record.uncounted = (0..record.tau.nrows()).map(|row| !record.has_periods(row..row + 1, MAX_PERIODS)).collect();
    // Deviations from the mean of both are half of it.
    record.tau = record.smoothed(&(2.0 * &record.tau), FITTED_S);
    Some(record)
}
