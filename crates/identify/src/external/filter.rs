//! The low-pass of the external torque.

use crate::signal::SignalError;
use crate::signal::butterworth::Butterworth;
use std::f64::consts::{PI, SQRT_2};

/// Settling time in periods of the half-power frequency: the impulse response is then below 2 % of its largest value.
const SETTLING_PERIODS: f64 = 1.2;

/// A Butterworth low-pass `F` of second order (bilinear, prewarped) for `y = F(u) - F(dp/dt)`: the derivative of `p` is never formed.
///
/// With `H = 2/T (1 - z^-1) / (1 + z^-1)`, the bilinear derivative, `F H` has the numerator `2 b0 / T (1 - z^-2)` over the denominator of `F`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residue {
    b0: f64,
    /// `2 b0 / T` \[1/s\].
    d: f64,
    a1: f64,
    a2: f64,
    cutoff: f64,
    dt: f64,
}

/// State of a [`Residue`] of one joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Memory {
    s1: f64,
    s2: f64,
}

impl Residue {
    /// With its half-power frequency at `cutoff` \[Hz\], for samples `dt` apart \[s\].
    ///
    /// # Errors
    /// A cut-off that is not between 0 and half the sampling rate.
    pub fn new(cutoff: f64, dt: f64) -> Result<Residue, SignalError> {
        if !(dt > 0.0 && dt.is_finite()) {
            return Err(SignalError::Step { dt });
        }
        let [b0, a1, a2] = Butterworth::second_order(cutoff, 1.0 / dt)?;
        Ok(Residue { b0, d: 2.0 * b0 / dt, a1, a2, cutoff, dt })
    }

    /// Delay of a slow signal, the group delay at 0 Hz: `sqrt(2) / W`, `W = 2/T tan(pi f_c T)` \[s\].
    pub fn delay(&self) -> f64 {
        SQRT_2 * self.dt / (2.0 * (PI * self.cutoff * self.dt).tan())
    }

    /// Samples after which the response to the first one is below 2 % of its largest value.
    pub fn settling(&self) -> u64 {
        (SETTLING_PERIODS / (self.cutoff * self.dt)).ceil() as u64
    }

    /// The memory after a long rest at `p` with `u = 0`.
    pub fn at_rest(&self, p: f64) -> Memory {
        Memory { s1: self.d * p, s2: self.d * p }
    }

    /// The memory after a long time at `u` with `p = 0`.
    pub fn settled_at(&self, u: f64) -> Memory {
        Memory { s1: (1.0 - self.b0) * u, s2: (self.b0 - self.a2) * u }
    }

    /// The next output.
    pub fn next(&self, memory: &mut Memory, u: f64, p: f64) -> f64 {
        let y = self.b0 * u - self.d * p + memory.s1;
        memory.s1 = 2.0 * self.b0 * u - self.a1 * y + memory.s2;
        memory.s2 = self.b0 * u + self.d * p - self.a2 * y;
        y
    }

    /// `|F|^2 / cos(pi f T)^2`: power of the output over that of `u - dp/dt` in the mean of two samples, at `f` \[Hz\].
    pub fn power_gain(&self, f: f64) -> f64 {
        // With (1 + z^-1)^2 / 4 = e^(-i w T) cos(w T / 2)^2 the zeros at half the rate cancel.
        let turn = 2.0 * PI * f * self.dt;
        let (sin, cos) = turn.sin_cos();
        let (sin2, cos2) = (2.0 * sin * cos, 2.0 * cos * cos - 1.0);
        let denominator = (1.0 + self.a1 * cos + self.a2 * cos2).powi(2) + (self.a1 * sin + self.a2 * sin2).powi(2);
        16.0 * self.b0.powi(2) * (0.5 * turn).cos().powi(2) / denominator
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `u = dp/dt + x` gives the low-pass of `x`: a slow `x` comes out late by the stated delay, whatever `p` does.
    #[test]
    fn a_momentum_and_its_rate_cancel_and_the_rest_is_late_by_the_delay() {
        let filter = Residue::new(20.0, 1e-3).unwrap();
        let p = |t: f64| 3.0 + 2.0 * (5.0 * t).sin();
        let x = |t: f64| 0.7 * (3.0 * t).cos();
        let mut memory = filter.at_rest(p(0.0));
        for k in 0..3000_u64 {
            let t = k as f64 * 1e-3;
            let y = filter.next(&mut memory, 10.0 * (5.0 * t).cos() + x(t), p(t));
            if k > 4 * filter.settling() {
                assert!((y - x(t - filter.delay())).abs() < 2e-4, "{t}: {y} {}", x(t - filter.delay()));
            }
        }
        assert!((filter.delay() - 0.01125).abs() < 2e-5, "{}", filter.delay());
    }

    #[test]
    fn the_power_gain_is_that_of_the_recursion() {
        let filter = Residue::new(30.0, 1e-3).unwrap();
        for f in [1.0, 30.0, 110.0, 400.0] {
            let (mut memory, mut squares) = (Memory::default(), 0.0);
            for k in 0..40_000 {
                let y = filter.next(&mut memory, (2.0 * PI * f * f64::from(k) * 1e-3).sin(), 0.0);
                squares += if k >= 20_000 { y * y } else { 0.0 };
            }
            let of_mean = (PI * f * 1e-3).cos().powi(2) * filter.power_gain(f);
            assert!((squares / 10_000.0 / of_mean - 1.0).abs() < 1e-3, "{f} Hz: {} {of_mean}", squares / 10_000.0);
        }
    }

    #[test]
    fn the_first_sample_decays_within_the_settling_time() {
        let filter = Residue::new(20.0, 1e-3).unwrap();
        let mut memory = filter.at_rest(0.0);
        filter.next(&mut memory, 100.0, 0.0);
        let response: Vec<f64> = (0..1000).map(|_| filter.next(&mut memory, 0.0, 0.0).abs()).collect();
        let largest = |of: &[f64]| of.iter().fold(0.0, |most: f64, y| most.max(*y));
        let after = largest(&response[filter.settling() as usize..]);
        assert!(after < 0.02 * largest(&response), "{after} of {}", largest(&response));
        assert!(Residue::new(500.0, 1e-3).is_err() && Residue::new(0.0, 1e-3).is_err());
        assert!(Residue::new(10.0, 0.0).is_err() && Residue::new(10.0, f64::NAN).is_err());
    }
}
