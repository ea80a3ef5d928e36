//! Floor 2: excitation motions: Fourier series, the limits they keep, how well they excite, and a search for good ones.

#![forbid(unsafe_code)]

pub mod criterion;
mod error;
pub mod fourier;
pub mod limits;
pub mod nominal;
pub mod optimiser;
pub mod plan;
pub mod rehearsal;
pub mod search;
pub mod usage;

pub use error::ExciteError;
