//! Resources that a job names: built in, or in a file.

use plumbline_core::BadInput;
use schemars::JsonSchema;
use serde::Deserialize;
use std::path::PathBuf;

/// A built-in resource by name, or a file.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(from = "String")]
pub enum Resource {
    /// A name without `/` and `.toml`.
    BuiltIn(String),
    /// A file; relative paths are relative to the folder of the configuration that names it.
    File(PathBuf),
}

impl From<String> for Resource {
    fn from(text: String) -> Resource {
        if text.contains('/') || text.ends_with(".toml") {
            Resource::File(text.into())
        } else {
            Resource::BuiltIn(text)
        }
    }
}

impl Resource {
    /// Name for errors and text of the resource; `built_in` holds the names and texts that the program carries.
    /// Errors: an unknown name, with those that are known, or a file that can't be read.
    pub fn read(&self, key: &str, built_in: &[(&str, &str)]) -> Result<(String, String), BadInput> {
        match self {
            Resource::File(path) => {
                let file = path.display().to_string();
                let text = std::fs::read_to_string(path)
                    .map_err(|error| BadInput::new(&file, "file", error, format!("a readable file, for `{key}`")))?;
                Ok((file, text))
            }
            Resource::BuiltIn(name) => {
                let known: Vec<&str> = built_in.iter().map(|(known, _)| *known).collect();
                let found = built_in.iter().find(|(known, _)| known == name).ok_or_else(|| {
                    let expected = format!("the path of a .toml file or one of {}", known.join(", "));
                    BadInput::new("configuration", format!("key `{key}`"), format!("`{name}`"), expected)
                })?;
                Ok((name.clone(), found.1.to_string()))
            }
        }
    }
}
