//! Butterworth low-pass as second-order sections, run forward and backward: no phase, any order.
//!
//! One transfer function of order 20 at 2 Hz and 1 kHz is beyond double precision; a cascade of second-order sections is not.

use super::SignalError;
use super::spectral::Spectral;
use nalgebra::DMatrix;
use std::f64::consts::PI;

/// Padding in time constants of the filter's slowest mode (`exp(-20) = 2e-9`).
const SETTLING_TIME_CONSTANTS: f64 = 20.0;

/// `y = b0 (x + 2 x_1 + x_2) - a1 y_1 - a2 y_2`, unit gain at 0 Hz.
#[derive(Clone, Copy, Debug)]
struct Section {
    b0: f64,
    a1: f64,
    a2: f64,
}

/// A low-pass with `|H(f)|^2 = 1 / (1 + (w / wc)^(2 order))`, `w = tan(pi f / rate)` (bilinear, prewarped).
#[derive(Clone, Debug)]
pub struct Butterworth {
    sections: Vec<Section>,
    order: usize,
    cutoff: f64,
    rate: f64,
}

impl Section {
    /// Section `i` of `order / 2`.
    fn new(i: usize, order: usize, cutoff: f64, rate: f64) -> Section {
        let k = (PI * cutoff / rate).tan();
        let damping = 2.0 * (PI * (2 * i + 1) as f64 / (2 * order) as f64).sin();
        let scale = 1.0 / (1.0 + damping * k + k * k);
        Section { b0: k * k * scale, a1: 2.0 * (k * k - 1.0) * scale, a2: (1.0 - damping * k + k * k) * scale }
    }
}

fn check_cutoff(cutoff: f64, rate: f64) -> Result<(), SignalError> {
    if cutoff > 0.0 && cutoff < rate / 2.0 { Ok(()) } else { Err(SignalError::Cutoff { cutoff, nyquist: rate / 2.0 }) }
}

impl Butterworth {
    /// A low-pass of even `order` with its half-power frequency at `cutoff` \[Hz\] for signals sampled at `rate` \[Hz\].
    pub fn new(order: usize, cutoff: f64, rate: f64) -> Result<Butterworth, SignalError> {
        if !(2..=40).contains(&order) || order % 2 == 1 {
            return Err(SignalError::Order { order });
        }
        check_cutoff(cutoff, rate)?;
        let sections = (0..order / 2).map(|i| Section::new(i, order, cutoff, rate)).collect();
        Ok(Butterworth { sections, order, cutoff, rate })
    }

    /// `[b0, a1, a2]` of the low-pass of second order, as [`Butterworth::coefficients`]. Does not allocate.
    pub fn second_order(cutoff: f64, rate: f64) -> Result<[f64; 3], SignalError> {
        check_cutoff(cutoff, rate)?;
        let Section { b0, a1, a2 } = Section::new(0, 2, cutoff, rate);
        Ok([b0, a1, a2])
    }

