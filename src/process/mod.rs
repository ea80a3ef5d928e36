//! Common parts of every process: logging, systemd notification, signals, ownership of the files that it reads.

pub mod journal;
mod outbox;
pub mod owned;
pub mod progress;
pub mod service;
pub mod signals;
