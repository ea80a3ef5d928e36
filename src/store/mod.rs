//! Floor 3: the files that plumbline keeps: identified models.

mod model_file;
mod model_text;

pub use model_file::{ModelFile, Provenance, Validated, model_identity};
