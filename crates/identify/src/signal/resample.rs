//! Resampling of uneven, missing and repeated samples to an even time grid, with statistics.

use super::SignalError;
use nalgebra::{DMatrix, Matrix3, Vector3};
use serde::{Deserialize, Serialize};

/// Statistics of a record's time stamps.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub struct Sampling {
    /// Rows of the record.
    pub rows: usize,
    /// Rows left out because their time stamp did not advance.
    pub repeated_stamps: usize,
    /// Rows left out because every value repeats the previous row: the arm had not sent a new state.
    pub repeated_rows: usize,
    /// Samples of the even grid that fall into a gap of more than one and a half steps; they are interpolated.
    pub missing: usize,
    /// Longest time between two rows that were used \[s\].
    pub largest_gap: f64,
    /// Step of the even grid \[s\].
    pub dt: f64,
    /// Samples on the even grid.
    pub samples: usize,
}

/// A record on an even grid.
#[derive(Clone, Debug)]
pub struct Even {
    /// Time of the first sample \[s\].
    pub start: f64,
    /// Values, N x columns.
    pub values: DMatrix<f64>,
    /// Whether a sample was interpolated across a gap.
    pub filled: Vec<bool>,
    /// Statistics of the resampling.
    pub sampling: Sampling,
}

/// Steps within which equal rows count as repeats; after more steps the arm may be at rest.
const STALE_STEPS: f64 = 12.0;
/// Longest gap that a cubic crosses \[s\]: a line leaves the arc of a motion by `ddq h^2 / 8`, and what is filtered and differentiated twice shows that kink.
pub const MAX_CURVE_S: f64 = 0.1;
/// Least number of rows that a slope beside a gap is taken from.
const SLOPE_ROWS: usize = 5;

/// Resamples `values` (rows at times `t` \[s\]) with step `dt` \[s\]; `None` for the median time between distinct rows.
///
/// Between rows the values follow the cubic through the four rows around them, across a gap the cubic with the slopes on both sides of it, and across
/// more than 0.1 s the straight line. Errors: non-finite values, mismatched lengths, fewer than 16 usable rows.
pub fn resample(t: &[f64], values: &DMatrix<f64>, dt: Option<f64>) -> Result<Even, SignalError> {
    if values.nrows() != t.len() {
        return Err(SignalError::Shape { what: "values", found: values.nrows(), expected: t.len() });
    }
    for (row, &time) in t.iter().enumerate() {
        let bad =
            std::iter::once(time).chain(values.row(row).iter().copied()).enumerate().find(|(_, v)| !v.is_finite());
        if let Some((column, value)) = bad {
            return Err(SignalError::NotFinite { row: row + 1, column, value });
        }
    }
    let mut sampling = Sampling { rows: t.len(), ..Sampling::default() };
    let advancing = advancing_rows(t, &mut sampling);
    let typical = median_step(t, &advancing)?;
    let used = fresh_rows(t, values, advancing, typical, &mut sampling);
    if used.len() < 16 {
        return Err(SignalError::TooShort { samples: used.len(), needed: 16 });
    }
    let dt = match dt {
        Some(dt) => dt,
        None => tidy_step(median_step(t, &used)?),
    };
    if !(dt > 0.0 && dt.is_finite()) {
        return Err(SignalError::Step { dt });
    }
    let (start, end) = (t[used[0]], t[used[used.len() - 1]]);
    let samples = ((end - start) / dt + 1e-6).floor() as usize + 1;
    sampling.dt = dt;
    sampling.samples = samples;
    sampling.largest_gap = used.windows(2).map(|w| t[w[1]] - t[w[0]]).fold(0.0, f64::max);

    let mut even = DMatrix::zeros(samples, values.ncols());
    let mut filled = vec![false; samples];
    let mut i = 0;
    for k in 0..samples {
        let at = start + k as f64 * dt;
        while i + 2 < used.len() && t[used[i + 1]] <= at {
            i += 1;
        }
        let (left, right) = (t[used[i]], t[used[i + 1]]);
        let gap = right - left > 1.5 * dt.max(typical);
        let on_row = [i, i + 1].into_iter().find(|&r| (t[used[r]] - at).abs() < 1e-5 * dt);
        if let Some(r) = on_row {
            even.row_mut(k).copy_from(&values.row(used[r]));
            continue;
        }
        if gap {
            filled[k] = true;
            sampling.missing += 1;
        }
        let weights: Vec<(usize, f64)> = if gap && right - left <= MAX_CURVE_S {
            across(t, &used, i, at)
        } else {
            let around = if gap || i == 0 || i + 2 >= used.len() { i..i + 2 } else { i - 1..i + 3 };
            lagrange(t, &used[around], at).collect()
        };
        for (r, weight) in weights {
            for c in 0..values.ncols() {
                even[(k, c)] += weight * values[(r, c)];
            }
        }
    }
    Ok(Even { start, values: even, filled, sampling })
}

