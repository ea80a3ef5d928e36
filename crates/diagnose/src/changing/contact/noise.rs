//! Noise of the deviations that a contact is told from.

use super::super::record::{Record, spread};
use nalgebra::DMatrix;
use std::ops::Range;

/// Windows that have a row in common.
const WINDOWS_OVERLAPPING: usize = 4;

/// What the deviations are made of where nothing happens.
pub struct Noise<'a> {
    /// The run.
    pub record: &'a Record<'a>,
    /// Deviations of all periods, P N x n \[Nm\].
    pub rest: &'a DMatrix<f64>,
    /// Noise of a period's deviation from the mean of the others over that from the mean of all.
    pub ratio: f64,
    /// Time between the knots of a course \[s\]: as long as the torques are smoothed over.
    pub knot_spacing: f64,
}

impl Noise<'_> {
    /// Standard deviation of the mean over so many rows of one period, n \[Nm\], from windows that overlap and have no row of an event.
    pub fn of_mean(&self, rows: usize, event: &Range<usize>) -> Vec<f64> {
        let hop = (rows / WINDOWS_OVERLAPPING).max(1);
        let starts = (0..=self.rest.nrows().saturating_sub(rows)).step_by(hop);
        let apart: Vec<usize> = starts.filter(|&start| start + rows <= event.start || start >= event.end).collect();
        let shows = |row: usize, joint: usize| !self.record.masked[row] && !self.record.hides(row, joint);
        let scale = |joint: usize| {
            let mean = |&start: &usize| {
                let own = (start..start + rows).filter(|&row| shows(row, joint));
                let (sum, count) = own.fold((0.0, 0), |(sum, count), row| (sum + self.rest[(row, joint)], count + 1));
                (2 * count >= rows).then(|| sum / count as f64)
            };
            let means: Vec<f64> = apart.iter().filter_map(mean).collect();
            (1.4826 * spread(&means).1 * self.ratio).max(1e-9)
        };
        (0..self.rest.ncols()).map(scale).collect()
    }
}
