//! Damages every kind of file that plumbline reads at random for as long as one likes, and holds the readers to their promises:
//! an answer or a refusal that names the file, no panic, no more than a few seconds, no more than 4 GiB of memory.
//!
//!     cargo run --example fuzz_files -- --seconds 600 --seed 7
//!
//! (or `hil/fuzz-files`, which passes its arguments on). A failure names its seed and case; `--seed S --first CASE --cases 1` repeats it.

#[path = "../tests/fuzz_files/fuzz.rs"]
mod fuzz;

use clap::Parser;
use fuzz::{Bench, Files, TARGETS, Tally, case};
use rustix::process::{Resource, Rlimit, setrlimit};
use std::error::Error;
use std::process::ExitCode;
use std::time::{Duration, Instant};

/// Memory that no file of a few kilobytes may need \[bytes\].
const MEMORY: u64 = 4 << 30;

#[derive(Parser)]
#[command(about = "Damages the files that plumbline reads and holds their readers to their promises")]
struct Arguments {
    /// Seed of the cases.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Number of the first case.
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// How many cases; without it, as many as fit into the time.
    #[arg(long)]
    cases: Option<u64>,
    /// How long to go on [s].
    #[arg(long, default_value_t = 60)]
    seconds: u64,
}

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let arguments = Arguments::parse();
    setrlimit(Resource::As, Rlimit { current: Some(MEMORY), maximum: Some(MEMORY) })?;
    let folder = std::env::temp_dir().join(format!("fuzz-files-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    let files = Files::shipped();
    let bench = Bench { files: &files, folder: &folder };
    let end = arguments.cases.map_or(u64::MAX, |cases| arguments.first.saturating_add(cases));
    let start = Instant::now();
    let mut tally = Tally::default();
    let mut number = arguments.first;
    let mut wrong = None;
    while wrong.is_none() && number < end && start.elapsed() < Duration::from_secs(arguments.seconds) {
        let played =
            std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| case(&bench, arguments.seed, number, &mut tally)));
        wrong = match played {
            Ok(outcome) => outcome.err(),
            Err(_) => Some(format!("seed {}, case {number}: panicked", arguments.seed)),
        };
        number += 1;
    }
    std::fs::remove_dir_all(&folder)?;
    println!("{} cases of seed {} in {:.1} s", number - arguments.first, arguments.seed, start.elapsed().as_secs_f64());
    for (index, target) in TARGETS.iter().enumerate() {
        println!("{target:8} {:10} read {:10} refused", tally.read[index], tally.refused[index]);
    }
    Ok(wrong.map_or(ExitCode::SUCCESS, |why| {
        eprintln!("{why}");
        ExitCode::FAILURE
    }))
}
