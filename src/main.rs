//! The `plumbline` program.

fn main() {}