    /// `[b0, a1, a2]` of its second-order sections, `y = b0 (x + 2 x_1 + x_2) - a1 y_1 - a2 y_2`, for a forward-only filter.
    pub fn coefficients(&self) -> impl Iterator<Item = [f64; 3]> + '_ {
        self.sections.iter().map(|section| [section.b0, section.a1, section.a2])
    }

    /// Gain of the forward and backward run at `f` \[Hz\]: `|H(f)|^2`, one half at the cut-off.
    pub fn zero_phase_gain(&self, f: f64) -> f64 {
        let ratio = (PI * f / self.rate).tan() / (PI * self.cutoff / self.rate).tan();
        1.0 / (1.0 + ratio.abs().powi(2 * self.order as i32))
    }

    /// Settling time of the filter \[s\]: the padding of [`Butterworth::zero_phase`].
    pub fn settling(&self) -> f64 {
        SETTLING_TIME_CONSTANTS / (2.0 * PI * self.cutoff * (PI / (2 * self.order) as f64).sin())
    }

    /// Filters a record forward and backward. Both ends are continued by their odd reflection for [`Butterworth::settling`] (at
    /// most the record's own length), so that neither a value nor a slope at an end causes a transient.
    pub fn zero_phase(&self, x: &[f64]) -> Vec<f64> {
        let n = x.len();
        if n < 2 {
            return x.to_vec();
        }
        let pad = ((self.settling() * self.rate).ceil() as usize).min(n - 1);
        let mut y = Vec::with_capacity(n + 2 * pad);
        y.extend((1..=pad).rev().map(|i| 2.0 * x[0] - x[i]));
        y.extend_from_slice(x);
        y.extend((1..=pad).map(|i| 2.0 * x[n - 1] - x[n - 1 - i]));
        self.forward(&mut y);
        y.reverse();
        self.forward(&mut y);
        y.reverse();
        y.drain(..pad);
        y.truncate(n);
        y
    }

    /// Filters one period of an infinite periodic signal exactly: the gain is applied to its spectrum.
    pub fn zero_phase_periodic(&self, spectral: &mut Spectral, x: &[f64]) -> Vec<f64> {
        spectral.filter(x, |f| self.zero_phase_gain(f))
    }

    /// [`Butterworth::zero_phase_periodic`] of every column of a period.
    pub fn zero_phase_periods(&self, x: &DMatrix<f64>) -> DMatrix<f64> {
        let mut spectral = Spectral::new(x.nrows(), 1.0 / self.rate);
        let mut out = x.clone();
        for mut column in out.column_iter_mut() {
            let smooth = self.zero_phase_periodic(&mut spectral, column.as_slice());
            column.copy_from_slice(&smooth);
        }
        out
    }

    /// Forward filter in place, initialised in steady state at the first value.
    fn forward(&self, y: &mut [f64]) {
        for s in &self.sections {
            let start = y[0];
            let mut z2 = (s.b0 - s.a2) * start;
            let mut z1 = (2.0 * s.b0 - s.a1) * start + z2;
            for value in y.iter_mut() {
                let x = *value;
                let out = s.b0 * x + z1;
                z1 = 2.0 * s.b0 * x - s.a1 * out + z2;
                z2 = s.b0 * x - s.a2 * out;
                *value = out;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sine(f: f64, rate: f64, n: usize) -> Vec<f64> {
        (0..n).map(|k| (2.0 * PI * f * k as f64 / rate).sin()).collect()
    }

    #[test]
    fn forward_backward_has_the_analytic_gain_and_no_phase() {
        for (order, cutoff, f) in [(2, 5.0, 5.0), (4, 10.0, 3.0), (8, 5.0, 5.2), (20, 2.0, 1.8), (20, 2.0, 2.0)] {
            let filter = Butterworth::new(order, cutoff, 1000.0).unwrap();
            let x = sine(f, 1000.0, 60_000);
            let y = filter.zero_phase(&x);
            let worst = (20_000..40_000).map(|k| (y[k] - filter.zero_phase_gain(f) * x[k]).abs()).fold(0.0, f64::max);
            assert!(worst < 1e-9, "order {order}, {cutoff} Hz, at {f} Hz: {worst:e}");
        }
    }

    #[test]
    fn half_power_lies_at_the_cutoff() {
        let filter = Butterworth::new(8, 7.0, 500.0).unwrap();
        assert!((filter.zero_phase_gain(7.0) - 0.5).abs() < 1e-12);
        assert!((filter.zero_phase_gain(0.0) - 1.0).abs() < 1e-15);
    }

    #[test]
    fn periodic_filter_agrees_with_the_recursive_one_on_many_periods() {
        let filter = Butterworth::new(6, 4.0, 200.0).unwrap();
        let period: Vec<f64> =
            (0..400).map(|k| if (100..260).contains(&k) { 1.0 } else { -0.3 } + 0.001 * k as f64).collect();
        let long: Vec<f64> = period.iter().cycle().take(400 * 9).copied().collect();
        let recursive = filter.zero_phase(&long);
        let exact = filter.zero_phase_periodic(&mut Spectral::new(400, 1.0 / 200.0), &period);
        let worst = (0..400).map(|k| (recursive[1600 + k] - exact[k]).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-8, "{worst:e}");
    }

    #[test]
    fn a_ramp_passes_unchanged_to_its_very_ends() {
        let filter = Butterworth::new(4, 3.0, 100.0).unwrap();
        let x: Vec<f64> = (0..3000).map(|k| 2.0 - 0.01 * k as f64).collect();
        let y = filter.zero_phase(&x);
        let worst = x.iter().zip(&y).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(worst < 1e-7, "{worst:e}");
    }

    #[test]
    fn invalid_orders_and_cutoffs_are_errors() {
        assert_eq!(Butterworth::new(3, 1.0, 10.0).unwrap_err(), SignalError::Order { order: 3 });
        assert_eq!(Butterworth::new(4, 5.0, 10.0).unwrap_err(), SignalError::Cutoff { cutoff: 5.0, nyquist: 5.0 });
        assert!(Butterworth::new(4, f64::NAN, 10.0).is_err());
    }
}
