//! Effects whose columns are in every joint's row.

use super::family::{Family, Site, Spec};
use super::one_row::Nothing;
use super::{Column, Expected, FixedTerm, Motion, Sample, Term};
use crate::chain::Chain;
use nalgebra::{DMatrix, Vector3};
use plumbline_core::{JointVec, MAX_JOINTS};
use std::sync::Arc;

/// Largest number of columns.
const MAX_COLUMNS: usize = 10;
/// Earlier samples that derivatives use.
const MEMORY_SAMPLES: usize = 3;
/// Time between the samples of the loop \[s\].
const CYCLE_S: f64 = 1e-3;

/// Time of a sample.
#[derive(Clone, Copy, Debug)]
pub(super) struct Clock {
    /// Its index in the motion that the law [follows](Law::follow).
    pub index: Option<usize>,
    /// Since the start of the recording \[s\]; 0 in the loop, which serves no law of time.
    pub time: f64,
    /// Since the sample before \[s\].
    pub dt: f64,
    /// Whether the columns are means since the sample before, instead of present values.
    pub means: bool,
}

/// Columns of an effect, sample by sample. Neither allocates nor panics: a [`FixedRows`] holds its law by value, so that the compiler
/// can prove it.
pub(super) trait Law: Send + 'static {
    /// Whether it integrates between two samples and has means.
    const INTEGRATES: bool = false;

    /// Possible values of its parameters.
    const EXPECTS: Expected = Expected::Any;

    /// Number of earlier samples that affect it, at the sample period `dt` \[s\].
    fn memory(&self, _dt: f64) -> usize {
        MEMORY_SAMPLES
    }

    /// Announces the motion of the samples.
    fn follow(&mut self, _motion: &Motion) {}

    /// Writes the columns at a sample: the torques of all joints in each of the term's columns. Entries are zero on entry.
    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]);
}

/// Makes a law for a gravity vector in the base frame \[m/s2\], in its initial state.
type Start<L> = dyn Fn(&Vector3<f64>) -> L + Send + Sync;

/// An effect in all rows, `tau = sum of beta_c law_c(sample)`.
pub(super) struct AllRows<L> {
    family: &'static Family,
    spec: Spec,
    columns: Vec<Column>,
    start: Box<Start<L>>,
}

impl<L: Law> AllRows<L> {
    /// The term of a law.
    pub fn term(
        family: &'static Family,
        form: &'static str,
        site: Site,
        settings: &[f64],
        columns: Vec<Column>,
        start: impl Fn(&Vector3<f64>) -> L + Send + Sync + 'static,
    ) -> Arc<dyn Term> {
        assert!(columns.len() <= MAX_COLUMNS, "{} is too wide", family.id);
        let spec = Spec { family: family.id, form, site, settings: settings.to_vec() };
        Arc::new(AllRows { family, spec, columns, start: Box::new(start) })
    }
}

impl<L: Law> Term for AllRows<L> {
    fn id(&self) -> &'static str {
        self.family.id
    }

    fn physics(&self) -> &'static str {
        self.family.physics
    }

    fn columns(&self) -> Vec<Column> {
        self.columns.clone()
    }

    fn fill(&self, _chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        self.write(motion, y, first, false);
    }

    fn integrates(&self) -> bool {
        L::INTEGRATES
    }

    fn fill_means(&self, _chain: &Chain, motion: &Motion, y: &mut DMatrix<f64>, first: usize) {
        self.write(motion, y, first, true);
    }

    fn expects(&self) -> Expected {
        L::EXPECTS
    }

    fn spec(&self) -> Option<Spec> {
        Some(self.spec.clone())
    }

    fn fix(&self, _chain: &Chain, gravity: &Vector3<f64>, beta: &[f64]) -> Box<dyn FixedTerm> {
        if !self.family.is_served() {
            return Box::new(Nothing);
        }
        let mut own = [0.0; MAX_COLUMNS];
        own[..beta.len()].copy_from_slice(beta);
        let columns = [JointVec::default(); MAX_COLUMNS];
        Box::new(FixedRows { law: (self.start)(gravity), width: beta.len(), beta: own, columns, dt: CYCLE_S })
    }
}

