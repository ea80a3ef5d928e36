//! `plumbline diagnose`: finds effects that a plain model of recorded data lacks, offline.

use crate::cli::say::say_report;
use crate::failure::Failure;
pub use crate::offline::diagnose::Options;
use crate::offline::diagnose::diagnose;

/// Writes the results and prints a summary.
pub fn run(options: Options) -> Result<(), Failure> {
    let report = diagnose(&options)?;
    say_report(&report, options.out());
    Ok(())
}
