//! Periodic motions as finite Fourier series, paper eq. 12.

use super::ExciteError;
use nalgebra::DMatrix;
use plumbline_core::{JointVec, MAX_JOINTS, Reference, Setpoint};
use std::f64::consts::PI;
use std::num::NonZeroU64;

/// Maximum number of harmonics of a [`PeriodicMotion`].
pub const MAX_HARMONICS: usize = 16;
/// Sampling rate of a motion in the loop \[Hz\].
const TICK_RATE_HZ: f64 = 1000.0;

/// `q_i(t) = q0_i + sum_k a_ik sin(k w t) + b_ik cos(k w t)`, `w = 2 pi / period`, k = 1..N (paper eq. 12).
#[derive(Clone, Debug, PartialEq)]
pub struct Fourier {
    /// Period, T \[s\].
    pub period: f64,
    /// Position at the start and the end of every period once the boundary conditions hold, n \[rad\].
    pub q0: Vec<f64>,
    /// Sine amplitudes, n x N \[rad\].
    pub a: DMatrix<f64>,
    /// Cosine amplitudes, n x N \[rad\].
    pub b: DMatrix<f64>,
}

/// Position and its derivatives of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Point {
    /// Position \[rad\].
    pub q: f64,
    /// Velocity \[rad/s\].
    pub dq: f64,
    /// Acceleration \[rad/s2\].
    pub ddq: f64,
    /// Jerk \[rad/s3\].
    pub jerk: f64,
}

impl Fourier {
    /// A motion from checked shapes and numbers: `a` and `b` are n x N with n = `q0.len()` and N from 1 to [`MAX_HARMONICS`], all finite.
    pub fn new(period: f64, q0: Vec<f64>, a: DMatrix<f64>, b: DMatrix<f64>) -> Result<Fourier, ExciteError> {
        if !(period > 0.0 && period.is_finite()) {
            return Err(ExciteError::Period { period });
        }
        let (n, harmonics) = (q0.len(), a.ncols());
        if n == 0
            || n > MAX_JOINTS
            || a.shape() != b.shape()
            || a.nrows() != n
            || !(1..=MAX_HARMONICS).contains(&harmonics)
        {
            return Err(ExciteError::Shape { q0: n, a: a.shape(), b: b.shape() });
        }
        if let Some(&value) = q0.iter().chain(a.iter()).chain(b.iter()).find(|value| !value.is_finite()) {
            return Err(ExciteError::NotFinite { value });
        }
        Ok(Fourier { period, q0, a, b })
    }

    /// A constant position `q0`.
    pub fn still(period: f64, q0: Vec<f64>, harmonics: usize) -> Result<Fourier, ExciteError> {
        let zero = DMatrix::zeros(q0.len(), harmonics);
        Fourier::new(period, q0, zero.clone(), zero)
    }

    /// Number of joints, n.
    pub fn joints(&self) -> usize {
        self.q0.len()
    }

    /// Number of harmonics, N.
    pub fn harmonics(&self) -> usize {
        self.a.ncols()
    }

    /// Fundamental angular frequency `w = 2 pi / T` \[rad/s\].
    pub fn omega(&self) -> f64 {
        2.0 * PI / self.period
    }

    /// Position of a joint (from 0) at time `t` \[s\] with exact derivatives.
    pub fn at(&self, joint: usize, t: f64) -> Point {
        let mut point = Point { q: self.q0[joint], ..Point::default() };
        for k in 0..self.harmonics() {
            let kw = (k + 1) as f64 * self.omega();
            let (sin, cos) = (kw * t).sin_cos();
            let (a, b) = (self.a[(joint, k)], self.b[(joint, k)]);
            let (even, odd) = (a * sin + b * cos, a * cos - b * sin);
            point.q += even;
            point.dq += kw * odd;
            point.ddq -= kw * kw * even;
            point.jerk -= kw * kw * kw * odd;
        }
        point
    }

    /// Violation of the boundary conditions: the largest offset from `q0` \[rad\], speed \[rad/s\] and acceleration \[rad/s2\]
    /// at t = 0 over all joints.
    pub fn boundary_error(&self) -> [f64; 3] {
        (0..self.joints()).fold([0.0; 3], |worst: [f64; 3], joint| {
            let start = self.at(joint, 0.0);
            [
                worst[0].max((start.q - self.q0[joint]).abs()),
                worst[1].max(start.dq.abs()),
                worst[2].max(start.ddq.abs()),
            ]
        })
    }

