//! The product's own files with loom's atomics in place of the standard library's.

#[path = "../../../src/joint.rs"]
#[allow(dead_code)]
pub mod joint;
pub mod rt;
#[cfg(test)]
mod rings;
