//! Tests of the crate against independent computations and simulated arms.

mod changing;
mod compare;
mod delivery;
mod fallback;
mod gates;
mod open;
mod selection;
mod sketch;
