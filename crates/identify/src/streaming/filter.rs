//! Causal low-passes on eight lanes per signal, one sample at a time.

use crate::signal::SignalError;
use crate::signal::butterworth::Butterworth;
use fearless_simd::{Level, Simd, SimdBase, SimdFloat, dispatch, f64x4};

/// The same Butterworth low-pass on many signals of eight lanes each. Initialised in steady state at the first sample.
#[derive(Clone, Debug)]
pub struct Bank {
    level: Level,
    /// `b0, a1, a2` of each second-order section.
    sections: Vec<[f64; 3]>,
    signals: usize,
    /// Signal and first lane of each four lanes that are not always zero.
    parts: Vec<(usize, usize)>,
    /// Two states per part and section: part by part, section by section.
    states: Vec<[[f64; 4]; 2]>,
    started: bool,
}

impl Bank {
    /// A low-pass of even `order` with its half-power frequency at `cutoff` \[Hz\] for signals sampled at `rate` \[Hz\]. `active` has one element per
    /// signal: which of its lanes can be other than zero. Lanes are filtered four at a time; four that are zero are not.
    pub fn new(order: usize, cutoff: f64, rate: f64, active: &[[bool; 8]]) -> Result<Bank, SignalError> {
        let sections: Vec<[f64; 3]> = Butterworth::new(order, cutoff, rate)?.coefficients().collect();
        let both = |signal: usize| [(signal, 0), (signal, 4)];
        let moves = |&(signal, first): &(usize, usize)| active[signal][first..first + 4].iter().any(|&lane| lane);
        let parts: Vec<(usize, usize)> = (0..active.len()).flat_map(both).filter(moves).collect();
        let states = vec![[[0.0; 4]; 2]; sections.len() * parts.len()];
        Ok(Bank { level: Level::new(), sections, signals: active.len(), parts, states, started: false })
    }

    /// Resets the filter: the next sample is the first.
    pub fn restart(&mut self) {
        self.started = false;
    }

    /// One sample of every signal, in place. Allocates nothing.
    pub fn step(&mut self, values: &mut [[f64; 8]]) {
        assert_eq!(values.len(), self.signals, "one value per signal");
        if !self.started {
            self.started = true;
            for (&(signal, first), states) in self.parts.iter().zip(self.states.chunks_exact_mut(self.sections.len())) {
                for (state, [b0, a1, a2]) in states.iter_mut().zip(&self.sections) {
                    for (lane, value) in values[signal][first..first + 4].iter().enumerate() {
                        state[1][lane] = (b0 - a2) * value;
                        state[0][lane] = (2.0 * b0 - a1) * value + state[1][lane];
                    }
                }
            }
        }
        let (level, sections, parts, states) = (self.level, &self.sections, &self.parts, &mut self.states);
        dispatch!(level, simd => step(simd, sections, parts, states, values));
    }
}

/// `y = b0 (x + 2 x_1 + x_2) - a1 y_1 - a2 y_2` of every section, transposed form; a part goes through all of them in registers.
#[inline(always)]
fn step<S: Simd>(
    simd: S,
    sections: &[[f64; 3]],
    parts: &[(usize, usize)],
    states: &mut [[[f64; 4]; 2]],
    values: &mut [[f64; 8]],
) {
    for (&(signal, first), states) in parts.iter().zip(states.chunks_exact_mut(sections.len())) {
        let place = &mut values[signal][first..first + 4];
        let mut value = f64x4::from_slice(simd, place);
        for (&[b0, a1, a2], [z1, z2]) in sections.iter().zip(states) {
            let x = value * b0;
            value = x + f64x4::from_slice(simd, z1);
            value.mul_add(-a1, x + x + f64x4::from_slice(simd, z2)).store_slice(z1);
            value.mul_add(-a2, x).store_slice(z2);
        }
        value.store_slice(place);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn every_lane_has_the_gain_of_the_low_pass_and_starts_in_steady_state() {
        let (order, cutoff, rate) = (4, 5.0, 1000.0);
        let mut bank = Bank::new(order, cutoff, rate, &[[true; 8]; 2]).unwrap();
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
