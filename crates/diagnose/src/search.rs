//! Searches for the settings of an effect: the largest value of a function of a few variables, each within `0 ..= 1`.

/// Places on each side that [`beside`] tries.
const PLACES_BESIDE: i32 = 4;
/// Evaluations of [`golden`]
const MAX_LINE_EVALUATIONS: usize = 12;
/// and most of [`simplex`].
const MAX_SIMPLEX_EVALUATIONS: usize = 120;
/// When a simplex has settled.
#[derive(Clone, Copy)]
pub struct Settled {
    /// The values of its corners, scores of effects, differ by less than this,
    score: f64,
    /// or than this share of the best,
    ratio: f64,
    /// and none is farther from the best than this.
    share: f64,
}

/// Where the settings decide.
pub const FINE: Settled = Settled { score: 0.1, ratio: 0.0, share: 0.02 };
/// Where it is enough to know which effects come into question.
pub const COARSE: Settled = Settled { score: 0.1, ratio: 0.02, share: 0.1 };
/// Sides of the first simplex, as a share of the distance to the next place that a search starts from: what several settings decide together may
/// be a ridge, narrow against that.
const SIMPLEX_SIDE_RATIO: f64 = 0.2;

/// Where `at` is largest near `start`, no farther than about `steps`.
pub fn largest(start: &[f64], steps: &[f64], settled: Settled, at: &dyn Fn(&[f64]) -> f64) -> Vec<f64> {
    match (start, steps) {
        (&[start], &[step]) => {
            vec![golden((start - step).max(0.0), (start + step).min(1.0), &|x| at(&[x]))]
        }
        _ => simplex(start, steps, settled, at),
    }
}

/// The place with the largest value of `start`, which has `value`, and of some whose first variable is less than `step` away, and its value: where to begin if
/// maxima are narrower than that. A link crosses a gap at another time where the gap is another, and a quarter more of it is no maximum any more.
pub fn beside(start: Vec<f64>, value: f64, step: f64, at: &dyn Fn(&[f64]) -> f64) -> (Vec<f64>, f64) {
    let place = |k: i32| start[0] + step * f64::from(k) / f64::from(PLACES_BESIDE + 1);
    let places = (-PLACES_BESIDE..=PLACES_BESIDE).filter(|k| *k != 0).map(place);
    let moved = |place: f64| [&[place], &start[1..]].concat();
    let tried = places.filter(|place| (0.0..=1.0).contains(place)).map(moved).map(|x| (at(&x), x)).collect::<Vec<_>>();
    let larger = |best: (Vec<f64>, f64), (own, x): (f64, Vec<f64>)| if own > best.1 { (x, own) } else { best };
    tried.into_iter().fold((start, value), larger)
}

/// Golden-section search between two places.
fn golden(mut low: f64, mut high: f64, at: &dyn Fn(f64) -> f64) -> f64 {
    let ratio = (5.0_f64.sqrt() - 1.0) / 2.0;
    let (mut left, mut right) = (high - ratio * (high - low), low + ratio * (high - low));
    let (mut at_left, mut at_right) = (at(left), at(right));
    for _ in 2..MAX_LINE_EVALUATIONS {
        if at_left > at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - ratio * (high - low);
            at_left = at(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + ratio * (high - low);
            at_right = at(right);
        }
    }
    if at_left > at_right { left } else { right }
}

