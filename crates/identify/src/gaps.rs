//! Gaps in one period of a periodic run, filled with what the other periods have there.

use std::ops::Range;

/// Longest gap that follows its own ends, in units of the samples on each side.
const MAX_ALONE_RATIO: usize = 10;

/// How a period differs from the others at both ends of a gap.
#[derive(Clone, Copy, Debug)]
pub enum Beside {
    /// By the mean difference of at most so many samples on each side.
    Level(usize),
    /// By a line through them: one of both has not settled, and the difference changes fast.
    Line(usize),
}

impl Beside {
    fn samples(self) -> usize {
        match self {
            Beside::Level(samples) | Beside::Line(samples) => samples,
        }
    }

    /// Whether a gap of so many samples may follow its own ends: of a sine `A sin(w t)` a cubic across the time `h` is off by `A (w h)^4 / 384`, a thirtieth at
    /// 1 Hz and 0.3 s.
    fn alone(self, gap: usize) -> bool {
        matches!(self, Beside::Line(samples) if gap <= MAX_ALONE_RATIO * samples)
    }

    /// Difference at the sample next to the gap and its change from sample to sample away from there, from the differences in that order; `None` without any.
    fn of(self, differences: &[f64]) -> Option<[f64; 2]> {
        let count = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / count;
        let middle = 0.5 * (count - 1.0);
        let along = |(k, difference): (usize, &f64)| (k as f64 - middle) * (difference - mean);
        let squares = count * (count * count - 1.0) / 12.0;
        match (self, differences.len()) {
            (_, 0) => None,
            (Beside::Line(_), 2..) => {
                let slope = differences.iter().enumerate().map(along).sum::<f64>() / squares;
                Some([mean - slope * middle, slope])
            }
            _ => Some([mean, 0.0]),
        }
    }

    /// Difference within a gap that is `length` samples from end to end, at a share of that: from what [`Beside::of`] says of both ends.
    fn across(self, [[left, before], [right, after]]: [[f64; 2]; 2], share: f64, length: f64) -> f64 {
        match self {
            // A line has less of what both ends are off.
            Beside::Level(_) => left + share * (right - left),
            // Hermite's cubic. The slopes point away from the gap.
            Beside::Line(_) => {
                let rest = 1.0 - share;
                let weight = rest * rest * (1.0 + 2.0 * share);
                let slopes = rest * rest * share * before + share * share * rest * after;
                weight * left + (1.0 - weight) * right - length * slopes
            }
        }
    }
}

/// Puts into rows of a column that are `missing` what the other periods have there, with the period's own difference from them at both ends of the gap and
/// a cubic (Hermite's) or, of [`Beside::Level`], a line between: the mean over the periods must not jump where one of them is missing, for a step in
/// positions is a blow in their accelerations. `unusable` rows of other periods are not taken; of [`Beside::Line`], a short gap that no other period
/// has follows its own ends. Returns whether each missing row was filled.
pub fn fill(values: &mut [f64], missing: &[bool], unusable: &[bool], samples: usize, beside: Beside) -> Vec<bool> {
    let rows = values.len();
    let mut filled = vec![false; rows];
    let mut first = 0;
    while first < rows {
        if !missing[first] {
            first += 1;
            continue;
        }
        let end = (first..rows).find(|&row| !missing[row]).unwrap_or(rows);
        let found = fill_one(values, first..end, missing, unusable, samples, beside);
        filled[first..end].fill(found);
        first = end;
    }
    filled
}

