//! `plumbline identify`: the identification offline, from files.

use crate::cli::output::Output;
use crate::failure::Failure;
use crate::offline::identify::{self, identify};
use clap::Args;

/// Options of `plumbline identify`.
#[derive(Args)]
#[group(skip)]
pub struct Options {
    #[command(flatten)]
    work: identify::Options,
    #[command(flatten)]
    output: Output,
}

impl Options {
    pub(super) fn output(&self) -> &Output {
        &self.output
    }
}

/// Writes the results and shows them.
pub fn run(options: Options) -> Result<(), Failure> {
    let Options { work, output } = options;
    output.may_replace(work.out(), work.dataset())?;
    let report = identify(&work)?;
    output.show(&report, work.out())
}
