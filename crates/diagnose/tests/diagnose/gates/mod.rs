//! The gates of the diagnosis: score, folds, relevance, veto, delivery, verdict, and the intervals of the errors, each on both sides of its
//! threshold. A two-joint arm with chosen torques makes the evidence, so that every test takes less than a few seconds.

mod choice;
mod empirical;
mod errors;
mod left_out;
mod outcome;
mod relevance;
mod search;
pub mod synthetic;
mod whole;
