//! When a step comes, near a stretch of which one period alone tells: where the likelihood of what differs between the periods is largest.

use super::super::coming::Coming;
use super::super::fitted::Fitted;
use super::super::record::Record;
use super::{Deviations, Rows, Trial, What};

/// First step of the search \[s\]; the row at which a step explains most of single samples is often further off in slow noise.
const FIRST_S: f64 = 0.1;
/// Its last one \[s\].
const LAST_S: f64 = 0.02;
/// Most begins that are tried.
const MAX_BEGINS: usize = 60;
/// A begin of which one period alone tells is as likely as one nearby with a score that is higher by no more: that has two deviations more in its favour.
const MAX_LESS: f64 = 4.0;
/// A step is found at most this long after a stretch of which one period alone tells, or before it \[s\].
const NEAR_S: f64 = 0.8;

impl Deviations<'_> {
    /// Near a stretch of which one period alone tells, a step that begins where its likelihood is largest; at the last of several rows of which nothing tells
    /// them apart. Elsewhere single samples tell its begin better: an arm that gives way to a tool has done so for a while.
    pub(super) fn begun(
        &self,
        coming: &[Coming],
        best: (Trial, Fitted, f64),
        rows: &[Rows],
        candidates: usize,
    ) -> (Trial, Fitted, f64) {
        let What::Step(which, row) = best.0.what else { return best };
        let one = &coming[which];
        let record = &self.records[one.run];
        let Some(range) = one.begins(record).filter(|_| latest(record, row).is_some()) else { return best };
        let at = |row: usize| self.tried(self.step((which, one), row, one.since(record, row)), rows, candidates);
        let (mut best, mut row, mut left) = (best, row, MAX_BEGINS);
        let mut step = (FIRST_S / record.dt) as usize;
        while step >= ((LAST_S / record.dt) as usize).max(1) && left > 0 {
            let both = [row.saturating_sub(step), row + step];
            let near = both.into_iter().filter(|other| range.contains(other));
            let tried = near.filter_map(|other| {
                left = left.saturating_sub(1);
                Some((other, at(other)?))
            });
            match tried.max_by(|a, b| a.1.2.total_cmp(&b.1.2)).filter(|(_, tried)| tried.2 > best.2) {
                Some((other, tried)) => (row, best) = (other, tried),
                None => step /= 2,
            }
        }
        match latest(record, row).and_then(at) {
            Some(last) if last.2 > best.2 - MAX_LESS => last,
            _ => best,
        }
    }
}

/// Whether at most one period tells of a row's sample.
fn is_alone(record: &Record, row: usize) -> bool {
    let periods = (row % record.samples..record.masked.len()).step_by(record.samples);
    periods.filter(|&own| !record.masked[own]).count() < 2
}

/// The first row at which what comes at a row may have come: no other period tells of those in between.
pub(super) fn earliest(record: &Record, row: usize) -> usize {
    let near = row.saturating_sub((NEAR_S / record.dt) as usize);
    let alone = |row: &usize| is_alone(record, *row);
    let last = (near..=row).rev().find(alone);
    last.and_then(|last| (0..=last).rev().take_while(alone).last()).unwrap_or(row)
}

/// The last one, alike; `None` where other periods tell of the row and of those that follow it.
fn latest(record: &Record, row: usize) -> Option<usize> {
    let tells_alone = |row: &usize| !record.masked[*row] && is_alone(record, *row);
    let end = record.masked.len();
    let first = (row..end.min(row + (NEAR_S / record.dt) as usize)).find(tells_alone)?;
    (first..end).take_while(tells_alone).last()
}