    /// Projects the amplitudes onto those that start and end at rest at `q0`:
    /// `sum_k k a_k = 0`, `sum_k b_k = 0`, `sum_k k^2 b_k = 0`.
    ///
    /// The paper prints `sum_k a_k = 0` (eq. 13), which does not make the velocity zero at t = 0; these three do.
    pub fn project(&mut self) {
        let harmonics = self.harmonics();
        let power = |p: i32| (1..=harmonics).map(move |k| (k as f64).powi(p));
        let speed = orthonormal(vec![power(1).collect()]);
        let rest = orthonormal(vec![power(0).collect(), power(2).collect()]);
        for joint in 0..self.joints() {
            for (amplitudes, conditions) in [(&mut self.a, &speed), (&mut self.b, &rest)] {
                // Twice, to remove the rounding error of the first projection.
                for _ in 0..2 {
                    for condition in conditions {
                        let along: f64 = (0..harmonics).map(|k| amplitudes[(joint, k)] * condition[k]).sum();
                        for k in 0..harmonics {
                            amplitudes[(joint, k)] -= along * condition[k];
                        }
                    }
                }
            }
        }
    }

    /// Scales all amplitudes of one joint; the boundary conditions still hold.
    pub fn scale_joint(&mut self, joint: usize, factor: f64) {
        self.a.row_mut(joint).scale_mut(factor);
        self.b.row_mut(joint).scale_mut(factor);
    }
}

/// Orthonormal basis of the span of the rows (Gram-Schmidt); linearly dependent rows are left out.
pub(super) fn orthonormal(rows: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let mut basis: Vec<Vec<f64>> = Vec::new();
    for mut row in rows {
        let before: f64 = row.iter().map(|x| x * x).sum();
        for q in &basis {
            let along: f64 = row.iter().zip(q).map(|(x, y)| x * y).sum();
            row.iter_mut().zip(q).for_each(|(x, y)| *x -= along * y);
        }
        let norm = row.iter().map(|x| x * x).sum::<f64>().sqrt();
        if norm * norm > 1e-20 * before {
            basis.push(row.iter().map(|x| x / norm).collect());
        }
    }
    basis
}

/// Fourier motion of several periods for the real-time loop, one sample per ms.
///
/// `at` allocates nothing, and every period has bitwise equal samples.
#[derive(Clone, Debug)]
pub struct PeriodicMotion {
    q0: JointVec,
    a: [[f64; MAX_HARMONICS]; MAX_JOINTS],
    b: [[f64; MAX_HARMONICS]; MAX_JOINTS],
    joints: usize,
    harmonics: usize,
    omega: f64,
    period_ticks: NonZeroU64,
    ticks: u64,
}

impl PeriodicMotion {
    /// A motion of `periods` (at least 1) periods.
    ///
    /// # Errors
    /// A period that is not a whole number of ms, no period, or amplitudes that do not start at rest within 1e-6 rad, rad/s and rad/s2.
    pub fn new(fourier: &Fourier, periods: u32) -> Result<PeriodicMotion, ExciteError> {
        let period_ticks = (fourier.period * TICK_RATE_HZ).round();
        let whole = (period_ticks / TICK_RATE_HZ - fourier.period).abs() <= 1e-9;
        let Some(period_ticks) = NonZeroU64::new(period_ticks as u64).filter(|_| whole && periods > 0) else {
            return Err(ExciteError::Ticks { period: fourier.period, periods });
        };
        let error = fourier.boundary_error();
        if error.iter().any(|&e| e > 1e-6) {
            return Err(ExciteError::Boundary { error });
        }
        let mut motion = PeriodicMotion {
            q0: [0.0; MAX_JOINTS],
            a: [[0.0; MAX_HARMONICS]; MAX_JOINTS],
            b: [[0.0; MAX_HARMONICS]; MAX_JOINTS],
            joints: fourier.joints(),
            harmonics: fourier.harmonics(),
            omega: fourier.omega(),
            period_ticks,
            ticks: period_ticks.get() * u64::from(periods) + 1,
        };
        for joint in 0..motion.joints {
            motion.q0[joint] = fourier.q0[joint];
            for k in 0..motion.harmonics {
                motion.a[joint][k] = fourier.a[(joint, k)];
                motion.b[joint][k] = fourier.b[(joint, k)];
            }
        }
        Ok(motion)
    }

    /// Samples of one period.
    pub fn period_ticks(&self) -> u64 {
        self.period_ticks.get()
    }
}

impl Reference for PeriodicMotion {
    fn ticks(&self) -> u64 {
        self.ticks
    }

