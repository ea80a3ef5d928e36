//! The tables and figures of the paper, computed again.

pub mod experiment;
pub mod figures;
pub mod tables;
