//! Random bytes and changed files against everything that reads: shared by short tests and long campaigns.

pub mod arguments;
pub mod draw;
#[cfg(feature = "program")]
pub mod files;
pub mod wire;
