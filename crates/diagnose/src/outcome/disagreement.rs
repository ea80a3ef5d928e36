//! An unseen run that differs from the identified ones, as it stands in `report.json`.

use serde::{Deserialize, Serialize};

/// An unseen run that the delivered model predicts worse than the runs it was identified from.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Disagreement {
    /// Name of the run.
    pub run: String,
    /// The worst joint, from 1.
    pub joint: usize,
    /// RMS of the residual of its mean period there: of a model without effects below 4 Hz, with effects in the band of the search \[Nm\].
    pub rms: f64,
    /// The RMS to expect from the noise, the residual of the identified runs and the errors of the parameters \[Nm\].
    pub expected: f64,
    /// The largest RMS that would not differ from it \[Nm\].
    #[serde(default)]
    pub limit: f64,
}

impl Disagreement {
    /// RMS over the largest that would not differ.
    pub fn ratio(&self) -> f64 {
        self.rms / self.limit.max(f64::MIN_POSITIVE)
    }

    /// Whether a run with this residual \[Nm\] would agree.
    pub fn is_explained_at(&self, rms: f64) -> bool {
        rms <= self.limit
    }
}
