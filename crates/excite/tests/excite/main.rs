//! Tests of the crate against independent computations and simulated arms.

mod search;
