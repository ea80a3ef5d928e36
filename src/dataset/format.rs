//! Formats of a run's file.

use schemars::JsonSchema;
use serde::Deserialize;

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// Text, a line per sample.
    #[default]
    Csv,
    /// Messages of ROS 2, compressed.
    Mcap,
}

impl Format {
    /// The format of a file, by its name.
    pub fn of(name: &str) -> Format {
        if name.ends_with(".mcap") { Format::Mcap } else { Format::Csv }
    }

    /// End of the file's name, with its dot.
    pub fn ending(self) -> &'static str {
        match self {
            Format::Csv => ".csv",
            Format::Mcap => ".mcap",
        }
    }

    /// Place of the columns' names in a file.
    pub(super) fn header(self) -> &'static str {
        match self {
            Format::Csv => "line 1",
            Format::Mcap => "columns",
        }
    }

    /// Place of the samples in a file.
    pub(super) fn body(self) -> &'static str {
        match self {
            Format::Csv => "after the header",
            Format::Mcap => "messages",
        }
    }

    /// Place of a sample, counted from 0.
    pub(super) fn sample(self, index: usize) -> String {
        match self {
            // The header is line 1.
            Format::Csv => format!("line {}", index + 2),
            // As in the messages' sequence numbers.
            Format::Mcap => format!("sample {index}"),
        }
    }
}

/// The name of a run without the end of its file's name.
pub fn stem(name: &str) -> &str {
    name.strip_suffix(Format::of(name).ending()).unwrap_or(name)
}
