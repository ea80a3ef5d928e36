//! Where a report comes from: keys of [`Report::provenance`](super::Report::provenance).

use super::Report;
use std::path::Path;

/// Key with the absolute path of the job or dataset that a report was made from.
pub const SOURCE: &str = "source";
/// Key with the command that made it.
pub const COMMAND: &str = "command";

/// The absolute path of a job or dataset.
pub fn source(path: &Path) -> String {
    std::fs::canonicalize(path).unwrap_or_else(|_| path.to_path_buf()).display().to_string()
}

/// Adds the dataset or job, and the command, that a report was made from.
pub fn add_origin(report: &mut Report, source_path: &Path) {
    report.provenance.insert(SOURCE.into(), source(source_path).into());
    if let Some(command) = command_line() {
        report.provenance.insert(COMMAND.into(), command.into());
    }
}

/// The command of this process, as a shell takes it; nothing in another program than `plumbline`, as the Python package is used by.
pub fn command_line() -> Option<String> {
    let mut arguments = std::env::args_os();
    let program =
        arguments.next().filter(|program| Path::new(program).file_stem().is_some_and(|name| name == "plumbline"));
    program?;
    let arguments = arguments.map(|argument| quoted(&argument.to_string_lossy()));
    Some(std::iter::once("plumbline".to_string()).chain(arguments).collect::<Vec<_>>().join(" "))
}

fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_=./,:+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        word.to_string()
    } else {
        format!("'{}'", word.replace('\'', r"'\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_command_is_quoted_for_a_shell() {
        assert_eq!(quoted("--set=backend.pace=fast"), "--set=backend.pace=fast");
        assert_eq!((quoted("it's"), quoted("")), (r"'it'\''s'".into(), "''".into()));
    }
}
