//! Where a report comes from: keys of [`Report::provenance`](super::Report::provenance).

use std::path::Path;

/// Key with the absolute path of the job or dataset that a report was made from.
pub const SOURCE: &str = "source";
/// Key with the command that made it.
pub const COMMAND: &str = "command";

/// The absolute path of a job or dataset.
pub fn source(path: &Path) -> String {
    std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf()).display().to_string()
}
