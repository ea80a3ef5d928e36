//! Tests of the crate with several processes and threads.

mod clock;
mod exchange;
mod foreign_files;
mod kill;
mod python;
mod requests;
