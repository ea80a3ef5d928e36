//! Command line and loop of the fuzzers in `examples/`.

use clap::Args;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

#[derive(Args)]
pub struct Cases {
    /// Seed of the cases.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Number of the first case.
    #[arg(long, default_value_t = 0)]
    first: u64,
    /// How many cases; without it, as many as fit into the time.
    #[arg(long)]
    cases: Option<u64>,
    /// Longest time [s].
    #[arg(long, default_value_t = 60)]
    seconds: u64,
}

impl Cases {
    /// Runs cases by their numbers until one fails, a panic included, or until their number or the time is reached. Prints their count.
    ///
    /// # Errors
    /// Why the last case failed.
    pub fn run(&self, mut case: impl FnMut(u64) -> Result<(), String>) -> Result<(), String> {
        let end = self.cases.map_or(u64::MAX, |cases| self.first.saturating_add(cases));
        let start = Instant::now();
        let (mut number, mut outcome) = (self.first, Ok(()));
        while outcome.is_ok() && number < end && start.elapsed() < Duration::from_secs(self.seconds) {
            outcome = catch_unwind(AssertUnwindSafe(|| case(number)))
                .unwrap_or_else(|_| Err(format!("seed {}, case {number}: panicked", self.seed)));
            number += 1;
        }
        println!("{} cases of seed {} in {:.1} s", number - self.first, self.seed, start.elapsed().as_secs_f64());
        outcome
    }
}
