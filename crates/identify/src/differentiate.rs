//! Low-pass filter and differentiation of positions on an even grid.

use super::settings::Derivative;
use super::signal::SignalError;
use super::signal::butterworth::Butterworth;
use super::signal::difference;
use super::signal::ends::Quintic;
use super::signal::spectral::Spectral;
use nalgebra::{DMatrix, Vector3};
use plumbline_model::term::Motion;

/// Time cut off both ends of an aperiodic run, in periods of the position cut-off (at most [`MAX_END_CUTOFF_HZ`]). There the accelerations
/// depend on the extrapolation past the ends.
const EDGE_PERIODS: f64 = 0.5;
/// Length of the window for slope and curvature at the ends, in periods of the same.
const END_WINDOW_PERIODS: f64 = 3.0;
/// Maximum cut-off for the treatment of the ends \[Hz\]: shorter windows would fit the noise.
const MAX_END_CUTOFF_HZ: f64 = 10.0;

/// Zero-phase low-pass and differentiation of the positions of one run. Linear in the positions.
#[derive(Clone, Debug)]
pub struct Differentiator {
    filter: Butterworth,
    cutoff: f64,
    derivative: Derivative,
    periodic: bool,
    dt: f64,
    gravity: Vector3<f64>,
}

impl Differentiator {
    /// A differentiator with a zero-phase low-pass of `order` and `cutoff` \[Hz\] for samples `dt` apart \[s\].
    ///
    /// # Errors
    /// An invalid order or cut-off.
    pub fn new(
        order: usize,
        cutoff: f64,
        derivative: Derivative,
        periodic: bool,
        dt: f64,
        gravity: Vector3<f64>,
    ) -> Result<Differentiator, SignalError> {
        let filter = Butterworth::new(order, cutoff, 1.0 / dt)?;
        Ok(Differentiator { filter, cutoff, derivative, periodic, dt, gravity })
    }

    /// The same for a record that does not repeat.
    pub fn aperiodic(&self) -> Differentiator {
        Differentiator { periodic: false, ..self.clone() }
    }

    /// Samples that are cut off each end.
    pub fn edge(&self) -> usize {
        if self.periodic { 0 } else { (EDGE_PERIODS / (self.dt * self.cutoff.min(MAX_END_CUTOFF_HZ))).ceil() as usize }
    }

    /// Cut-off of the low-pass \[Hz\].
    pub fn cutoff(&self) -> f64 {
        self.cutoff
    }

    /// Every column of a period behind the low-pass of the positions.
    pub fn low_pass(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        self.filter.zero_phase_periods(x)
    }

    /// The motion of positions `q`, N x n \[rad\], without `edge` samples at both ends. Within [`Differentiator::edge`] samples of an end,
    /// the accelerations depend on the extrapolation past that end.
    pub fn motion(&self, q: &DMatrix<f64>, edge: usize) -> Motion {
        let (samples, n) = q.shape();
        assert!(samples > 2 * edge, "{samples} samples are no more than both edges");
        let count = samples - 2 * edge;
        let zeros = || DMatrix::zeros(count, n);
        let (dt, gravity, periodic) = (self.dt, self.gravity, self.periodic);
        let start = edge as f64 * dt;
        let mut motion = Motion { dt, q: zeros(), dq: zeros(), ddq: zeros(), gravity, periodic, start };
        let mut spectral = Spectral::new(samples, dt);
        for j in 0..n {
            let [q, dq, ddq] = self.joint(&mut spectral, q.column(j).as_slice());
            for (target, source) in [(&mut motion.q, q), (&mut motion.dq, dq), (&mut motion.ddq, ddq)] {
                target.column_mut(j).copy_from_slice(&source[edge..edge + count]);
            }
        }
        motion
    }

    fn joint(&self, spectral: &mut Spectral, q: &[f64]) -> [Vec<f64>; 3] {
        match self.derivative {
            Derivative::Spectral if self.periodic => spectral.derivatives(q, |f| self.filter.zero_phase_gain(f)),
            _ if self.periodic => {
                let q = self.filter.zero_phase_periodic(spectral, q);
                let [dq, ddq] = difference::derivatives(&q, self.dt, true);
                [q, dq, ddq]
            }
            _ => self.between_ends(q.to_vec()),
        }
    }

    /// Positions, velocities and accelerations of an aperiodic record.
    fn between_ends(&self, mut q: Vec<f64>) -> [Vec<f64>; 3] {
        let ends = Quintic::through_ends(&q, self.dt, END_WINDOW_PERIODS / self.cutoff.min(MAX_END_CUTOFF_HZ));
        q.iter_mut().enumerate().for_each(|(k, q)| *q -= ends.at(k as f64 * self.dt)[0]);
        let mut q = self.filter.zero_phase(&q);
        let [mut dq, mut ddq] = difference::derivatives(&q, self.dt, false);
        for k in 0..q.len() {
            let [value, first, second] = ends.at(k as f64 * self.dt);
            q[k] += value;
            dq[k] += first;
            ddq[k] += second;
        }
        [q, dq, ddq]
    }
}
