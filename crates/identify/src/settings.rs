//! Settings of the preparation of runs for the regression.

use serde::{Deserialize, Serialize};

/// Differentiation of filtered positions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Derivative {
    /// Spectral differentiation, exact for a periodic motion. An aperiodic run uses central differences.
    #[default]
    Spectral,
    /// Central differences.
    Central,
}

/// Signal-processing method.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Spectral derivatives behind a wide low-pass, more accurate for periodic motions ([`Settings::default`]).
    #[default]
    Spectral,
    /// The paper's method ([`Settings::paper`]).
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

/// Settings of the preparation of runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Settings {
    /// Cut-off of the zero-phase low-pass on the torques and on every column of the regressor \[Hz\].
    pub torque_cutoff: f64,
    /// Cut-off of the zero-phase low-pass on the positions before they are differentiated \[Hz\]. It must pass the response
    /// of the arm to a reversal of friction, so it is wider than the torque cut-off; noise above the torque cut-off does not reach the
    /// regression. Absent: as wide as the positions' noise allows, at most 80 Hz, at least 20 Hz for the mean of several periods and 10 Hz
    /// for an aperiodic run; these minima for the comparison with raw torques. At most 0.8 of half the sampling rate.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub position_cutoff: Option<f64>,
    /// Order of both low-passes, even; they run forward and backward.
    pub order: usize,
    /// Decimation factor after the low-pass; absent: paper eq. 16 for twice the torque cut-off.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub decimation: Option<usize>,
    /// How positions are differentiated.
    pub derivative: Derivative,
    /// Periods skipped at the start of a periodic run, during the transient.
    pub skip_periods: usize,
    /// Whether every period's deviation from the mean is kept; needed by estimators for noisy positions.
    pub keep_periods: bool,
    /// Whether both ends of an aperiodic run are left out, where the low-pass lets noise through: a fit averages it, and a search explains it.
    pub without_ends: bool,
    /// Whether measured velocities of an aperiodic run are used, where given, and accelerations are differentiated from them. They are more
    /// accurate at reversals with a low sampling rate or an elastic gear.
    pub measured_velocities: bool,
    /// Minimum time cut off both ends of an aperiodic run \[s\].
    pub trim: f64,
    /// Speed below which a joint is at rest \[rad/s\]. Samples of an aperiodic run with every joint at rest are excluded: static friction is not
    /// determined by the velocity. Absent: all samples are used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub rest: Option<f64>,
    /// Excluded time spans, such as a contact found by the diagnosis. In a periodic run the other periods replace them.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub leave_out: Vec<ExcludedSpan>,
    /// Whether [`super::solve::wls`] weighs by frequency where periods repeat, [`super::solve::coloured`].
    #[serde(skip)]
    pub weights_by_frequency: bool,
}

/// Excluded time span of one run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct ExcludedSpan {
    /// Name of the run.
    pub run: String,
    /// Start, since the first sample of the run \[s\].
    pub from: f64,
    /// End, since the first sample of the run \[s\].
    pub to: f64,
}

impl ExcludedSpan {
    /// One period of a run, counted from 0.
    pub fn period(run: &str, period: usize, seconds: f64) -> ExcludedSpan {
        ExcludedSpan { run: run.to_string(), from: period as f64 * seconds, to: (period + 1) as f64 * seconds }
    }

    /// Marks the excluded ones of samples `dt` apart \[s\]; the first is sample `first` of the run.
    pub(super) fn mark(&self, marked: &mut [bool], first: usize, dt: f64) {
        // Half-open span: the start is included, the end is not.
        let sample = |time: f64| ((time / dt - 1e-6).ceil().max(0.0) as usize).saturating_sub(first).min(marked.len());
        let (from, to) = (sample(self.from), sample(self.to));
        marked[from.min(to)..to].fill(true);
    }
}

impl Settings {
    pub(super) fn left_out<'a>(&'a self, run: &'a str) -> impl Iterator<Item = &'a ExcludedSpan> {
        self.leave_out.iter().filter(move |one| one.run == run)
    }

    /// The paper's signal processing (section II-B.3): mean period, order-20 zero-phase Butterworth at 2 Hz, central differences,
    /// decimation by eq. 16 with `omega_fp` twice the cut-off. Torques and columns pass the same filter. Weights are those of eqs. 9 and 10.
    pub fn paper() -> Settings {
        Settings {
            torque_cutoff: 2.0,
            position_cutoff: Some(2.0),
            order: 20,
            derivative: Derivative::Central,
            weights_by_frequency: false,
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
            without_ends: false,
            measured_velocities: false,
            trim: 0.0,
            rest: None,
            leave_out: Vec::new(),
            weights_by_frequency: true,
        }
    }
}
