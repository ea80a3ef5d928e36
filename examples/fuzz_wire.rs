//! Damages packets of the Franka Control Interface at random for as long as one likes, and holds the decoders to their promises:
//! no panic, and what is decoded encodes to the same bytes again.
//!
//!     cargo run --example fuzz_wire -- --seconds 600 --seed 7
//!
//! (or `hil/fuzz-wire`, which passes its arguments on). A failure names its seed and case; `--seed S --first CASE --cases 1` repeats it.
//! `cargo test --test wire` runs 400,000 cases of seed 1.

use clap::Parser;
use plumbline_testkit::fuzz::arguments::Cases;
use plumbline_testkit::fuzz::wire::{TARGETS, Tally, case};
use std::process::ExitCode;

#[derive(Parser)]
#[command(about = "Damages packets of the Franka Control Interface and holds the decoders to their promises")]
struct Arguments {
    #[command(flatten)]
    cases: Cases,
}

fn main() -> ExitCode {
    let Arguments { cases } = Arguments::parse();
    let mut tally = Tally::default();
    let outcome = cases.run(|number| case(cases.seed, number, &mut tally));
    for (index, target) in TARGETS.iter().enumerate() {
        println!("{target:10} {:12} decoded {:12} refused", tally.decoded[index], tally.refused[index]);
    }
    outcome.map_or_else(
        |why| {
            eprintln!("{why}");
            ExitCode::FAILURE
        },
        |()| ExitCode::SUCCESS,
    )
}
