//! Tests of the crate against independent computations and simulated arms.

mod consistency_peers;
mod estimators;
mod simulated;
mod statistics;
mod streaming;