impl<L: Law> AllRows<L> {
    fn write(&self, motion: &Motion, y: &mut DMatrix<f64>, first: usize, means: bool) {
        let (n, samples, width) = (motion.joints(), motion.samples(), self.columns.len());
        let mut law = (self.start)(&motion.gravity);
        law.follow(motion);
        // A law that integrates begins with the state of the whole period before; its coarse form with the part that has not decayed.
        let memory = if L::INTEGRATES && !means { samples } else { law.memory(motion.dt) };
        let mut now = [JointVec::default(); MAX_COLUMNS];
        let mut at = |k: usize, columns: &mut [JointVec]| {
            columns.fill(JointVec::default());
            let time = motion.start + k as f64 * motion.dt;
            let clock = Clock { index: Some(k), time, dt: motion.dt, means };
            law.at(&motion.sample(k), &clock, columns);
        };
        if motion.periodic {
            // The state at the end of the period before.
            (samples.saturating_sub(memory)..samples).for_each(|k| at(k, &mut now[..width]));
        }
        for k in 0..samples {
            at(k, &mut now[..width]);
            for (c, column) in now[..width].iter().enumerate() {
                for (j, value) in column[..n].iter().enumerate() {
                    y[(j * samples + k, first + c)] = *value;
                }
            }
        }
    }
}

struct FixedRows<L> {
    law: L,
    /// Columns, at most [`MAX_COLUMNS`].
    width: usize,
    beta: [f64; MAX_COLUMNS],
    columns: [JointVec; MAX_COLUMNS],
    dt: f64,
}

impl<L: Law> FixedTerm for FixedRows<L> {
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn torque(&mut self, sample: &Sample, tau: &mut JointVec) {
        let Some(columns) = self.columns.get_mut(..self.width) else { return };
        columns.fill(JointVec::default());
        self.law.at(sample, &Clock { index: None, time: 0.0, dt: self.dt, means: false }, columns);
        for (column, beta) in columns.iter().zip(&self.beta) {
            tau.iter_mut().zip(column).for_each(|(tau, value)| *tau += beta * value);
        }
    }

    fn every(&mut self, dt: f64) {
        self.dt = dt;
    }
}

/// A signal's last samples, for causal derivatives.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Past {
    /// Newest first.
    values: [f64; MEMORY_SAMPLES],
    seen: usize,
}

impl Past {
    /// First and second derivative at the sample `now`, by backward differences of second order (Fornberg, Mathematics of
    /// Computation 51 (1988)); zero or of first order for the first samples.
    pub fn derivatives(&mut self, now: f64, dt: f64) -> [f64; 2] {
        let derivatives = self.with(now, dt);
        let [a, b, _] = self.values;
        self.values = [now, a, b];
        self.seen = (self.seen + 1).min(MEMORY_SAMPLES);
        derivatives
    }

    /// The derivatives for the sample `now`, which is not stored.
    pub fn with(&self, now: f64, dt: f64) -> [f64; 2] {
        let [a, b, c] = self.values;
        let [first, second] = match self.seen {
            0 => [0.0, 0.0],
            1 => [now - a, 0.0],
            2 => [1.5 * now - 2.0 * a + 0.5 * b, now - 2.0 * a + b],
            _ => [1.5 * now - 2.0 * a + 0.5 * b, 2.0 * now - 5.0 * a + 4.0 * b - c],
        };
        [first / dt, second / (dt * dt)]
    }

    /// Slopes of the derivatives over the sample `now`.
    pub fn slopes(&self, dt: f64) -> [f64; 2] {
        let [first, second] = match self.seen {
            0 => [0.0, 0.0],
            1 => [1.0, 0.0],
            2 => [1.5, 1.0],
            _ => [1.5, 2.0],
        };
        [first / dt, second / (dt * dt)]
    }
}

/// [`Past`] of every joint.
pub(super) type PastOfJoints = [Past; MAX_JOINTS];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_of_second_order() {
        let (w, dt) = (3.0_f64, 1e-3);
        let mut past = Past::default();
        for k in 0..500 {
            let (sin, cos) = (w * f64::from(k) * dt).sin_cos();
            let [first, second] = past.derivatives(sin, dt);
            if k >= 3 {
                // dt^2 / 3 f''' and 11 / 12 dt^2 f''''.
                assert!((first - w * cos).abs() < 0.4 * dt * dt * w.powi(3), "{k}");
                assert!((second + w * w * sin).abs() < dt * dt * w.powi(4) + 1e-9, "{k}");
            }
        }
        assert_eq!(Past::default().derivatives(1.0, dt), [0.0, 0.0]);
    }
}
