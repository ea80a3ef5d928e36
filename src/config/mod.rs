//! Typed configuration. Files are parsed and checked once, here; every algorithm gets only its own values.

pub mod job;
pub mod schema;
pub mod units;
