//! Floor 3: the files that a person writes, parsed once into checked values; every algorithm gets only its own.

pub mod job;
pub mod robot;
pub mod units;
