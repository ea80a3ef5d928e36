//! Noise of the deviations that a contact is told from.

use super::super::record::{Record, blocks, spread};
use nalgebra::DMatrix;

/// What the deviations are made of where nothing happens.
pub struct Noise<'a> {
    /// The run.
    pub record: &'a Record<'a>,
    /// Deviations of all periods, P N x n \[Nm\].
    pub rest: &'a DMatrix<f64>,
    /// Noise of a period's deviation from the mean of the others over that from the mean of all.
    pub ratio: f64,
}

impl Noise<'_> {
    /// Standard deviation of the mean over so many rows of one period, n \[Nm\].
    pub fn of_mean(&self, rows: usize) -> Vec<f64> {
        let means = blocks(self.rest, rows);
        let scale = |(joint, means): (usize, &[f64])| {
            let out = |row: usize| self.record.masked[row] || self.record.hides(row, joint);
            let hidden = |block: usize| (block * rows..(block + 1) * rows).any(out);
            let counted = means.iter().enumerate().filter(|(block, _)| !hidden(*block));
            (1.4826 * spread(&counted.map(|(_, mean)| *mean).collect::<Vec<_>>()).1 * self.ratio).max(1e-9)
        };
        means.as_slice().chunks(means.nrows()).enumerate().map(scale).collect()
    }
}
