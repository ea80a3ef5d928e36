//! Work on files without a daemon. The command line and the Python package call the same functions with the same options.

pub mod compare;
pub mod diagnose;
pub mod identify;
pub mod import;
pub mod payload;
pub mod plan;
pub mod predict;

use clap::{Args, Command};
use std::ffi::OsString;

/// Options from arguments as on the command line, without the name of the program.
///
/// # Errors
/// That of the command line.
pub fn options<O: Args>(arguments: impl IntoIterator<Item = OsString>) -> Result<O, clap::Error> {
    let command = O::augment_args(Command::new("plumbline")).no_binary_name(true).disable_help_flag(true);
    command.try_get_matches_from(arguments).and_then(|found| O::from_arg_matches(&found))
}