/// Weights of the polynomial through the given rows at time `at`.
fn lagrange<'a>(t: &'a [f64], rows: &'a [usize], at: f64) -> impl Iterator<Item = (usize, f64)> + 'a {
    rows.iter().map(move |&r| {
        let others = rows.iter().filter(move |&&o| o != r);
        (r, others.map(|&o| (at - t[o]) / (t[r] - t[o])).product())
    })
}

/// Weights of the cubic at time `at` across the gap behind row `i` of those used: through the rows at its ends, with the slopes of the parabolas through
/// the rows within the gap's length beside it (least squares).
fn across(t: &[f64], used: &[usize], i: usize, at: f64) -> Vec<(usize, f64)> {
    let (left, right) = (used[i], used[i + 1]);
    let h = t[right] - t[left];
    let x = (at - t[left]) / h;
    let before = (0..=i).rev().take_while(|&k| i - k < SLOPE_ROWS || t[left] - t[used[k]] <= h);
    let after = (i + 1..used.len()).take_while(|&k| k - i <= SLOPE_ROWS || t[used[k]] - t[right] <= h);
    let before: Vec<usize> = before.map(|k| used[k]).collect();
    let after: Vec<usize> = after.map(|k| used[k]).collect();
    let mut weights = vec![(left, (1.0 + 2.0 * x) * (1.0 - x) * (1.0 - x)), (right, x * x * (3.0 - 2.0 * x))];
    let sides = [(before, left, h * x * (1.0 - x) * (1.0 - x)), (after, right, h * x * x * (x - 1.0))];
    for (rows, end, factor) in sides {
        let chord = || vec![(left, -factor / h), (right, factor / h)];
        weights.extend(slope(t, &rows, end, factor).unwrap_or_else(chord));
    }
    weights
}

/// Weights of the slope at row `end` of the parabola that fits `rows` best, times `factor`; `None` for fewer than three rows.
fn slope(t: &[f64], rows: &[usize], end: usize, factor: f64) -> Option<Vec<(usize, f64)>> {
    let powers = |row: usize| Vector3::new(1.0, t[row] - t[end], (t[row] - t[end]).powi(2));
    let normal: Matrix3<f64> = rows.iter().map(|&row| powers(row) * powers(row).transpose()).sum();
    // Scaled by the times, so that the pivots are comparable.
    let scale = Vector3::from_fn(|k, _| 1.0 / normal[(k, k)].sqrt().max(f64::MIN_POSITIVE));
    let scaled = Matrix3::from_diagonal(&scale) * normal * Matrix3::from_diagonal(&scale);
    let inverse = scaled.try_inverse().filter(|_| rows.len() >= 3)?;
    let of_slope = Matrix3::from_diagonal(&scale) * inverse.column(1) * scale[1];
    Some(rows.iter().map(|&row| (row, factor * of_slope.dot(&powers(row)))).collect())
}

/// Rows whose time stamp is later than every one before.
fn advancing_rows(t: &[f64], sampling: &mut Sampling) -> Vec<usize> {
    let mut latest = f64::NEG_INFINITY;
    let mut rows = Vec::with_capacity(t.len());
    for (row, &time) in t.iter().enumerate() {
        if time > latest {
            latest = time;
            rows.push(row);
        } else {
            sampling.repeated_stamps += 1;
        }
    }
    rows
}

/// Leaves out rows that only repeat the values of the row used before them.
fn fresh_rows(t: &[f64], values: &DMatrix<f64>, rows: Vec<usize>, typical: f64, sampling: &mut Sampling) -> Vec<usize> {
    let mut used: Vec<usize> = Vec::with_capacity(rows.len());
    for row in rows {
        let repeats = used
            .last()
            .is_some_and(|&last| t[row] - t[last] < STALE_STEPS * typical && values.row(row) == values.row(last));
        if repeats {
            sampling.repeated_rows += 1;
        } else {
            used.push(row);
        }
    }
    used
}

