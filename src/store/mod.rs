//! Files of results: identified models, plans, exports.

pub mod export;
mod plan_file;
pub mod trajectory;

pub use plan_file::{load_plan, save_plan};
pub use plumbline_model_file::{ModelFile, Provenance, Validated, model_identity, uncertainty_of};