    /// After the last sample the motion stays at its last setpoint.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn at(&self, tick: u64) -> Setpoint {
        let phase = tick.min(self.ticks.saturating_sub(1)) % self.period_ticks;
        let angle = self.omega * (phase as f64 / TICK_RATE_HZ);
        let mut point = Setpoint { q: self.q0, ..Setpoint::default() };
        // The constant bounds let the compiler remove the index checks.
        for k in 0..self.harmonics.min(MAX_HARMONICS) {
            let order = (k + 1) as f64;
            let kw = order * self.omega;
            let (sin, cos) = (order * angle).sin_cos();
            for joint in 0..self.joints.min(MAX_JOINTS) {
                let (a, b) = (self.a[joint][k], self.b[joint][k]);
                let even = a * sin + b * cos;
                point.q[joint] += even;
                point.dq[joint] += kw * (a * cos - b * sin);
                point.ddq[joint] -= kw * kw * even;
            }
        }
        point
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn random(seed: u64, harmonics: usize) -> Fourier {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut draw = |rows, columns| DMatrix::from_fn(rows, columns, |_, _| rng.random_range(-0.5..0.5));
        let (a, b) = (draw(3, harmonics), draw(3, harmonics));
        Fourier::new(4.0, vec![0.1, -0.2, 0.3], a, b).unwrap()
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let f = random(1, 5);
        let h = 1e-5;
        for t in [0.0, 0.7, 3.1] {
            let (before, now, after) = (f.at(1, t - h), f.at(1, t), f.at(1, t + h));
            assert!(((after.q - before.q) / (2.0 * h) - now.dq).abs() < 1e-8);
            assert!(((after.dq - before.dq) / (2.0 * h) - now.ddq).abs() < 1e-7);
            assert!(((after.ddq - before.ddq) / (2.0 * h) - now.jerk).abs() < 1e-6);
        }
    }

    #[test]
    fn projected_motions_start_and_end_at_rest() {
        for harmonics in 1..=MAX_HARMONICS {
            let mut f = random(harmonics as u64, harmonics);
            assert!(f.boundary_error().iter().all(|&e| e > 1e-3));
            f.project();
            assert!(f.boundary_error().iter().all(|&e| e < 1e-10), "{harmonics}: {:?}", f.boundary_error());
            let once = f.clone();
            f.project();
            assert!((f.a - once.a).abs().max() < 1e-14 && (f.b - once.b).abs().max() < 1e-14);
        }
    }

    #[test]
    fn the_printed_boundary_condition_of_eq_13_leaves_a_velocity() {
        // sum_k a_k = 0, as printed, leaves a velocity at t = 0.
        let mut f = Fourier::still(10.0, vec![0.0], 5).unwrap();
        f.a.set_row(0, &nalgebra::RowDVector::from_vec(vec![1.0, -0.5, -0.5, 0.25, -0.25]));
        assert!(f.a.row(0).sum().abs() < 1e-15);
        assert!(f.boundary_error()[1] > 0.5);
    }

    #[test]
    fn the_reference_is_the_series_and_ends_at_rest() {
        let mut f = random(9, 5);
        f.project();
        let motion = PeriodicMotion::new(&f, 3).unwrap();
        assert_eq!((motion.period_ticks(), motion.ticks()), (4000, 12001));
        for tick in [0, 1, 1234, 3999, 4000, 11999] {
            let point = motion.at(tick);
            for joint in 0..3 {
                let exact = f.at(joint, tick as f64 * 1e-3);
                assert!((point.q[joint] - exact.q).abs() < 1e-12);
                assert!((point.dq[joint] - exact.dq).abs() < 1e-12);
                assert!((point.ddq[joint] - exact.ddq).abs() < 1e-11);
            }
        }
        assert_eq!(motion.at(777), motion.at(777 + 8000));
        let end = motion.at(12000);
        assert!(end.dq.iter().chain(&end.ddq).all(|v| v.abs() < 1e-10));
        assert_eq!(end, motion.at(u64::MAX));
    }

    #[test]
    fn invalid_motions_are_errors() {
        let mut f = random(2, 5);
        assert!(matches!(PeriodicMotion::new(&f, 1), Err(ExciteError::Boundary { .. })));
        f.project();
        f.period = 4.00005;
        assert!(matches!(PeriodicMotion::new(&f, 1), Err(ExciteError::Ticks { .. })));
        f.a[(0, 0)] = f64::NAN;
        assert!(matches!(Fourier::new(4.0, f.q0, f.a, f.b), Err(ExciteError::NotFinite { .. })));
    }
}
