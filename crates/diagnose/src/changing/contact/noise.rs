//! Noise of the deviations that a contact is told from: slow noise hardly changes within an event, and a contact does.

use super::super::record::{Record, spread};
use nalgebra::{DMatrix, SMatrix, SVector};
use std::array;
use std::ops::Range;

/// Windows that have a row in common.
const WINDOWS_OVERLAPPING: usize = 4;
/// Smallest number of windows of a recording that the noise of their means is estimated from.
const MIN_WINDOWS: usize = 12;
/// Correlation times of the parts that noise is a sum of, beside white noise \[s\].
const CORRELATION_TIMES_S: [f64; SLOW_PARTS] = [0.1, 0.4, 1.6, 6.4];
const SLOW_PARTS: usize = 4;
/// Number of parts: white, slow.
const PARTS: usize = SLOW_PARTS + 1;
/// Rounds over the parts; each takes off most of what the ones before left.
const ROUNDS: usize = 500;

/// What the deviations are made of where nothing happens.
pub struct Noise<'a> {
    /// The run.
    pub record: &'a Record<'a>,
    /// Deviations of all periods, P N x n \[Nm\].
    pub rest: &'a DMatrix<f64>,
    /// Rows of them that the noise is estimated from.
    pub rows: Range<usize>,
    /// Noise of a period's deviation from the mean of the others over that from the mean of all.
    pub ratio: f64,
}

/// Variances of the parts that the noise of a joint's blocks is made of \[Nm^2\].
pub(super) struct Parts {
    variances: [f64; PARTS],
    /// Correlation of neighbouring blocks, of each part.
    correlations: [f64; PARTS],
}

impl Noise<'_> {
    /// The noise of each joint in blocks of so many rows, from what does not belong to an event.
    pub(super) fn of_blocks(&self, length: usize, event: &Range<usize>) -> Vec<Parts> {
        let most = (self.rows.len() / MIN_WINDOWS / length).max(1);
        let doubled = (0..).map(|k| 1 << k).take_while(|count| 2 * count <= most);
        let dt = length as f64 * self.record.dt;
        let of_part = |part: usize| if part == 0 { 0.0 } else { (-dt / CORRELATION_TIMES_S[part - 1]).exp() };
        let correlations = array::from_fn(of_part);
        let of_joint = |joint: usize| {
            let means = Means::of(self, joint);
            // Of means over 1, 2, 4, ... blocks the differences of neighbours, which slow noise hardly has; of the longest ones their own deviations.
            let pairs = doubled.clone().map(|count| {
                let [two, one] = [2 * count, count].map(|count| correlations.map(|one| of_mean(one, count)));
                let shares = array::from_fn(|part| 4.0 * (one[part] - two[part]));
                let rows = count * length;
                let difference = |first: usize| Some(means.over(first, rows)? - means.over(first + rows, rows)?);
                (shares, self.spread_of(2 * rows, event, difference))
            });
            let shares = correlations.map(|one| of_mean(one, most));
            let longest = (shares, self.spread_of(most * length, event, |first| means.over(first, most * length)));
            Parts::of(correlations, &pairs.chain([longest]).collect::<Vec<_>>())
        };
        (0..self.rest.ncols()).map(of_joint).collect()
    }

    /// Variance of what windows of so many rows give that overlap and have no row of an event \[Nm^2\].
    fn spread_of(&self, rows: usize, event: &Range<usize>, value: impl Fn(usize) -> Option<f64>) -> f64 {
        let hop = (rows / WINDOWS_OVERLAPPING).max(1);
        let Range { start, end } = self.rows;
        let starts = (start..=end.saturating_sub(rows).max(start)).step_by(hop);
        let apart = starts.filter(|&start| start + rows <= event.start || start >= event.end);
        let (_, deviation) = spread(&apart.filter_map(value).collect::<Vec<_>>());
        (1.4826 * deviation * self.ratio).max(1e-9).powi(2)
    }
}

/// Means of a joint's deviations where they show something.
struct Means {
    /// Sum and number of those before each row.
    before: Vec<(f64, usize)>,
}

