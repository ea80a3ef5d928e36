//! Files of results: identified models, plans, exports.

mod consistent;
pub mod export;
mod model_file;
mod model_text;
mod plan_file;

pub use model_file::{ModelFile, Provenance, Validated, model_identity};
pub use plan_file::{load_plan, save_plan};

fn quoted(text: &str) -> String {
    toml::Value::String(text.to_string()).to_string()
}
