//! The `plumbline` program: parses the command line and hands over to [`plumbline::cli`].

#![forbid(unsafe_code)]

use std::process::ExitCode;

/// Counts allocations inside the real-time cycle, where there must be none; elsewhere it is the system's allocator.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

fn main() -> ExitCode {
    plumbline::cli::main()
}
