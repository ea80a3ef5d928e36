//! How the commands that make a report show their results, and which results they replace.

use crate::cli::say::say;
use crate::failure::Failure;
use crate::report::Report;
use crate::report::provenance::{self, SOURCE};
use crate::report::table::{Table, Tone};
use clap::Args;
use plumbline_core::BadInput;
use std::io::IsTerminal;
use std::path::Path;
use std::process::{Command, Stdio};

/// Options of every command that makes a report.
#[derive(Args, Clone, Debug, Default)]
pub struct Output {
    /// Print all that the report says, and every line of the log
    #[arg(short, long, conflicts_with_all = ["quiet", "json"])]
    pub verbose: bool,
    /// Print nothing but errors
    #[arg(short, long)]
    pub quiet: bool,
    /// Print report.json instead of the table
    #[arg(long, conflicts_with = "quiet")]
    pub json: bool,
    /// Open report.html when it is written
    #[arg(long)]
    pub open: bool,
    /// Replace the results of another job or dataset
    #[arg(long)]
    pub force: bool,
}

impl Output {
    /// Filter of the log, where `PLUMBLINE_LOG` does not give one.
    pub fn log_filter(&self) -> &'static str {
        match (self.quiet, self.verbose) {
            (true, _) => "error",
            (_, true) => "warn,plumbline=info",
            _ => "warn",
        }
    }

    /// Refuses a folder with the results of another `source`. The same job or dataset may be used again.
    ///
    /// # Errors
    /// Exit code 2 with both sources.
    pub fn may_replace(&self, out: &Path, source: &Path) -> Result<(), Failure> {
        let source = provenance::source(source);
        let path = out.join("report.json");
        if self.force || !path.exists() {
            return Ok(());
        }
        let found = match Report::read(out) {
            Ok(report) => match report.provenance.get(SOURCE).and_then(|source| source.as_str()) {
                Some(of) if of == source => return Ok(()),
                Some(of) => format!("results of {of}"),
                None => "results of an unknown source".into(),
            },
            Err(_) => "a file that is no report".into(),
        };
        let expected = format!("no results, or those of {source}: give another --out, or --force to replace them");
        Err(BadInput::new(path.display().to_string(), "key `provenance.source`", found, expected).into())
    }

    /// Prints the results in `out`, and opens the report where that was asked for.
    pub fn show(&self, report: &Report, out: &Path) -> Result<(), Failure> {
        let page = out.join("report.html");
        if self.json {
            say!("{}", report.to_json().map_err(Failure::job)?.trim_end());
        } else if self.verbose {
            report.in_words().iter().for_each(|line| say!("{line}"));
            say!("report: {}", page.display());
        } else if !self.quiet {
            coloured(&report.table(), colours()).iter().for_each(|line| say!("{line}"));
            say!("report: {}", page.display());
        }
        if self.open { open(&page) } else { Ok(()) }
    }
}

/// Whether standard output takes colours: a terminal, without `NO_COLOR` (<https://no-color.org>).
fn colours() -> bool {
    let set = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty());
    std::io::stdout().is_terminal() && set("NO_COLOR").is_none() && set("TERM").is_none_or(|term| term != "dumb")
}

/// The lines with the verdict in bold and in its colour.
fn coloured(table: &Table, colours: bool) -> Vec<String> {
    let mut lines = table.lines.clone();
    if let (Some((line, length, tone)), true) = (table.verdict, colours) {
        let code = match tone {
            Tone::Good => 32,
            Tone::Warn => 33,
            Tone::Bad => 31,
        };
        let (verdict, rest) = lines[line].split_at(length);
        lines[line] = format!("\x1b[1;{code}m{verdict}\x1b[0m{rest}");
    }
    lines
}

/// Opens a page as the desktop does.
fn open(page: &Path) -> Result<(), Failure> {
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let started =
        Command::new(opener).arg(page).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).status();
    match started {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(Failure::job(format!("`{opener} {}` failed: {status}", page.display()))),
        Err(error) => Err(Failure::job(format!("`{opener}` can't be started to open {}: {error}", page.display()))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_gets_the_verdict_in_colour() {
        let table = Table { lines: vec!["a".into(), "partly: b".into()], verdict: Some((1, 6, Tone::Warn)) };
        assert_eq!(coloured(&table, true)[1], "\x1b[1;33mpartly\x1b[0m: b");
        assert_eq!(coloured(&table, false), table.lines);
    }

    #[test]
    fn results_of_another_source_are_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path();
        let output = Output::default();
        let code = |output: &Output, source: &str| {
            output.may_replace(out, Path::new(source)).map_err(|failure| failure.code())
        };
        assert_eq!(code(&output, "/a"), Ok(()));
        let mut report = Report::default();
        for (source, own, other) in [(Some("/a"), Ok(()), Err(2)), (None, Err(2), Err(2))] {
            report.provenance = source.map(|source| (SOURCE.to_string(), source.into())).into_iter().collect();
            std::fs::write(out.join("report.json"), report.to_json().unwrap()).unwrap();
            assert_eq!((code(&output, "/a"), code(&output, "/b")), (own, other));
            assert_eq!(code(&Output { force: true, ..Output::default() }, "/b"), Ok(()));
        }
        std::fs::write(out.join("report.json"), "{").unwrap();
        let refused = output.may_replace(out, Path::new("/a")).unwrap_err().to_string();
        assert!(refused.contains("report.json") && refused.contains("--force"), "{refused}");
    }
}
