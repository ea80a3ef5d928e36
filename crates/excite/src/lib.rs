//! Floor 2: excitation motions: Fourier series, the limits they keep, how well they excite, and a search for good ones.

#![forbid(unsafe_code)]

mod criterion;
mod error;
mod fourier;
mod limits;
mod nominal;
mod optimiser;
mod plan;
mod rehearsal;
mod search;
mod usage;

pub use criterion::{Criterion, MAX_CONDITION, check_excitation, evaluate, raw_condition, sampled};
pub use fourier::{Fourier, PeriodicMotion, Point};
pub use limits::{Bounds, Margins, Peak, Quantity, check_pose, verify};
pub use nominal::Nominal;
pub use optimiser::grid::Grid;
pub use optimiser::objective::{Objective, Sharpness};
pub use optimiser::optimise;
pub use plan::{Constraints, Plan, PlanUsage, parse_plan, plan_text};
pub use rehearsal::rehearse_points;
pub use search::{Problem, Progress, Search, Watch, conditions_together, motion_samples, random_plan, search_verdict};
pub use usage::{MIN_USAGE, Usage, check_usage, least_usage, usage};

pub use error::ExciteError;
