//! Central differences for aperiodic records.
//!
//! The paper differentiates filtered positions by central differences. The stencil here is the nine-point one (error of
//! order `dt^8`): with the three-point one a 2 Hz motion sampled at 100 Hz loses 0.3 % of its velocity.

/// Weights of `x[k+i] - x[k-i]`, i = 1.., for half widths 1 to 4.
const FIRST: [&[f64]; 4] =
    [&[0.5], &[2.0 / 3.0, -1.0 / 12.0], &[0.75, -0.15, 1.0 / 60.0], &[0.8, -0.2, 4.0 / 105.0, -1.0 / 280.0]];
/// Weights of `x[k+i] - 2 x[k] + x[k-i]`, i = 1.., for half widths 1 to 4.
const SECOND: [&[f64]; 4] =
    [&[1.0], &[4.0 / 3.0, -1.0 / 12.0], &[1.5, -0.15, 1.0 / 90.0], &[1.6, -0.2, 8.0 / 315.0, -1.0 / 560.0]];

/// First and second derivative of a signal sampled every `dt` \[s\].
///
/// A periodic signal wraps around. Otherwise the stencil narrows towards the ends, and an end takes the value of its
/// neighbour; both are in the part of a record that is cut off after filtering. Needs at least 3 samples (9 when periodic).
pub fn derivatives(x: &[f64], dt: f64, periodic: bool) -> [Vec<f64>; 2] {
    let n = x.len();
    assert!(n >= if periodic { 9 } else { 3 }, "{n} samples are too few for a central difference");
    let mut first = vec![0.0; n];
    let mut second = vec![0.0; n];
    for k in 0..n {
        let half = if periodic { 4 } else { k.min(n - 1 - k).min(4) };
        if half == 0 {
            continue;
        }
        for (i, (&w1, &w2)) in FIRST[half - 1].iter().zip(SECOND[half - 1]).enumerate() {
            let ahead = x[(k + i + 1) % n];
            let behind = x[(k + n - i - 1) % n];
            first[k] += w1 * (ahead - behind);
            second[k] += w2 * ((ahead - x[k]) - (x[k] - behind));
        }
        first[k] /= dt;
        second[k] /= dt * dt;
    }
    if !periodic {
        (first[0], first[n - 1]) = (first[1], first[n - 2]);
        (second[0], second[n - 1]) = (second[1], second[n - 2]);
    }
    [first, second]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_up_to_degree_8_are_exact_in_the_middle() {
        let dt = 0.1;
        let t = |k: usize| (k as f64 - 6.0) * dt;
        let x: Vec<f64> = (0..13).map(|k| t(k).powi(8) - 2.0 * t(k).powi(3) + 0.5 * t(k)).collect();
        let [first, second] = derivatives(&x, dt, false);
        for k in 4..9 {
            let dx = 8.0 * t(k).powi(7) - 6.0 * t(k).powi(2) + 0.5;
            let ddx = 56.0 * t(k).powi(6) - 12.0 * t(k);
            assert!((first[k] - dx).abs() < 1e-12, "{k}: {} {dx}", first[k]);
            assert!((second[k] - ddx).abs() < 1e-10, "{k}: {} {ddx}", second[k]);
        }
    }

    #[test]
    fn a_periodic_signal_wraps_around() {
        let n = 200;
        let w = 2.0 * std::f64::consts::PI / n as f64;
        let x: Vec<f64> = (0..n).map(|k| (3.0 * w * k as f64).sin()).collect();
        let [first, second] = derivatives(&x, 1.0, true);
        for k in 0..n {
            assert!((first[k] - 3.0 * w * (3.0 * w * k as f64).cos()).abs() < 1e-10);
            assert!((second[k] + 9.0 * w * w * x[k]).abs() < 1e-10);
        }
    }
}