/// One gap; false where no other period has all of it.
fn fill_one(
    values: &mut [f64],
    gap: Range<usize>,
    missing: &[bool],
    unusable: &[bool],
    samples: usize,
    beside: Beside,
) -> bool {
    let (rows, Range { start: first, end }) = (values.len(), gap);
    let edges = [first.checked_sub(1), Some(end).filter(|&row| row < rows)];
    let needed = || (first..end).chain(edges.into_iter().flatten());
    let shifted = |period: usize, row: usize| {
        (row + period * samples).checked_sub(first / samples * samples).filter(|&other| other < rows)
    };
    let usable = |period: usize, row: usize| shifted(period, row).is_some_and(|other| !unusable[other]);
    let has = |&period: &usize| period != first / samples && needed().all(|row| usable(period, row));
    let donors: Vec<usize> = (0..rows / samples).filter(has).collect();
    if donors.is_empty() && !(edges.iter().all(Option::is_some) && beside.alone(end - first)) {
        return false;
    }
    let mean = |values: &[f64], row: usize| {
        let sum: f64 = donors.iter().filter_map(|&period| shifted(period, row)).map(|other| values[other]).sum();
        sum / donors.len().max(1) as f64
    };
    let told = |row: &usize| !missing[*row] && donors.iter().all(|&period| usable(period, *row));
    let left: Vec<usize> = (first.saturating_sub(beside.samples())..first).rev().take_while(told).collect();
    let right: Vec<usize> = (end..(end + beside.samples()).min(rows)).take_while(told).collect();
    let ends = [left, right].map(|edge| {
        let differences: Vec<f64> = edge.iter().map(|&row| values[row] - mean(values, row)).collect();
        beside.of(&differences)
    });
    // Where one end is missing, the other's level holds.
    let end_of = |side: usize| ends[side].or(ends[1 - side].map(|[level, _]| [level, 0.0])).unwrap_or_default();
    let ends = [end_of(0), end_of(1)];
    let length = (end - first + 1) as f64;
    for row in first..end {
        values[row] = mean(values, row) + beside.across(ends, (row - first + 1) as f64 / length, length);
    }
    true
}

#[cfg(test)]
mod tests {
    use super::super::periods::{average, weights};
    use super::*;
    use nalgebra::DMatrix;

    #[test]
    fn a_gap_has_what_the_other_periods_have_and_its_own_deviation() {
        // The third of four periods is above the others, more and more. The second and the fourth lack the same sample, the first is left out there.
        let samples = 20;
        let above = |k: usize| if k / samples == 2 { 0.1 * (k % samples) as f64 } else { 0.0 };
        let clean: Vec<f64> = (0..80).map(|k| ((k % samples) as f64).powi(2) + above(k)).collect();
        let (mut values, mut missing) = (clean.clone(), vec![false; 80]);
        for row in [45, 46, 33, 73, 79] {
            values[row] = 1e6;
            missing[row] = true;
        }
        let filled = fill(&mut values, &missing, &missing, samples, Beside::Level(1));
        assert_eq!(filled, missing);
        // At the end of the record the deviation is that before the gap.
        let apart = |row: usize| (values[row] - clean[row]).abs();
        assert!((0..79).all(|row| apart(row) < 1e-9) && apart(79) < 0.05, "{values:?}");
        // What was filled tells nothing of the scatter.
        let values = DMatrix::from_vec(80, 1, values);
        let weights = weights(&[false; 80], &[false; 80], &[false; 80], samples, 0.1);
        let one = average(&values, &weights, &filled, samples, 0.1);
        let all = average(&values, &weights, &[], samples, 0.1);
        assert!((&one.mean - &all.mean).amax() < 1e-12 && one.scatter.unwrap().std[0] > all.scatter.unwrap().std[0]);
        // Nobody has it.
        let mut unusable = missing.clone();
        unusable[..20].fill(true);
        unusable[40..60].fill(true);
        let mut alone = clean;
        (alone[33], alone[73]) = (1e6, 1e6);
        let filled = fill(&mut alone, &missing, &unusable, samples, Beside::Level(1));
        assert!(!filled[33] && alone[33] == 1e6 && filled[79], "{filled:?}");
    }

    #[test]
    fn noise_beside_a_gap_is_not_that_of_one_sample() {
        // The second of two periods is 0.5 above the first, and lacks 60 samples; the sample before them is off by 1.
        let samples = 200;
        let clean: Vec<f64> = (0..400).map(|k| if k < samples { 0.0 } else { 0.5 }).collect();
        let missing: Vec<bool> = (0..400).map(|k| (280..340).contains(&k)).collect();
        let filled_with = |beside: usize| {
            let mut values = clean.clone();
            values[279] += 1.0;
            values[280..340].fill(9.0);
            assert_eq!(fill(&mut values, &missing, &missing, samples, Beside::Level(beside)), missing);
            (280..340).map(|k| (values[k] - clean[k]).abs()).fold(0.0, f64::max)
        };
        assert!(filled_with(1) > 0.9 && filled_with(20) < 0.06, "{} {}", filled_with(1), filled_with(20));
        // What other gaps or the end of the record leave is enough.
        assert!(filled_with(500) < 0.06);
    }
}
