//! What an identified model lacks: the residual is traced to an effect, the effect is added, and the error before and after is measured on data
//! that was not fitted.
//!
//! [`Evidence`] (torques and columns as Fourier coefficients with known noise) -> fits and the likelihood that a candidate brings ->
//! [`library()`] (the candidates) -> [`Search`] (forward selection, backward elimination) with gates -> [`diagnose()`] (unseen runs, adequacy,
//! verdict) -> [`Outcome`]. What stays unexplained is described by the variables that it follows, [`unexplained()`], and a learned term without a name
//! takes what it can ([`outcome::Empirical`]).
//!
//! | what | items |
//! |---|---|
//! | diagnosis | [`diagnose()`], [`Input`], [`Settings`], [`Outcome`], [`Verdict`] |
//! | what changed since a model was identified | [`mod@reference`] |
//! | the same while the model is served | [`live`] |
//! | what differs from period to period | [`changing`] |
//! | what is left open, and what a planned motion would answer | [`OpenQuestions`] |
//! | the outcome, as `report.json` has it | [`mod@outcome`], [`mod@figures`] |
//! | errors before and after with confidence intervals | [`errors`] |
//!
//! ```no_run
//! use plumbline_diagnose::{Input, Settings, Trial, diagnose};
//! use plumbline_identify::{Experiment, solve};
//! use plumbline_model::Structure;
//!
//! fn lacking(model: &Structure, fitted: &[Experiment], unseen: &[Experiment]) -> Result<(), Box<dyn std::error::Error>> {
//!     let (identify, veto) = (Trial::in_turn(fitted), Trial::in_turn(unseen));
//!     let options = &solve::Options::default();
//!     let input = Input { structure: model, identify: &identify, veto: &veto, judge: &[], options, parts: &[] };
//!     let outcome = diagnose(&input, &Settings::default(), &|_| {})?;
//!     println!("{}: {} effects", outcome.diagnosis.verdict, outcome.diagnosis.effects.len());
//!     Ok(())
//! }
//! ```

#![forbid(unsafe_code)]

mod acting;
pub mod changing;
mod curves;
mod delivery;
mod detectable;
mod deviations;
mod diagnosis;
mod disagreement;
mod empirical;
pub mod errors;
mod evidence;
mod fallback;
pub mod figures;
mod fit;
mod fold;
mod gates;
mod library;
pub mod live;
mod moments;
mod open;
pub mod outcome;
mod parts;
pub mod reference;
mod search;
mod select;
mod span;
mod state;
// The two-joint arm of the integration tests, for tests of what is not public.
#[cfg(test)]
extern crate self as plumbline_diagnose;
#[cfg(test)]
#[allow(dead_code)]
#[path = "../tests/diagnose/gates/synthetic.rs"]
mod synthetic;
mod unseen;

/// Hash of the sources that a verdict depends on: those of this crate, of the estimate and of the effects. A figure names the rules that it was made with.
pub const RULES: &str = env!("PLUMBLINE_RULES");

pub use diagnosis::{Input, diagnose};
pub use evidence::{Evidence, Trial};
pub use fallback::{Residual, Variable, lack_of_fit, lacks, unexplained};
pub use fit::{Problem, group, inverse};
pub use fold::Fold;
pub use gates::{FoldTest, Relevance, folds, left_out, matters, relevance};
pub use library::{Candidate, library};
pub use moments::Columns;
pub use open::{Answer, OpenQuestions, Question};
pub use outcome::{Confirmation, Diagnosis, Disagreement, Effect, Fitted, JointFacts, Outcome, Verdict};
pub use select::{Rival, Scored, Search, Selected, Step};
pub use span::Span;
pub use state::{State, mean_square};

/// How a diagnosis is done.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Highest frequency that counts \[Hz\].
    pub band: f64,
    /// Least RMS of an effect that matters \[Nm\]; by default a share of the noise floor.
    pub threshold: Option<f64>,
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
    /// Wanted half width of the 95 % intervals of effects' parameters, as a share of their values; a wider one is an open question.
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
