//! How runs are prepared for the regression.

use serde::{Deserialize, Serialize};

/// How velocities and accelerations come from filtered positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Derivative {
    /// Through the spectrum, exact for a periodic motion. A run that does not repeat takes central differences.
    #[default]
    Spectral,
    /// Central differences.
    Central,
}

/// How torques and motions are made ready.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// The better way for periodic motions: exact derivatives through the spectrum behind a wide low-pass ([`Settings::default`]).
    #[default]
    Spectral,
    /// The paper's way ([`Settings::paper`]).
    Paper,
}

impl Method {
    /// Its settings.
    pub fn settings(self) -> Settings {
        match self {
            Method::Spectral => Settings::default(),
            Method::Paper => Settings::paper(),
        }
    }

    /// Its name on the command line and in files.
    pub fn id(self) -> &'static str {
        match self {
            Method::Spectral => "spectral",
            Method::Paper => "paper",
        }
    }

    /// The method of that name.
    pub fn by_id(id: &str) -> Option<Method> {
        [Method::Spectral, Method::Paper].into_iter().find(|method| method.id() == id)
    }
}

/// How runs are prepared.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Settings {
    /// Cut-off of the zero-phase low-pass on the torques and on every column of the regressor \[Hz\].
    pub torque_cutoff: f64,
    /// Cut-off of the zero-phase low-pass on the positions before they are differentiated \[Hz\]. It must pass what the arm does when
    /// friction changes its sign at a reversal, so it is wider than the other; what noise it passes above the torque cut-off does not
    /// reach the regression. Absent: as wide as the positions' noise allows, 80 Hz at most and at least 20 Hz for the mean of
    /// several periods, 10 Hz for what was recorded once; those two where raw torques are compared with the model. At most 0.8 of
    /// half the sampling rate is used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_cutoff: Option<f64>,
    /// Order of both low-passes, even; they run forward and backward.
    pub order: usize,
    /// Samples to keep one of after the low-pass; absent: paper eq. 16 for twice the torque cut-off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decimation: Option<usize>,
    /// How positions are differentiated.
    pub derivative: Derivative,
    /// Periods left out at the start of a periodic run, while the arm settles.
    pub skip_periods: usize,
    /// Whether every period's deviation from the mean is kept: estimators that reckon with noisy positions need it.
    pub keep_periods: bool,
    /// Whether the velocities of a run that does not repeat are those that the arm measured, where the run has them, and the
    /// accelerations are differentiated from them. Where samples are few, or an elastic gear lies between motor and link, they know
    /// better when a joint reverses.
    pub measured_velocities: bool,
    /// Time left out at both ends of a run that does not repeat, where its filters need less \[s\].
    pub trim: f64,
    /// Speed below which a joint counts as standing \[rad/s\]. Samples of a run that does not repeat at which every joint stands are
    /// left out: there Coulomb friction is whatever holds the arm, and no velocity tells which. Absent: all samples count.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rest: Option<f64>,
    /// Stretches of the recordings that don't count, such as a contact that diagnosis found. Of a periodic run the other periods stand in
    /// for them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub leave_out: Vec<ExcludedSpan>,
}

/// A stretch of one run that does not count.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExcludedSpan {
    /// Name of the run.
    pub run: String,
    /// Begin, since the first sample of the run \[s\].
    pub from: f64,
    /// End, since the first sample of the run \[s\].
    pub to: f64,
}

impl ExcludedSpan {
    /// One period of a run, counted from 0.
    pub fn period(run: &str, period: usize, seconds: f64) -> ExcludedSpan {
        ExcludedSpan { run: run.to_string(), from: period as f64 * seconds, to: (period + 1) as f64 * seconds }
    }

    /// Marks samples `dt` apart \[s\], the first of them `first` samples after that of the run.
    pub(super) fn mark(&self, marked: &mut [bool], first: usize, dt: f64) {
        // A sample at the very begin belongs to the stretch, one at the very end does not.
        let sample = |time: f64| ((time / dt - 1e-6).ceil().max(0.0) as usize).saturating_sub(first).min(marked.len());
        let (from, to) = (sample(self.from), sample(self.to));
        marked[from.min(to)..to].fill(true);
    }
}

impl Settings {
    /// What of a run doesn't count.
    pub(super) fn left_out<'a>(&'a self, run: &'a str) -> impl Iterator<Item = &'a ExcludedSpan> {
        self.leave_out.iter().filter(move |one| one.run == run)
    }

    /// The paper's signal processing (section II-B.3): mean period, order-20 zero-phase Butterworth at 2 Hz, central differences,
    /// decimation by eq. 16 with `omega_fp` twice the cut-off. Torques and columns pass the same filter.
    pub fn paper() -> Settings {
        Settings {
            torque_cutoff: 2.0,
            position_cutoff: Some(2.0),
            order: 20,
            derivative: Derivative::Central,
            ..Settings::default()
        }
    }
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            torque_cutoff: 5.0,
            position_cutoff: None,
            order: 8,
            decimation: None,
            derivative: Derivative::Spectral,
            skip_periods: 0,
            keep_periods: false,
            measured_velocities: false,
            trim: 0.0,
            rest: None,
            leave_out: Vec::new(),
        }
    }
}
