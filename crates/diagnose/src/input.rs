//! What is diagnosed, and how.

use super::errors;
use super::evidence::Trial;
use super::span::Span;
use plumbline_identify::solve;
use plumbline_model::Structure;
use plumbline_model::term::effect::Spec;

/// Hash of the sources that a verdict depends on: those of this crate, of the estimate and of the effects. A figure names the rules that it was made with.
pub const RULES: &str = env!("PLUMBLINE_RULES");

/// What is diagnosed.
pub struct Input<'a> {
    /// The plain model.
    pub structure: &'a Structure,
    /// Runs to identify from.
    pub identify: &'a [Trial<'a>],
    /// Runs that decide which findings are accepted and delivered, and whether a joint is explained; not fitted.
    pub veto: &'a [Trial<'a>],
    /// Runs that the errors before and after are measured on and nothing is decided by; without any, those of `veto`.
    pub judge: &'a [Trial<'a>],
    /// How parameters are identified.
    pub options: &'a solve::Options,
    /// What came within a run, with the parts of the recording in which it may act ([`super::changing::Changing::came`]).
    pub came: &'a [(Spec, Span)],
}

impl<'a> Input<'a> {
    /// Runs that decide, those that the model was not fitted to where there are any.
    pub(super) fn deciding(&self) -> &'a [Trial<'a>] {
        if self.veto.is_empty() { self.identify } else { self.veto }
    }

    /// Runs that the errors are measured on.
    pub(super) fn measuring(&self) -> &'a [Trial<'a>] {
        if self.judge.is_empty() { self.veto } else { self.judge }
    }
}

/// How a diagnosis is done.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Highest frequency that counts \[Hz\].
    pub band: f64,
    /// Least RMS of an effect that matters \[Nm\]; by default a share of the noise floor.
    pub threshold: Option<f64>,
    /// Errors that a stored model has by itself, n \[Nm\]: the torque of a change is larger in one joint. Empty where they are not known.
    pub usual: Vec<f64>,
    /// That share: of the noise of the mean period.
    pub least_floor: f64,
    /// Share of the unmodelled mean square that an effect has to explain in one joint.
    pub least_share: f64,
    /// The same where the noise is not known, of the whole residual.
    pub least_share_of_all: f64,
    /// And on blocks that were left out.
    pub least_share_left_out: f64,
    /// What the errors on unseen runs are taken of that a delivered model is judged by.
    pub judged_by: errors::Of,
    /// Wanted half width of the 95 % intervals of effects' parameters, as a share of the effect's size; a wider one is an open question.
    pub until: Option<f64>,
    /// Highest torque of each joint, n \[Nm\]; empty where it is not known. A learned term gets a share of it.
    pub torque_limits: Vec<f64>,
    /// Most steps of the selection.
    pub steps: usize,
    /// Threads to work on.
    pub threads: usize,
}

impl Default for Settings {
    fn default() -> Settings {
        Settings {
            band: 16.0,
            threshold: None,
            usual: Vec::new(),
            least_floor: 0.7,
            least_share: 0.15,
            least_share_of_all: 0.03,
            least_share_left_out: 0.2,
            judged_by: errors::Of::Filtered,
            until: None,
            torque_limits: Vec::new(),
            steps: 12,
            threads: 1,
        }
    }
}
