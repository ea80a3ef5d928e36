//! Floor 2: from measured samples to base parameters with honest standard deviations.

pub mod signal;
