//! Which changes hold on runs that took no part in the search.

use super::{Change, extended};
use crate::errors::{self, Compared, Of};
use plumbline_identify::{Experiment, Modelled, Rms, validate};
use plumbline_model::{ModelError, TorqueModel};

/// A stored model and the changes that were found.
pub struct Stored<'a> {
    /// The model.
    pub model: &'a TorqueModel,
    /// What was found.
    pub changes: &'a [Change],
}

impl Stored<'_> {
    /// The model with some of the changes, as far as they had come in a session.
    ///
    /// # Errors
    /// As [`extended`].
    pub fn with(&self, kept: &[usize], session: u32) -> Result<TorqueModel, ModelError> {
        let come = |k: &&usize| self.changes[**k].since.is_none_or(|since| since <= session);
        let chosen: Vec<Change> = kept.iter().filter(come).map(|&k| self.changes[k].clone()).collect();
        extended(self.model, &chosen)
    }

    /// Its errors on runs of these sessions.
    ///
    /// # Errors
    /// As [`extended`].
    pub fn errors(&self, kept: &[usize], runs: &[(&Experiment, u32)]) -> Result<Vec<Rms>, ModelError> {
        let error = |&(experiment, session): &(&Experiment, u32)| {
            let model = self.with(kept, session)?;
            Ok(validate(experiment, |motion| model.predict(motion)))
        };
        runs.iter().map(error).collect()
    }

    /// Changes that lower the error on unseen runs, in one joint at least by the whole interval; without unseen runs, all of them. What a model
    /// lacked when it was identified is in every search, and holds on other runs by chance alone.
    ///
    /// # Errors
    /// As [`extended`].
    pub fn held(&self, unseen: &[(&Experiment, u32)]) -> Result<Vec<usize>, ModelError> {
        let mut kept: Vec<usize> = (0..self.changes.len()).collect();
        if unseen.is_empty() {
            return Ok(kept);
        }
        let total = |kept: &[usize]| -> Result<f64, ModelError> {
            let square = |rms: &Rms| rms.samples as f64 * rms.filtered.iter().map(|value| value * value).sum::<f64>();
            Ok(self.errors(kept, unseen)?.iter().map(square).sum())
        };
        let mut with = total(&kept)?;
        for k in (0..self.changes.len()).rev() {
            let rest: Vec<usize> = kept.iter().copied().filter(|&other| other != k).collect();
            let without = total(&rest)?;
            if without <= with || !self.certain(&rest, &kept, unseen)? {
                (kept, with) = (rest, without);
            }
        }
        Ok(kept)
    }

    /// Whether the second model is better than the first in a joint, by the whole interval of the difference.
    fn certain(&self, first: &[usize], second: &[usize], unseen: &[(&Experiment, u32)]) -> Result<bool, ModelError> {
        let compared = self.compare([first, second], unseen)?;
        Ok(compared.change.intervals.iter().any(|[_, high]| *high < 0.0))
    }

    /// Errors without and with the kept changes, with intervals, after the low-pass; empty without runs.
    ///
    /// # Errors
    /// As [`extended`].
    pub fn compared(&self, kept: &[usize], runs: &[(&Experiment, u32)]) -> Result<Compared, ModelError> {
        self.compare([&[], kept], runs)
    }

    fn compare(&self, [first, second]: [&[usize]; 2], runs: &[(&Experiment, u32)]) -> Result<Compared, ModelError> {
        let mut pairs = Vec::new();
        for &(experiment, session) in runs {
            let (first, second) = (self.with(first, session)?, self.with(second, session)?);
            let along = |model: &TorqueModel| Modelled::of(experiment, |motion| model.predict(motion));
            pairs.push((experiment, along(&first), along(&second)));
        }
        Ok(errors::compare(&pairs, Of::Filtered).unwrap_or_default())
    }
}
