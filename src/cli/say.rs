//! What a command prints when its work is done. A standard output that nobody reads any more, or that is full, costs the words and not the work:
//! `println!` would panic.

/// Prints a line to standard output, if it can.
macro_rules! say {
    ($($words:tt)*) => {{
        use std::io::Write as _;
        let _ = writeln!(std::io::stdout(), $($words)*);
    }};
}

pub(crate) use say;
