//! `plumbline identify`: the identification offline, from files.

use crate::cli::say::say_report;
use crate::failure::Failure;
pub use crate::offline::identify::Options;
use crate::offline::identify::identify;

/// Writes the results and prints a summary.
pub fn run(options: Options) -> Result<(), Failure> {
    let report = identify(&options)?;
    say_report(&report, options.out());
    Ok(())
}