/// The simplex method of Nelder and Mead (Computer Journal 7, 1965), with corners outside put on the border.
fn simplex(start: &[f64], steps: &[f64], settled: Settled, at: &dyn Fn(&[f64]) -> f64) -> Vec<f64> {
    let n = start.len();
    let corner = |x: Vec<f64>| {
        let x: Vec<f64> = x.into_iter().map(|x| x.clamp(0.0, 1.0)).collect();
        (at(&x), x)
    };
    let mut corners = vec![corner(start.to_vec())];
    for (k, step) in steps.iter().enumerate() {
        let mut x = start.to_vec();
        x[k] += if x[k] + SIMPLEX_SIDE_RATIO * step <= 1.0 {
            SIMPLEX_SIDE_RATIO * step
        } else {
            -SIMPLEX_SIDE_RATIO * step
        };
        corners.push(corner(x));
    }
    let mut evaluations = n + 1;
    while evaluations < MAX_SIMPLEX_EVALUATIONS {
        corners.sort_by(|a, b| b.0.total_cmp(&a.0));
        let far =
            |(_, x): &(f64, Vec<f64>)| x.iter().zip(&corners[0].1).any(|(x, best)| (x - best).abs() > settled.share);
        let level = settled.score.max(settled.ratio * corners[0].0);
        if corners[0].0 - corners[n].0 < level && !corners.iter().any(far) {
            break;
        }
        let (worst, others) = (corners[n].clone(), &corners[..n]);
        let middle: Vec<f64> = (0..n).map(|k| others.iter().map(|(_, x)| x[k]).sum::<f64>() / n as f64).collect();
        // From the worst corner through the middle of the others: 1 is its mirror image.
        let through =
            |t: f64| corner(middle.iter().zip(&worst.1).map(|(middle, x)| middle + t * (middle - x)).collect());
        let mirrored = through(1.0);
        evaluations += 1;
        let better = if mirrored.0 > corners[0].0 {
            evaluations += 1;
            let farther = through(2.0);
            if farther.0 > mirrored.0 { farther } else { mirrored }
        } else if mirrored.0 > corners[n - 1].0 {
            mirrored
        } else {
            evaluations += 1;
            through(if mirrored.0 > worst.0 { 0.5 } else { -0.5 })
        };
        if better.0 > worst.0 {
            corners[n] = better;
            continue;
        }
        let best = corners[0].1.clone();
        for (value, x) in &mut corners[1..] {
            let nearer = x.iter().zip(&best).map(|(x, best)| 0.5 * (x + best)).collect();
            (*value, *x) = corner(nearer);
            evaluations += 1;
        }
    }
    let best = corners.into_iter().max_by(|a, b| a.0.total_cmp(&b.0));
    best.map_or_else(|| start.to_vec(), |(_, x)| x)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_hill_is_climbed_on_a_line() {
        let found = largest(&[0.4], &[0.25], FINE, &|x| -(x[0] - 0.53).powi(2));
        assert!((found[0] - 0.53).abs() < 0.01, "{found:?}");
        let border = largest(&[0.1], &[0.5], FINE, &|x| -x[0]);
        assert!(border[0] < 0.01, "{border:?}");
    }

    #[test]
    fn a_hill_between_two_starts_is_found_and_what_is_no_higher_is_none() {
        let hill = |x: &[f64]| (-((x[0] - 0.63) / 0.05).powi(2)).exp() - x[1];
        let (found, value) = beside(vec![0.4, 0.2], hill(&[0.4, 0.2]), 0.3, &hill);
        assert!((found[0] - 0.64).abs() < 1e-12 && found[1] == 0.2 && value == hill(&found), "{found:?} {value}");
        assert_eq!(beside(vec![0.63, 0.2], 0.8, 0.3, &hill), (vec![0.63, 0.2], 0.8));
        // The next start is a step away and not tried here, and nothing outside is.
        let outside = |x: &[f64]| {
            assert!((0.0..=1.0).contains(&x[0]), "{x:?}");
            -x[0]
        };
        assert!((beside(vec![0.25], -0.25, 0.25, &outside).0[0] - 0.05).abs() < 1e-12);
        assert_eq!(beside(vec![0.0], 0.0, 0.25, &outside).0, [0.0]);
    }

    #[test]
    fn a_narrow_ridge_is_followed_to_its_top() {
        // Ten times as steep across as along it, with its top at (0.6, 0.5, 0.8).
        let ridge = |x: &[f64]| {
            let (across, along) = (x[0] - 0.6 - (x[1] - 0.5), x[0] - 0.6 + (x[1] - 0.5));
            -100.0 * across * across - along * along - (x[2] - 0.8).powi(2)
        };
        let score = |x: &[f64]| 1000.0 * ridge(x);
        let found = largest(&[0.4, 0.33, 0.0], &[0.5, 0.33, 1.0], FINE, &score);
        assert!(ridge(&found) > -1e-3, "{found:?}");
    }

    #[test]
    fn a_search_ends_where_it_has_settled() {
        let count = std::cell::Cell::new(0);
        let hill = |x: &[f64]| {
            count.set(count.get() + 1);
            1000.0 - 500.0 * x.iter().map(|x| (x - 0.5).powi(2)).sum::<f64>()
        };
        let lacks = |settled: Settled| 1000.0 - hill(&largest(&[0.45, 0.4], &[0.5, 0.5], settled, &hill));
        let (fine, evaluations) = (lacks(FINE), count.take());
        assert!(fine < 2.0 * FINE.score && evaluations < MAX_SIMPLEX_EVALUATIONS / 2, "{fine}, {evaluations}");
        let (coarse, fewer) = (lacks(COARSE), count.take());
        assert!(coarse < 2.0 * COARSE.ratio * 1000.0 && 2 * fewer < evaluations, "{coarse}, {fewer} of {evaluations}");
    }

    #[test]
    fn nothing_outside_is_looked_at() {
        let inside = |x: &[f64]| {
            assert!(x.iter().all(|x| (0.0..=1.0).contains(x)), "{x:?}");
            1000.0 * (x[0] + x[1])
        };
        let found = largest(&[1.0, 0.9], &[0.5, 0.5], FINE, &inside);
        assert!(found[0] + found[1] > 1.95, "{found:?}");
    }
}
