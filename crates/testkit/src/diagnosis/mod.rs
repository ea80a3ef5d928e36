//! Diagnoses of simulated arms with a drawn effect, and whether they are right.

pub mod case;
pub mod trial;
