//! Floor 3: the files that a person writes, parsed once into checked values.

pub mod robot;
