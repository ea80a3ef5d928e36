//! Events of seconds in which one period differs from the others: a contact, a caught cable, a moving gripper.
//!
//! The energy of a second's deviation from the median of the periods is compared with that of all other seconds of the run.

use super::record::{Record, from_median, spread, stretches};
use nalgebra::DMatrix;
use std::ops::Range;

/// Length of a window \[s\]; windows overlap by half.
const WINDOW_S: f64 = 1.0;
/// Median deviations from the median energy that make a window stand out.
pub(super) const MIN_ENERGY_DEVIATIONS: f64 = 25.0;
/// Time over which energy is averaged to find begin and end \[s\].
const SHORT_WINDOW_S: f64 = 0.1;
/// An event lasts while the energy within that time is above this share of the median deviations that make a window stand out.
const LASTING_RATIO: f64 = 0.5;
/// Share of the peak energy above which the event lasts.
const LASTING_PEAK_RATIO: f64 = 0.03;
/// Time between two events that are one \[s\].
const MIN_GAP_S: f64 = 0.5;

/// Something that happened once and is no contact.
#[derive(Clone, Debug, PartialEq)]
pub struct Transient {
    /// Name of the run.
    pub run: String,
    /// Begin, since the first sample of the run \[s\].
    pub from: f64,
    /// End \[s\].
    pub to: f64,
    /// Period that it begins in, from 0.
    pub period: usize,
    /// Joints in which it shows, from 0.
    pub joints: Vec<usize>,
    /// RMS of the deviation meanwhile, per joint \[Nm\].
    pub rms: Vec<f64>,
}

/// Rows of a record in which something happens.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Event {
    /// First row.
    pub first: usize,
    /// Row after the last.
    pub last: usize,
    /// Joints whose energy stands out.
    pub joints: Vec<usize>,
}

/// Deviations of `x`, P N x n, from the median of the periods; what wanders from period to period is taken off by each period's own median.
pub(super) fn robust(record: &Record, x: &DMatrix<f64>, level: bool) -> DMatrix<f64> {
    let mut out = x.clone();
    let rows = out.nrows();
    for column in out.as_mut_slice().chunks_mut(rows) {
        let mut x = from_median(column.to_vec(), record.samples);
        if level {
            for period in x.chunks_mut(record.samples) {
                let (middle, _) = spread(period);
                period.iter_mut().for_each(|value| *value -= middle);
            }
        }
        x.iter_mut().zip(&record.uncounted).filter(|(_, uncounted)| **uncounted).for_each(|(x, _)| *x = 0.0);
        column.copy_from_slice(&x);
    }
    out
}

/// `x`, P N x n, where in the rows of an event and so long before and after \[s\] the mean of the other periods is taken off, without the rows of other
/// contacts that are `taken`. The median would be between the rest and the event: off by up to half of the noise, and always to the same side.
pub(super) fn from_others(
    record: &Record,
    x: &DMatrix<f64>,
    event: &Event,
    taken: &[bool],
    margin: f64,
) -> DMatrix<f64> {
    let own = mask(record, [event], margin);
    let mut out = x.clone();
    for row in (0..own.len()).filter(|&row| own[row]) {
        let all = (row % record.samples..own.len()).step_by(record.samples);
        let others: Vec<usize> =
            all.filter(|&other| !own[other] && !taken[other] && !record.uncounted[other]).collect();
        let quiet: Vec<usize> = others.iter().copied().filter(|&other| !record.masked[other]).collect();
        let rows = if quiet.is_empty() { others } else { quiet };
        for (joint, column) in x.column_iter().enumerate() {
            let sum: f64 = rows.iter().map(|&other| column[other]).sum();
            out[(row, joint)] -= sum / rows.len().max(1) as f64;
        }
    }
    out
}

/// Scale of each joint's deviations, as a standard deviation that events don't change \[Nm\]; samples that don't count are zero.
pub(super) fn scales(x: &DMatrix<f64>) -> Vec<f64> {
    let scale = |column: &[f64]| (1.4826 * spread_of_counting(column).1).max(1e-9);
    x.as_slice().chunks(x.nrows()).map(scale).collect()
}

/// Sum of the squares of deviations in some rows, in units of each joint's [`scales`].
pub(super) fn energy(x: &DMatrix<f64>, scale: &[f64], rows: Range<usize>) -> f64 {
    let of_row = |row: usize| scale.iter().enumerate().map(|(j, scale)| (x[(row, j)] / scale).powi(2)).sum::<f64>();
    rows.map(of_row).sum()
}