fn median_step(t: &[f64], rows: &[usize]) -> Result<f64, SignalError> {
    let mut steps: Vec<f64> = rows.windows(2).map(|w| t[w[1]] - t[w[0]]).collect();
    if steps.is_empty() {
        return Err(SignalError::TooShort { samples: rows.len(), needed: 16 });
    }
    let middle = steps.len() / 2;
    Ok(*steps.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// Rounds a step to whole microseconds where it is near: time stamps have few digits.
fn tidy_step(dt: f64) -> f64 {
    let rounded = (dt * 1e6).round() / 1e6;
    if rounded > 0.0 && (dt - rounded).abs() < 2e-3 * dt { rounded } else { dt }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn signal(t: f64) -> [f64; 2] {
        [(2.0 * t).sin(), 1.0 + 0.3 * (5.0 * t).cos()]
    }

    #[test]
    fn an_even_record_is_unchanged() {
        let t: Vec<f64> = (0..500).map(|k| 3.0 + k as f64 * 1e-3).collect();
        let values = DMatrix::from_fn(500, 2, |k, c| signal(t[k])[c]);
        let even = resample(&t, &values, None).unwrap();
        assert_eq!(even.values, values);
        assert_eq!(even.sampling.missing + even.sampling.repeated_rows + even.sampling.repeated_stamps, 0);
        assert_eq!((even.sampling.dt, even.sampling.samples), (1e-3, 500));
    }

    #[test]
    fn jitter_gaps_and_repeats_are_corrected_and_counted() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let (mut t, mut rows) = (Vec::new(), Vec::new());
        for k in 0..4000 {
            if (1000..1006).contains(&k) {
                continue;
            }
            let time = k as f64 * 0.002 + rng.random_range(-4e-4..4e-4);
            t.push(time);
            rows.push(signal(time));
            if k % 400 == 7 {
                t.push(time + 9e-4);
                rows.push(signal(time));
            }
            if k % 800 == 3 {
                t.push(time);
                rows.push(signal(time));
            }
        }
        let values = DMatrix::from_fn(t.len(), 2, |k, c| rows[k][c]);
        let even = resample(&t, &values, Some(0.002)).unwrap();
        assert_eq!(even.sampling.repeated_rows, 10);
        assert_eq!(even.sampling.repeated_stamps, 5);
        assert!((6..=7).contains(&even.sampling.missing), "{:?}", even.sampling);
        assert!((even.sampling.largest_gap - 0.014).abs() < 1e-3);
        for k in 0..even.values.nrows() {
            let exact = signal(even.start + k as f64 * 0.002);
            let tolerance = if even.filled[k] { 1e-3 } else { 2e-5 };
            assert!((0..2).all(|c| (even.values[(k, c)] - exact[c]).abs() < tolerance), "sample {k}");
        }
    }

    #[test]
    fn a_gap_follows_the_motion_on_both_sides() {
        let t: Vec<f64> = (0..1000).filter(|k| !(500..511).contains(k)).map(|k| k as f64 * 0.004).collect();
        let values = DMatrix::from_fn(t.len(), 2, |k, c| signal(t[k])[c]);
        let even = resample(&t, &values, None).unwrap();
        let error =
            |k: usize| (0..2).map(|c| (even.values[(k, c)] - signal(k as f64 * 0.004)[c]).abs()).fold(0.0, f64::max);
        let worst = (495..516).map(error).fold(0.0, f64::max);
        // The straight line is off by 0.3 * 5^2 * 0.048^2 / 8 = 2e-3.
        assert!(worst < 1e-4, "{worst}");
    }

    #[test]
    fn beside_a_gap_at_an_end_two_rows_are_enough() {
        let t: Vec<f64> = (0..40).filter(|k| !(2..5).contains(k)).map(|k| k as f64 * 0.01).collect();
        let values = DMatrix::from_fn(t.len(), 1, |k, _| 2.0 * t[k]);
        let even = resample(&t, &values, None).unwrap();
        assert!((0..40).all(|k| (even.values[(k, 0)] - 0.02 * k as f64).abs() < 2e-3), "{}", even.values);
    }

    #[test]
    fn the_error_of_a_non_finite_value_contains_its_position() {
        let t: Vec<f64> = (0..20).map(|k| k as f64).collect();
        let mut values = DMatrix::zeros(20, 2);
        values[(4, 1)] = f64::NAN;
        assert!(matches!(resample(&t, &values, None), Err(SignalError::NotFinite { row: 5, column: 2, .. })));
    }
}
