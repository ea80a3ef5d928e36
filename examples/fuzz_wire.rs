//! Damages packets of the Franka Control Interface at random for as long as one likes, and holds the decoders to their promises:
//! no panic, and what is decoded encodes to the same bytes again.
//!
//!     cargo run --example fuzz_wire -- --seconds 600 --seed 7
//!
//! (or `hil/fuzz-wire`, which passes its arguments on). A failure names its seed and case; `--seed S --first CASE --cases 1` repeats it.
//! `cargo test --test fci_wire` runs 400,000 cases of seed 1.

#[path = "../tests/fci_wire/draw.rs"]
mod draw;
#[path = "../tests/fci_wire/fuzz.rs"]
mod fuzz;

use std::process::ExitCode;
use std::time::{Duration, Instant};

use clap::Parser;
use fuzz::{TARGETS, Tally, case};

/// Cases between two looks at the clock.
const BATCH: u64 = 10_000;

#[derive(Parser)]
#[command(about = "Damages packets of the Franka Control Interface and holds the decoders to their promises")]
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

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let end = arguments.cases.map_or(u64::MAX, |cases| arguments.first.saturating_add(cases));
    let start = Instant::now();
    let mut tally = Tally::default();
    let mut number = arguments.first;
    while number < end && start.elapsed() < Duration::from_secs(arguments.seconds) {
        for _ in 0..BATCH.min(end - number) {
            let outcome = std::panic::catch_unwind(|| {
                let mut tally = tally;
                case(arguments.seed, number, &mut tally).map(|()| tally)
            });
            match outcome {
                Ok(Ok(counted)) => tally = counted,
                Ok(Err(why)) => {
                    eprintln!("{why}");
                    return ExitCode::FAILURE;
                }
                Err(_) => {
                    eprintln!("seed {}, case {number}: panicked", arguments.seed);
                    return ExitCode::FAILURE;
                }
            }
            number += 1;
        }
    }
    println!("{} cases of seed {} in {:.1} s", number - arguments.first, arguments.seed, start.elapsed().as_secs_f64());
    for (index, target) in TARGETS.iter().enumerate() {
        println!("{target:10} {:12} decoded {:12} refused", tally.decoded[index], tally.refused[index]);
    }
    ExitCode::SUCCESS
}
