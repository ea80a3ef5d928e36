//! Model files (`model.toml`): an identified model with its uncertainty, validation and provenance.
//!
//! The daemon serves the text of such a file, and clients evaluate the model in their own process.
//!
//! | what | items |
//! |---|---|
//! | the file and its text | [`ModelFile`], [`Validated`], [`Provenance`] |
//! | identity of a text | [`model_identity`] |
//! | files with the robots that they are of | [`models::load`], [`models::of_robot`] |
//! | uncertainty of an identification for a file | [`uncertainty_of`] |

#![forbid(unsafe_code)]

mod consistent;
mod file;
pub mod models;
mod text;
mod uncertainty;

pub use file::{ModelFile, Provenance, Validated, model_identity};
pub use uncertainty::uncertainty_of;

/// A text as a TOML string.
fn quoted(text: &str) -> String {
    toml::Value::String(text.to_string()).to_string()
}
