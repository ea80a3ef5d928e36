//! Time stamps of a recorder that reads an arm a little faster than the arm sends.
//!
//! Every so often a row repeats the one before, and the arm has moved by one step, not by two, when the next one comes. The stamps are then those of the
//! reader, up to a step late, by more and more until the next repeat. What was sent is even in time instead, with the step
//!
//!   T = (t_last - t_first) / (distinct rows - 1).

use nalgebra::DMatrix;

/// Least number of rows that repeat the one before.
const MIN_REPEATS: usize = 5;
/// Largest deviation of a step in time, or of the rows from one repeat to the next, as a share of their median.
const MAX_UNEVEN_RATIO: f64 = 0.25;
/// Steps across a repeat: one where nothing was sent, two where a row was lost.
const MAX_STEPS: f64 = 1.5;

/// What was sent, as far as its times go.
#[derive(Clone, Debug, PartialEq)]
pub struct Sent {
    /// Time of each row \[s\]; a row that repeats the one before is halfway to the next.
    pub t: Vec<f64>,
    /// Time between what was sent \[s\].
    pub step: f64,
    /// Rows that repeat the one before.
    pub repeats: usize,
}

/// When the rows of positions and torques, N x n, that were read at times `t` \[s\] were sent; `None` where the stamps are the arm's, or nothing tells.
pub fn sent(t: &[f64], q: &DMatrix<f64>, tau: &DMatrix<f64>) -> Option<Sent> {
    let repeats = repeats(q, tau);
    let steps = t.windows(2).map(|pair| pair[1] - pair[0]);
    let apart = repeats.windows(2).map(|pair| (pair[1] - pair[0]) as f64);
    if repeats.len() < MIN_REPEATS || !is_even(steps) || !is_even(apart) || steps_across(q, &repeats)? > MAX_STEPS {
        return None;
    }
    let distinct = t.len() - repeats.len();
    let step = (t[t.len() - 1] - t[0]) / (distinct - 1) as f64;
    let mut place = -1.0;
    let of_row = |row: usize| match repeats.binary_search(&row) {
        Ok(_) => t[0] + (place + 0.5) * step,
        Err(_) => {
            place += 1.0;
            t[0] + place * step
        }
    };
    Some(Sent { t: (0..t.len()).map(of_row).collect(), step, repeats: repeats.len() })
}

/// Rows of positions and torques, N x n, that repeat the one before.
pub fn repeats(q: &DMatrix<f64>, tau: &DMatrix<f64>) -> Vec<usize> {
    (1..q.nrows()).filter(|&row| q.row(row) == q.row(row - 1) && tau.row(row) == tau.row(row - 1)).collect()
}

/// Whether all are near their median.
fn is_even(values: impl Iterator<Item = f64>) -> bool {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    let median = values.get(values.len() / 2).copied().unwrap_or(0.0);
    median > 0.0 && values.iter().all(|value| (value / median - 1.0).abs() < MAX_UNEVEN_RATIO)
}

/// How many steps the arm has moved from before a repeat to after it: least squares over all joints and repeats. `None` where it stands.
fn steps_across(q: &DMatrix<f64>, repeats: &[usize]) -> Option<f64> {
    let inside = repeats.iter().filter(|&&row| row >= 2 && row + 2 < q.nrows());
    let (mut product, mut square) = (0.0, 0.0);
    for &row in inside {
        let beside = (q.row(row - 1) - q.row(row - 2) + q.row(row + 2) - q.row(row + 1)) / 2.0;
        product += (q.row(row + 1) - q.row(row - 1)).dot(&beside);
        square += beside.norm_squared();
    }
    (square > 0.0).then(|| product / square)
}

#[cfg(test)]
mod tests {
    use super::*;

    const READ_S: f64 = 1.0 / 30.0;

    /// Row k of what `sent_at` says the reader saw at its k-th time: two joints in motion, with noise of the torques.
    fn read(rows: usize, sent_at: impl Fn(usize) -> f64) -> (Vec<f64>, DMatrix<f64>, DMatrix<f64>) {
        let t = (0..rows).map(|k| k as f64 * READ_S).collect();
        let q = DMatrix::from_fn(rows, 2, |k, j| (1.3 * sent_at(k) + j as f64).sin());
        let tau = DMatrix::from_fn(rows, 2, |k, j| (1e4 * sent_at(k) + j as f64).sin());
        (t, q, tau)
    }

    /// The newest of what is sent every 34 ms.
    fn newest(k: usize) -> f64 {
        ((k as f64 * READ_S + 1e-6) / 0.034).floor() * 0.034
    }

    #[test]
    fn what_is_read_faster_than_it_is_sent_has_the_times_of_the_sender() {
        let (t, q, tau) = read(700, newest);
        let Sent { t: sent, step, repeats } = sent(&t, &q, &tau).unwrap();
        assert!(repeats == 14 && (step - 0.034).abs() < 1e-4, "{repeats} {step}");
        let off = |times: &[f64]| times.iter().enumerate().map(|(k, t)| (t - newest(k)).abs()).fold(0.0, f64::max);
        // A repeat is halfway to the next, and the last of all may be up to a step old.
        assert!(off(&t) > 0.03 && off(&sent) < 0.034 / 2.0 + 0.034, "{} {}", off(&t), off(&sent));
        let distinct = (1..700).filter(|k| newest(*k) > newest(k - 1)).map(|k| (sent[k] - newest(k)).abs());
        assert!(distinct.fold(0.0, f64::max) < 0.034);
        assert!(sent.windows(2).all(|pair| pair[0] < pair[1]));
    }

    #[test]
    fn rows_that_were_lost_keep_their_times() {
        // Every fiftieth row is the one before once more, and the arm has moved on.
        let (t, q, tau) = read(700, |k| if k % 50 == 49 { (k - 1) as f64 * READ_S } else { k as f64 * READ_S });
        assert_eq!(sent(&t, &q, &tau), None);
    }

    #[test]
    fn a_few_repeats_or_uneven_ones_tell_nothing() {
        let (t, q, tau) = read(200, newest);
        assert_eq!(sent(&t, &q, &tau), None);
        // The reader waits for a while now and then.
        let (mut t, q, tau) = read(700, newest);
        t.iter_mut().skip(350).for_each(|t| *t += 0.1);
        assert_eq!(sent(&t, &q, &tau), None);
        // Repeats come at random.
        let drawn = |k: usize| {
            (0..=k).filter(|k| (*k as f64 * 0.618_034).fract() * (*k as f64 * 0.414_214).fract() < 0.7).count()
        };
        let (t, q, tau) = read(700, |k| drawn(k) as f64 * READ_S);
        assert_eq!(sent(&t, &q, &tau), None);
        let still = read(700, |_| 1.0);
        assert_eq!(sent(&still.0, &still.1, &still.2), None);
    }
}
