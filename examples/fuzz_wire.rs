//! Damages packets of the Franka Control Interface at random for as long as one likes, and holds the decoders to their promises:
//! no panic, and what is decoded encodes to the same bytes again.
//!
//!     cargo run --example fuzz_wire -- --seconds 600 --seed 7
//!
//! (or `hil/fuzz-wire`, which passes its arguments on). A failure names its seed and case; `--seed S --first CASE --cases 1` repeats it.
//! `cargo test --test wire` runs 400,000 cases of seed 1.

use std::process::ExitCode;
use std::time::Instant;

use clap::Parser;
use plumbline_testkit::fuzz::arguments::Cases;
use plumbline_testkit::fuzz::wire::{TARGETS, Tally, case};

/// Cases between two looks at the clock.
const BATCH: u64 = 10_000;

#[derive(Parser)]
#[command(about = "Damages packets of the Franka Control Interface and holds the decoders to their promises")]
struct Arguments {
    #[command(flatten)]
    cases: Cases,
}

fn main() -> ExitCode {
    let Arguments { cases } = Arguments::parse();
    let end = cases.end();
    let start = Instant::now();
    let mut tally = Tally::default();
    let mut number = cases.first;
    while number < end && cases.in_time(start) {
        for _ in 0..BATCH.min(end - number) {
            let outcome = std::panic::catch_unwind(|| {
                let mut tally = tally;
                case(cases.seed, number, &mut tally).map(|()| tally)
            });
            match outcome {
                Ok(Ok(counted)) => tally = counted,
                Ok(Err(why)) => {
                    eprintln!("{why}");
                    return ExitCode::FAILURE;
                }
                Err(_) => {
                    eprintln!("seed {}, case {number}: panicked", cases.seed);
                    return ExitCode::FAILURE;
                }
            }
            number += 1;
        }
    }
    println!("{} cases of seed {} in {:.1} s", number - cases.first, cases.seed, start.elapsed().as_secs_f64());
    for (index, target) in TARGETS.iter().enumerate() {
        println!("{target:10} {:12} decoded {:12} refused", tally.decoded[index], tally.refused[index]);
    }
    ExitCode::SUCCESS
}
