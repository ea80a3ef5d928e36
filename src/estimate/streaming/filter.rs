//! Causal low-passes on eight lanes per signal, one sample at a time.

use crate::estimate::signal::SignalError;
use crate::estimate::signal::butterworth::Butterworth;
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f64x4};

/// The same Butterworth low-pass on many signals of eight lanes each. It starts as if the first sample had lasted for ever.
#[derive(Clone, Debug)]
pub struct Bank {
    level: Level,
    /// `b0, a1, a2` of each second-order section.
    sections: Vec<[f64; 3]>,
    /// Two states per section and signal: section by section, signal by signal.
    states: Vec<[[f64; 8]; 2]>,
    signals: usize,
    started: bool,
}

impl Bank {
    /// A low-pass of even `order` with its half-power frequency at `cutoff` \[Hz\] for `signals` signals sampled at `rate` \[Hz\].
    pub fn new(order: usize, cutoff: f64, rate: f64, signals: usize) -> Result<Bank, SignalError> {
        let sections: Vec<[f64; 3]> = Butterworth::new(order, cutoff, rate)?.coefficients().collect();
        let states = vec![[[0.0; 8]; 2]; sections.len() * signals];
        Ok(Bank { level: Level::new(), sections, states, signals, started: false })
    }

    /// Forgets all samples: the next one is the first.
    pub fn restart(&mut self) {
        self.started = false;
    }

    /// One sample of every signal, in place. Allocates nothing.
    pub fn step(&mut self, values: &mut [[f64; 8]]) {
        assert_eq!(values.len(), self.signals, "one value per signal");
        if !self.started {
            self.started = true;
            for (s, [b0, a1, a2]) in self.sections.iter().enumerate() {
                for (state, value) in self.states[s * self.signals..].iter_mut().zip(values.iter()) {
                    for lane in 0..8 {
                        state[1][lane] = (b0 - a2) * value[lane];
                        state[0][lane] = (2.0 * b0 - a1) * value[lane] + state[1][lane];
                    }
                }
            }
        }
        let level = self.level;
        let (sections, states) = (&self.sections, &mut self.states);
        dispatch!(level, simd => step(simd, sections, states, values));
    }
}

#[inline(always)]
fn step<S: Simd>(simd: S, sections: &[[f64; 3]], states: &mut [[[f64; 8]; 2]], values: &mut [[f64; 8]]) {
    for (&[b0, a1, a2], states) in sections.iter().zip(states.chunks_exact_mut(values.len().max(1))) {
        for (value, [z1, z2]) in values.iter_mut().zip(states) {
            half(simd, [b0, a1, a2], &mut value[..4], &mut z1[..4], &mut z2[..4]);
            half(simd, [b0, a1, a2], &mut value[4..], &mut z1[4..], &mut z2[4..]);
        }
    }
}

/// `y = b0 (x + 2 x_1 + x_2) - a1 y_1 - a2 y_2` on four lanes, transposed form.
#[inline(always)]
fn half<S: Simd>(simd: S, [b0, a1, a2]: [f64; 3], value: &mut [f64], z1: &mut [f64], z2: &mut [f64]) {
    let x = f64x4::from_slice(simd, value) * b0;
    let y = x + f64x4::from_slice(simd, z1);
    y.mul_add(-a1, x + x + f64x4::from_slice(simd, z2)).store_slice(z1);
    y.mul_add(-a2, x).store_slice(z2);
    y.store_slice(value);
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn every_lane_has_the_gain_of_the_low_pass_and_starts_at_rest() {
        let (order, cutoff, rate) = (4, 5.0, 1000.0);
        let mut bank = Bank::new(order, cutoff, rate, 2).unwrap();
        let reference = Butterworth::new(order, cutoff, rate).unwrap();
        let frequency = |lane: usize| 0.5 + lane as f64;
        let mut squares = [[0.0; 8]; 2];
        for k in 0..20_000 {
            let mut values: [[f64; 8]; 2] = std::array::from_fn(|signal| {
                std::array::from_fn(|lane| (signal + 1) as f64 * (2.0 * PI * frequency(lane) * k as f64 / rate).cos())
            });
            bank.step(&mut values);
            if k == 0 {
                assert!(
                    values
                        .iter()
                        .flatten()
                        .zip([1.0, 2.0].iter().flat_map(|v| [v; 8]))
                        .all(|(y, x)| (y - x).abs() < 1e-9)
                );
            }
            // Whole periods of every lane, after the transient.
            if k >= 10_000 {
                for (sum, value) in squares.iter_mut().flatten().zip(values.iter().flatten()) {
                    *sum += value * value / 5000.0;
                }
            }
        }
        for (signal, squares) in squares.iter().enumerate() {
            for (lane, square) in squares.iter().enumerate() {
                // The zero-phase gain is that of two runs.
                let expected = ((signal + 1) as f64).powi(2) * reference.zero_phase_gain(frequency(lane));
                assert!((square / expected - 1.0).abs() < 1e-6, "signal {signal}, lane {lane}: {square} {expected}");
            }
        }
    }
}
