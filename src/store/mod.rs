//! Files of results: identified models, plans, exports.

mod consistent;
pub mod export;
mod model_file;
mod model_text;
mod plan_file;
mod uncertainty;

pub use model_file::{ModelFile, Provenance, Validated, model_identity};
pub use plan_file::{load_plan, save_plan};
pub use uncertainty::uncertainty_of;

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_string()).to_string()
}
