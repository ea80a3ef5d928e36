//! `plumbline import`: recordings of other programs as a dataset.

use crate::analysis::checks;
use crate::cli::say::say;
use crate::failure::Failure;
use crate::offline::import::{self, Imported, import};
use clap::Args;
use plumbline_identify::check::State;

/// Options of `plumbline import`.
#[derive(Args)]
#[group(skip)]
pub struct Options {
    #[command(flatten)]
    import: import::Options,
}

/// Prints what was understood of the recordings and what the checks of `plumbline check` found, and writes the dataset.
pub fn run(Options { import: options }: Options) -> Result<(), Failure> {
    let Imported { dataset, notes, findings } = import(&options)?;
    for (path, notes) in notes {
        say!("{}", path.display());
        notes.iter().for_each(|note| say!("  {note}"));
    }
    let notable = findings.iter().filter(|finding| finding.state > State::Pass);
    notable.for_each(|finding| say!("{}", checks::line(finding)));
    let failed = findings.iter().filter(|finding| finding.state == State::Fail).count();
    let Some(out) = options.out.as_ref().filter(|_| !options.dry_run) else {
        say!("nothing was written; {failed} checks failed");
        return Ok(());
    };
    dataset.write(out).map_err(Failure::job)?;
    let joints = dataset.runs.first().map_or(0, |run| run.data.q.ncols());
    say!("{}: {} runs of {joints} joints; {failed} checks failed", out.display(), dataset.runs.len());
    Ok(())
}
