//! Output of results. A closed or full standard output is ignored; `println!` would panic.

use crate::report::Report;
use std::path::Path;

/// Prints a line to standard output and ignores errors.
macro_rules! say {
    ($($words:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stdout(), $($words)*);
    }};
}

pub(crate) use say;

/// Prints the summary of a report and where it is.
pub(super) fn say_report(report: &Report, out: &Path) {
    for line in report.summary() {
        say!("{line}");
    }
    say!("report: {}", out.join("report.html").display());
}
