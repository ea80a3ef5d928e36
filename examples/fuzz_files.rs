//! Damages every kind of file that plumbline reads at random for as long as one likes, and holds the readers to their promises:
//! an answer or a refusal that names the file, no panic, no more than a few seconds, no more than 4 GiB of memory.
//!
//!     cargo run --example fuzz_files -- --seconds 600 --seed 7
//!
//! (or `hil/fuzz-files`, which passes its arguments on). A failure names its seed and case; `--seed S --first CASE --cases 1` repeats it.

use clap::Parser;
use plumbline_testkit::fuzz::arguments::Cases;
use plumbline_testkit::fuzz::files::{Bench, Files, TARGETS, Tally, case};
use rustix::process::{Resource, Rlimit, setrlimit};
use std::error::Error;
use std::process::ExitCode;

/// Memory that no file of a few kilobytes may need \[bytes\].
const MEMORY: u64 = 4 << 30;

#[derive(Parser)]
#[command(about = "Damages the files that plumbline reads and holds their readers to their promises")]
struct Arguments {
    #[command(flatten)]
    cases: Cases,
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let Arguments { cases } = Arguments::parse();
    setrlimit(Resource::As, Rlimit { current: Some(MEMORY), maximum: Some(MEMORY) })?;
    let folder = std::env::temp_dir().join(format!("fuzz-files-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let files = Files::shipped();
    let bench = Bench { files: &files, folder: &folder };
    let mut tally = Tally::default();
    let outcome = cases.run(|number| case(&bench, cases.seed, number, &mut tally));
    std::fs::remove_dir_all(&folder)?;
    for (index, target) in TARGETS.iter().enumerate() {
        println!("{target:8} {:10} read {:10} refused", tally.read[index], tally.refused[index]);
    }
    Ok(outcome.map_or_else(
        |why| {
            eprintln!("{why}");
            ExitCode::FAILURE
        },
        |()| ExitCode::SUCCESS,
    ))
}