impl Means {
    fn of(noise: &Noise, joint: usize) -> Self {
        let mut before = vec![(0.0, 0)];
        for row in 0..noise.rest.nrows() {
            let (sum, count) = before[row];
            let shows = !noise.record.masked[row] && !noise.record.hides(row, joint);
            before.push(if shows { (sum + noise.rest[(row, joint)], count + 1) } else { (sum, count) });
        }
        Means { before }
    }

    /// Over so many rows from one on; `None` where fewer than half of them show something.
    fn over(&self, first: usize, rows: usize) -> Option<f64> {
        let [(sum, count), (to_sum, to_count)] = [self.before[first], self.before[first + rows]];
        let count = to_count - count;
        (2 * count >= rows).then(|| (to_sum - sum) / count as f64)
    }
}

impl Parts {
    /// The parts, none of them negative, of which each of these sums has its variance: least squares of the ratios, part by part.
    fn of(correlations: [f64; PARTS], sums: &[([f64; PARTS], f64)]) -> Self {
        let (mut g, mut b) = (SMatrix::<f64, PARTS, PARTS>::zeros(), SVector::<f64, PARTS>::zeros());
        for (shares, variance) in sums {
            let row = SVector::from(*shares) / *variance;
            g += row * row.transpose();
            b += row;
        }
        let mut variances = SVector::<f64, PARTS>::zeros();
        for _ in 0..ROUNDS {
            for part in 0..PARTS {
                let rest = b[part] - g.row(part).transpose().dot(&variances) + g[(part, part)] * variances[part];
                variances[part] = (rest / g[(part, part)]).max(0.0);
            }
        }
        Parts { variances: variances.into(), correlations }
    }

    /// Inverse covariance of so many blocks, of which those that are `visible` count and the others have zero; each has so much `more` variance.
    pub fn weights(&self, blocks: usize, visible: &[usize], more: f64) -> DMatrix<f64> {
        let mut own =
            DMatrix::from_fn(visible.len(), visible.len(), |a, b| self.covariance(visible[a].abs_diff(visible[b])));
        (0..own.nrows()).for_each(|k| own[(k, k)] += more);
        let mut weights = DMatrix::zeros(blocks, blocks);
        let Some(inverse) = own.cholesky().map(|factor| factor.inverse()) else { return weights };
        for (a, b) in (0..visible.len()).flat_map(|a| (0..visible.len()).map(move |b| (a, b))) {
            weights[(visible[a], visible[b])] = inverse[(a, b)];
        }
        weights
    }

    /// Covariance of two blocks that are so many apart.
    fn covariance(&self, apart: usize) -> f64 {
        let of = |(variance, correlation): (&f64, &f64)| variance * correlation.powi(apart as i32);
        self.variances.iter().zip(&self.correlations).map(of).sum()
    }
}

/// Variance of the mean of so many blocks, of noise with a variance of one and this correlation of neighbours.
fn of_mean(correlation: f64, count: usize) -> f64 {
    let pairs = |apart: usize| 2.0 * (count - apart) as f64 * correlation.powi(apart as i32);
    (count as f64 + (1..count).map(pairs).sum::<f64>()) / (count * count) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_those_that_the_variances_come_from() {
        let correlations = [0.0, 0.6, 0.88, 0.97, 0.992];
        let truth = Parts { variances: [2.0, 0.0, 1.0, 0.0, 0.5], correlations };
        let of = |shares: [f64; PARTS]| {
            let variance = shares.iter().zip(&truth.variances).map(|(share, variance)| share * variance).sum::<f64>();
            (shares, variance)
        };
        let pairs = |count: usize| correlations.map(|one| 4.0 * (of_mean(one, count) - of_mean(one, 2 * count)));
        let sums: Vec<_> =
            (0..7).map(|k| of(pairs(1 << k))).chain([of(correlations.map(|one| of_mean(one, 128)))]).collect();
        let parts = Parts::of(correlations, &sums);
        for apart in 0..60 {
            let (got, wanted) = (parts.covariance(apart), truth.covariance(apart));
            assert!((got - wanted).abs() < 0.05 * truth.covariance(0), "{apart}: {got} {wanted}");
        }
        assert!(parts.variances.iter().all(|variance| *variance >= 0.0));
    }
}
