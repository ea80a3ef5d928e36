//! Output of results. A closed or full standard output is ignored; `println!` would panic.

/// Prints a line to standard output and ignores errors.
macro_rules! say {
    ($($words:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stdout(), $($words)*);
    }};
}

pub(crate) use say;
