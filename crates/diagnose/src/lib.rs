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
//!     let input = Input { structure: model, identify: &identify, veto: &veto, judge: &[], options, came: &[] };
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
mod dispersion;
mod empirical;
pub mod errors;
mod evidence;
mod fallback;
pub mod figures;
mod fit;
mod fold;
mod found;
mod gates;
mod input;
mod lenient;
mod library;
pub mod live;
mod moments;
mod open;
pub mod outcome;
mod parts;
mod proposals;
pub mod reference;
mod rows;
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
mod veto;

pub use diagnosis::{Outcome, diagnose};
pub use evidence::{Evidence, Trial};
pub use fallback::{Residual, Variable, lack_of_fit, lacks, unexplained};
pub use fit::{Problem, group, inverse};
pub use fold::Fold;
pub use found::{Progress, Rival, Step, Watch};
pub use gates::{FoldTest, Relevance, folds, left_out, matters, relevance};
pub use input::{Input, RULES, Settings};
pub use library::{Candidate, library};
pub use moments::Columns;
pub use open::{Answer, OpenQuestions, Question};
pub use outcome::{Confirmation, Diagnosis, Disagreement, Effect, Fitted, JointFacts, Verdict};
pub use proposals::Scored;
pub use select::{Search, Selected};
pub use span::Span;
pub use state::{State, mean_square};
