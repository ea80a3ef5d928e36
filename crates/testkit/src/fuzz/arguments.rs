//! What every fuzzer of `examples/` is told: which cases, and for how long.

use clap::Args;
use std::time::{Duration, Instant};

#[derive(Args)]
pub struct Cases {
    /// Seed of the cases.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
    /// Number of the first case.
    #[arg(long, default_value_t = 0)]
    pub first: u64,
    /// How many cases; without it, as many as fit into the time.
    #[arg(long)]
    cases: Option<u64>,
    /// How long to go on [s].
    #[arg(long, default_value_t = 60)]
    seconds: u64,
}

impl Cases {
    /// Number of the case that is not played any more.
    pub fn end(&self) -> u64 {
        self.cases.map_or(u64::MAX, |cases| self.first.saturating_add(cases))
    }

    /// Whether the time that began at `start` is not over.
    pub fn in_time(&self, start: Instant) -> bool {
        start.elapsed() < Duration::from_secs(self.seconds)
    }
}
