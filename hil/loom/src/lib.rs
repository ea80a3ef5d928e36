//! The rings of the loop with loom's atomics in place of the standard library's. The loop's own atomics are tested in `crates/rt`.

#[cfg(test)]
mod rings;
