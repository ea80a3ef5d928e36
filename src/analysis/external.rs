//! The external torque along a recording: contacts, and thresholds for a vendor's collision detection.

use nalgebra::{DMatrix, Matrix6, SymmetricEigen};
use plumbline_core::symmetric_eigen;
use plumbline_identify::TorqueUncertainty;
use plumbline_identify::external::{External, Observed, ObserverError, ObserverSettings, observe};
use plumbline_model::TorqueModel;

/// Contacts closer together than this are one \[s\].
pub const ONE_CONTACT_S: f64 = 0.2;
/// Step between samples at which thresholds are computed as forces.
const FORCE_STEP: usize = 20;
/// Smallest ratio of the eigenvalues of `J J'` at which forces are computed: nearer to a singular pose they are not determined.
const MIN_RATIO: f64 = 1e-4;

/// The external torque along a recording with what it was found by.
pub struct Seen {
    observed: Observed,
    settings: ObserverSettings,
}

/// A time in which contact is flagged.
#[derive(Clone, Debug, PartialEq)]
pub struct Contact {
    /// Begin and end on the clock of the recording \[s\].
    pub span: [f64; 2],
    /// Largest external torque in it, per joint \[Nm\].
    pub torque: Vec<f64>,
    /// Joints that exceed their thresholds, from 1.
    pub joints: Vec<usize>,
}

impl Seen {
    /// Along a recording.
    ///
    /// # Errors
    /// As [`observe`].
    pub fn along(
        model: &TorqueModel,
        uncertainty: &TorqueUncertainty,
        run: &plumbline_identify::Run,
        measured_velocities: bool,
        settings: ObserverSettings,
    ) -> Result<Seen, ObserverError> {
        Ok(Seen { observed: observe(model, uncertainty, run, measured_velocities, settings)?, settings })
    }

    /// Settings of the observer.
    pub fn settings(&self) -> &ObserverSettings {
        &self.settings
    }

    /// Delay of the values \[s\].
    pub fn delay(&self) -> f64 {
        self.observed.delay
    }

    /// At the time stamp `t` \[s\].
    pub fn at(&self, t: f64) -> External {
        let Observed { start, dt, samples, .. } = &self.observed;
        let index = ((t - start) / dt).round().clamp(0.0, samples.len().saturating_sub(1) as f64);
        samples.get(index as usize).copied().unwrap_or_default()
    }

    /// Contacts along the recording.
    pub fn contacts(&self) -> Vec<Contact> {
        let Observed { start, dt, samples, q, .. } = &self.observed;
        let mut found: Vec<Contact> = Vec::new();
        for (k, sample) in samples.iter().enumerate().filter(|(_, sample)| sample.contact) {
            let t = start + k as f64 * dt;
            if !found.last().is_some_and(|last| t - last.span[1] < ONE_CONTACT_S) {
                found.push(Contact { span: [t, t], torque: vec![0.0; q.ncols()], joints: Vec::new() });
            }
            let Some(contact) = found.last_mut() else { continue };
            contact.span[1] = t;
            for (j, largest) in contact.torque.iter_mut().enumerate() {
                if sample.tau[j].abs() > largest.abs() {
                    *largest = sample.tau[j];
                }
                if sample.tau[j].abs() > sample.threshold[j] && !contact.joints.contains(&(j + 1)) {
                    contact.joints.push(j + 1);
                    contact.joints.sort_unstable();
                }
            }
        }
        found
    }

    /// Largest threshold of each joint along the recording \[Nm\].
    pub fn thresholds(&self) -> Vec<f64> {
        let largest = |j| self.observed.samples.iter().map(|sample| sample.threshold[j]).fold(0.0, f64::max);
        (0..self.observed.q.ncols()).map(largest).collect()
    }

    /// The same as a wrench at the end effector in the base frame, force \[N\] above moment \[Nm\]: the estimate `(J J')^-1 J tau_ext` of a
    /// controller exceeds it as rarely. Largest along the recording without nearly singular poses; `None` where all are.
    pub fn wrench_thresholds(&self, jacobian: impl Fn(&[f64]) -> Vec<[f64; 6]>) -> Option<[f64; 6]> {
        let Observed { samples, q, .. } = &self.observed;
        let mut largest: Option<[f64; 6]> = None;
        for k in (0..samples.len()).step_by(FORCE_STEP) {
            let pose: Vec<f64> = q.row(k).iter().copied().collect();
            let columns = jacobian(&pose);
            let j = DMatrix::from_fn(6, columns.len(), |i, c| columns[c][i]);
            let square = &j * j.transpose();
            let square = Matrix6::from_fn(|i, c| square[(i, c)]);
            let Some(SymmetricEigen { eigenvalues, .. }) = symmetric_eigen(square) else { continue };
            if eigenvalues.min() < MIN_RATIO * eigenvalues.max() {
                continue;
            }
            let Some(inverse) = square.try_inverse() else { continue };
            let map = inverse * j;
            let own = largest.get_or_insert([0.0; 6]);
            for (i, own) in own.iter_mut().enumerate() {
                let squares = (0..columns.len()).map(|c| (map[(i, c)] * samples[k].threshold[c]).powi(2));
                *own = own.max(squares.sum::<f64>().sqrt());
            }
        }
        largest
    }
}