/// Events in deviations as [`robust`] gives them, every `dt` \[s\]: windows whose energy is so many median deviations above the median. Rows are
/// in the order of time but for periods that were left out.
pub(super) fn events(x: &DMatrix<f64>, dt: f64, min_deviations: f64) -> Vec<Event> {
    let (rows, joints) = x.shape();
    let window = ((WINDOW_S / dt).round() as usize).clamp(1, rows);
    let hop = (window / 2).max(1);
    let starts: Vec<usize> = (0..=rows - window).step_by(hop).collect();
    let mut flagged = vec![vec![false; rows]; joints];
    for (column, flagged) in x.as_slice().chunks(rows).zip(&mut flagged) {
        let energy: Vec<f64> =
            starts.iter().map(|&start| column[start..start + window].iter().map(|x| x * x).sum()).collect();
        let (middle, deviation) = spread_of_counting(&energy);
        for (&start, energy) in starts.iter().zip(&energy) {
            if *energy > middle + min_deviations * deviation && *energy > 0.0 {
                flagged[start..start + window].fill(true);
            }
        }
    }
    let scale = scales(x);
    // Energy of a tenth of a second, over the joints that stand out.
    let half = ((SHORT_WINDOW_S / dt / 2.0).round() as usize).max(1);
    let gap = (MIN_GAP_S / dt).round() as usize;
    let any: Vec<bool> = (0..rows).map(|row| flagged.iter().any(|joint| joint[row])).collect();
    let mut found = Vec::new();
    for (first, last) in stretches(&any) {
        let joints: Vec<usize> = (0..joints).filter(|&j| flagged[j][first..last].iter().any(|flag| *flag)).collect();
        let square = |row: usize| joints.iter().map(|&j| (x[(row, j)] / scale[j]).powi(2)).sum::<f64>();
        let mut sums = vec![0.0; rows + 1];
        for row in 0..rows {
            sums[row + 1] = sums[row] + square(row);
        }
        let short = |row: usize| {
            let (from, to) = (row.saturating_sub(half), (row + half + 1).min(rows));
            (sums[to] - sums[from]) / (to - from) as f64
        };
        let all: Vec<f64> = (0..rows).map(short).collect();
        let (middle, deviation) = spread_of_counting(&all);
        let peak = all[first..last].iter().copied().fold(0.0, f64::max);
        let least = (middle + LASTING_RATIO * min_deviations * deviation).max(LASTING_PEAK_RATIO * peak);
        let lasting: Vec<bool> = (0..rows).map(|row| (first..last).contains(&row) && all[row] > least).collect();
        let mut own: Vec<Event> = Vec::new();
        for (from, to) in stretches(&lasting) {
            match own.last_mut() {
                Some(event) if from < event.last + gap => event.last = to,
                _ => own.push(Event { first: from, last: to, joints: joints.clone() }),
            }
        }
        found.extend(own);
    }
    found
}

/// Median and median distance from it without samples that don't count, which are zero.
fn spread_of_counting(values: &[f64]) -> (f64, f64) {
    spread(&values.iter().copied().filter(|value| *value != 0.0).collect::<Vec<_>>())
}

/// Marks the rows of events, with some on either side \[s\].
pub(super) fn mask<'e>(record: &Record, events: impl IntoIterator<Item = &'e Event>, margin: f64) -> Vec<bool> {
    let mut masked = vec![false; record.tau.nrows()];
    let margin = (margin / record.dt).round() as usize;
    for event in events {
        let last = (event.last + margin).min(masked.len());
        masked[event.first.saturating_sub(margin)..last].fill(true);
    }
    masked
}

/// An event and its size in the deviations.
pub(super) fn transient(record: &Record, x: &DMatrix<f64>, event: &Event) -> Transient {
    let rms = |column: &[f64]| {
        let own = &column[event.first..event.last];
        (own.iter().map(|value| value * value).sum::<f64>() / own.len() as f64).sqrt()
    };
    Transient {
        run: record.experiment.name.clone(),
        from: record.time(event.first),
        to: record.time(event.last - 1) + record.dt,
        period: record.repeats.periods[event.first / record.samples],
        joints: event.joints.clone(),
        rms: x.as_slice().chunks(x.nrows()).map(rms).collect(),
    }
}
