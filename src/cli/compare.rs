//! `plumbline compare`: changes of the arm since a model was identified.

use crate::cli::say::say_report;
use crate::failure::Failure;
pub use crate::offline::compare::Options;
use crate::offline::compare::compare;

/// Writes the results and prints a summary.
pub fn run(options: Options) -> Result<(), Failure> {
    let report = compare(&options)?;
    say_report(&report, options.out());
    Ok(())
}
