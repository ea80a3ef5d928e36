//! The curves behind the plots of a diagnosis. Scores, the path of the search and the unmodelled residuals are drawn from
//! [`Diagnosis`](super::Diagnosis) itself. Joints count from 1.
//!
//! An empty list is not drawn; points that are not finite are left out.

use serde::{Deserialize, Serialize};

/// All curves of a diagnosis.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Curves {
    /// Mean periods of the residual, in the order of drawing: the joints that have something to show rather than all.
    pub periods: Vec<PeriodFigure>,
    /// Each effect against its own variable.
    pub effects: Vec<EffectFigure>,
    /// Spectra of the residual, one per joint that has something to show.
    pub spectra: Vec<SpectrumFigure>,
    /// What the unexplained residuals depend on, against one variable each.
    pub dependences: Vec<EffectFigure>,
    /// What they depend on, against two variables each.
    pub maps: Vec<MapFigure>,
}

/// The part of one joint's residual that every period repeats.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PeriodFigure {
    /// Joint, from 1.
    pub joint: usize,
    /// Name of the trajectory.
    pub trajectory: String,
    /// Time from the start of the period \[s\].
    pub t: Vec<f64>,
    /// Residual of the model as it was, mean over the periods, as long as `t` \[Nm\].
    pub before: Vec<f64>,
    /// The same with the effects, as long as `t` or empty \[Nm\].
    pub after: Vec<f64>,
    /// Standard deviation of such a mean from the scatter between periods, one per sample of `t` or one for all \[Nm\]. A band of twice
    /// that around zero holds what noise alone would leave.
    pub deviation: Vec<f64>,
}

/// A residual against a variable, averaged in bins of it.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct EffectFigure {
    /// What is shown: `presliding in joint 4`.
    pub title: String,
    /// The variable with its unit: `displacement since the last reversal / mrad`.
    pub variable: String,
    /// Joint whose torque it is, from 1.
    pub joint: usize,
    /// Mean of the variable in each bin.
    pub x: Vec<f64>,
    /// Mean in each bin of the residual without this effect, as long as `x` \[Nm\].
    pub mean: Vec<f64>,
    /// Standard deviation of each `mean`, as long as `x` or empty \[Nm\].
    pub deviation: Vec<f64>,
    /// Fitted torque of the effect: variable and torque \[Nm\]; or the mean of what was fitted in each bin. Drawn as a line.
    pub fitted: Vec<(f64, f64)>,
    /// Standard deviation of each point of `fitted`, as long or empty \[Nm\]. Drawn as a band of twice that.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fitted_deviation: Vec<f64>,
}

/// Power density of one joint's residual, one-sided.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SpectrumFigure {
    /// Joint, from 1.
    pub joint: usize,
    /// Frequency, increasing \[Hz\].
    pub f: Vec<f64>,
    /// Residual of the model as it was, as long as `f` \[Nm2/Hz\].
    pub before: Vec<f64>,
    /// The same with the effects, as long as `f` or empty \[Nm2/Hz\].
    pub after: Vec<f64>,
    /// Noise of what is drawn, as long as `f` \[Nm2/Hz\].
    pub noise: Vec<f64>,
}

/// A residual over two variables.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MapFigure {
    /// What is shown: `joint 2, unexplained`.
    pub title: String,
    /// The variable to the right with its unit: `q2 / rad`.
    pub x_name: String,
    /// The variable upwards with its unit: `dq4 / (rad/s)`.
    pub y_name: String,
    /// Edges of the cells along `x`, increasing, one more than cells.
    pub x: Vec<f64>,
    /// Edges of the cells along `y`, increasing, one more than cells.
    pub y: Vec<f64>,
    /// Mean residual of each cell, rows upwards: cell `(i, k)` along `(x, y)` is `mean[k][i]`; NaN where no sample fell \[Nm\].
    pub mean: Vec<Vec<f64>>,
}
