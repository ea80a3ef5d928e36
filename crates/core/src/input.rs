//! Error type of invalid input. It names the file, the position in it, the value and what was expected.

use serde::de::DeserializeOwned;

/// Invalid input of a user or a file. The program ends with exit code 2.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{file}: {place}: got {value}, expected {expected}")]
pub struct BadInput {
    /// File, or the name of the command-line option.
    pub file: String,
    /// Key path (`job.identify.periods`) or line and column (`line 7, column tau3`).
    pub place: String,
    /// The value found.
    pub value: String,
    /// Description of a valid value.
    pub expected: String,
}

impl BadInput {
    /// An error from its four parts.
    pub fn new(
        file: impl Into<String>,
        place: impl Into<String>,
        value: impl ToString,
        expected: impl Into<String>,
    ) -> BadInput {
        BadInput { file: file.into(), place: place.into(), value: value.to_string(), expected: expected.into() }
    }
}

/// Parses TOML text into a typed value; `file` appears in the error only.
pub fn from_toml<T: DeserializeOwned>(file: &str, text: &str) -> Result<T, BadInput> {
    let syntax = |error: toml::de::Error| {
        let line = error.span().map_or(0, |span| 1 + text[..span.start.min(text.len())].matches('\n').count());
        let found = error.span().and_then(|span| text.get(span)).unwrap_or("").lines().next().unwrap_or("").to_string();
        // The span of a missing key is empty: the whole line is quoted instead.
        let whole_line = || text.lines().nth(line.saturating_sub(1)).unwrap_or("").trim().to_string();
        let found = if found.trim().is_empty() { whole_line() } else { found };
        BadInput::new(file, format!("line {line}"), format!("`{found}`"), expectation(error.message()))
    };
    let deserializer = toml::Deserializer::parse(text).map_err(syntax)?;
    serde_path_to_error::deserialize(deserializer).map_err(|error| {
        let path = error.path().to_string();
        let mut bad = syntax(error.into_inner());
        if path != "." {
            bad.place = format!("{}, key `{path}`", bad.place);
        }
        bad
    })
}

/// Extracts the description of a valid value from serde's error message, for [`BadInput::expected`].
pub fn expectation(message: &str) -> String {
    if message.starts_with("unknown field") {
        return format!("a known key ({message})");
    }
    if message.starts_with("missing field") {
        return format!("all required keys ({message})");
    }
    message.split_once(", expected ").map_or(message, |(_, expected)| expected).to_string()
}
