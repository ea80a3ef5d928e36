//! `plumbline diagnose`: finds effects that a plain model of recorded data lacks, offline.

use crate::cli::output::Output;
use crate::failure::Failure;
use crate::offline::diagnose::{self, diagnose};
use clap::Args;

/// Options of `plumbline diagnose`.
#[derive(Args)]
#[group(skip)]
pub struct Options {
    #[command(flatten)]
    work: diagnose::Options,
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
    let report = diagnose(&work)?;
    output.show(&report, work.out())
}
