//! What every process does: log, tell systemd how it is, take signals, check whose files it reads.

pub mod journal;
mod outbox;
pub mod owned;
pub mod progress;
pub mod service;
pub mod signals;
