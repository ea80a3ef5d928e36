//! `plumbline compare`: changes of the arm since a model was identified.

use crate::cli::output::Output;
use crate::failure::Failure;
use crate::offline::compare::{self, compare};
use clap::Args;

/// Options of `plumbline compare`.
#[derive(Args)]
#[group(skip)]
pub struct Options {
    #[command(flatten)]
    work: compare::Options,
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
    let report = compare(&work)?;
    output.show(&report, work.out())
}
