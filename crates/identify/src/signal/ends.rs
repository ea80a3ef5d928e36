//! Treatment of the ends of an aperiodic record.
//!
//! A zero-phase filter must extrapolate a record past its ends. The odd reflection continues value and slope but inverts the
//! curvature, which causes errors in the second derivative. A polynomial with the record's value, slope and curvature at both ends is
//! subtracted first. Butterworth filters pass it unchanged, its derivatives are known, and the remainder has zero value, slope and curvature at
//! its ends.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Degree of the local polynomial that finds slope and curvature at an end.
const LOCAL_DEGREE: usize = 4;

/// A quintic over a record, in time from its start \[s\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quintic([f64; 6]);

impl Quintic {
    /// The quintic with the value, slope and curvature of `x` (samples `dt` apart \[s\]) at both of its ends, which are those of local
    /// polynomials through the first and last `window` \[s\]. The whole record when that is shorter; at least 8 samples are needed.
    pub fn through_ends(x: &[f64], dt: f64, window: f64) -> Quintic {
        let n = x.len();
        assert!(n >= 8, "{n} samples, expected at least 8");
        let count = ((window / dt).round() as usize + 1).clamp(8, n);
        let span = (n - 1) as f64 * dt;
        let start = end_point(x[..count].iter().copied(), dt);
        let [value, slope, curvature] = end_point(x[n - count..].iter().rev().copied(), dt);
        let [c0, c1, c2] = [start[0], start[1], 0.5 * start[2]];
        // Contribution of the last three coefficients at the end (slope negated: that end was fitted backwards).
        let missing = Vector3::new(
            value - (c0 + c1 * span + c2 * span * span),
            (-slope - c1 - 2.0 * c2 * span) * span,
            (curvature - 2.0 * c2) * span * span,
        );
        let inverse = Matrix3::new(10.0, -4.0, 0.5, -15.0, 7.0, -1.0, 6.0, -3.0, 0.5);
        let c = inverse * missing;
        Quintic([c0, c1, c2, c[0] / span.powi(3), c[1] / span.powi(4), c[2] / span.powi(5)])
    }

    /// Value, first and second derivative at time `t` \[s\].
    pub fn at(&self, t: f64) -> [f64; 3] {
        let c = &self.0;
        let (mut value, mut first, mut second) = (0.0, 0.0, 0.0);
        for &coefficient in c.iter().rev() {
            second = second * t + 2.0 * first;
            first = first * t + value;
            value = value * t + coefficient;
        }
        [value, first, second]
    }
}

/// Value, slope and curvature at the first of some samples, from the polynomial through them by least squares.
fn end_point(samples: impl Iterator<Item = f64>, dt: f64) -> [f64; 3] {
    let x: DVector<f64> = DVector::from_vec(samples.collect());
    let span = (x.len() - 1) as f64;
    let powers = DMatrix::from_fn(x.len(), LOCAL_DEGREE + 1, |k, p| (k as f64 / span).powi(p as i32));
    let qr = powers.qr();
    let c = qr.r().solve_upper_triangular(&(qr.q().transpose() * x)).expect("distinct times");
    let width = span * dt;
    [c[0], c[1] / width, 2.0 * c[2] / (width * width)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_polynomial_has_the_record_s_derivatives_at_both_ends() {
        let dt = 0.002;
        let f = |t: f64| 0.7 * (2.3 * t + 0.4).sin() + 0.2 * (5.0 * t).cos();
        let x: Vec<f64> = (0..4001).map(|k| f(k as f64 * dt)).collect();
        let quintic = Quintic::through_ends(&x, dt, 0.3);
        for (t, outward) in [(0.0, 1.0), (8.0, -1.0)] {
            let [value, first, second] = quintic.at(t);
            let h = 1e-4 * outward;
            assert!((value - f(t)).abs() < 1e-4, "{value} {}", f(t));
            assert!((first - (f(t + h) - f(t - h)) / (2.0 * h)).abs() < 5e-3, "{first}");
            assert!((second - (f(t + h) - 2.0 * f(t) + f(t - h)) / (h * h)).abs() < 0.44, "{second}");
        }
    }

    #[test]
    fn a_polynomial_is_reproduced() {
        let f = |t: f64| 1.0 - 2.0 * t + 0.5 * t * t + 0.3 * t * t * t - 0.1 * t.powi(4);
        let x: Vec<f64> = (0..101).map(|k| f(k as f64 * 0.01)).collect();
        let quintic = Quintic::through_ends(&x, 0.01, 0.5);
        for (k, x) in x.iter().enumerate() {
            assert!((quintic.at(k as f64 * 0.01)[0] - x).abs() < 1e-9);
        }
        let [_, first, second] = quintic.at(0.5);
        assert!((first - (-2.0 + 0.5 + 0.225 - 0.05)).abs() < 1e-8 && (second - (1.0 + 0.9 - 0.3)).abs() < 1e-7);
    }
}
