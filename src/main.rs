//! The `plumbline` program; see [`plumbline::cli`].

#![forbid(unsafe_code)]

use std::process::ExitCode;

/// The system's allocator, with a check that the real-time cycle does not allocate.
#[global_allocator]
static ALLOCATOR: assert_no_alloc::AllocDisabler = assert_no_alloc::AllocDisabler;

fn main() -> ExitCode {
    plumbline::cli::main()
}
