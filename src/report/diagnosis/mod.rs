//! The block `diagnosis` of `report.json` in words, tables and plots. Its types are those of [`plumbline_diagnose::outcome`].

mod errors;
mod page;
mod plots;
mod rows;
mod words;

pub(super) use errors::grown;
pub(super) use page::{TEMPLATES, context};
pub use plumbline_diagnose::errors::Errors;
pub use plumbline_diagnose::outcome::{
    Action, Alternative, BeforeAfter, Changes, Confirmation, Diagnosis, Effect, Empirical, Folds, JointFacts,
    MinimumDetectable, NotIdentifiable, Open, OpenKind, Parameters, Quality, Quantity, Score, Step, Stratum, Symbolic,
    Unexplained, Verdict,
};
pub(super) use words::{confirmation_of_one, findings_in_short, headline, lines, name, open_question};
