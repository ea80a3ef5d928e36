//! Excitation motions: Fourier series that start and end at rest, their limits, excitation criteria, and the search for optimal motions.
//!
//! | what | items |
//! |---|---|
//! | the motion and its samples for the loop | [`Fourier`], [`PeriodicMotion`] |
//! | limits of joints, workspace, self-collision, torques | [`Bounds`], [`verify`], [`check_pose`] |
//! | the rules of the loop's guard | [`check_points_with_guard`] |
//! | condition numbers and information | [`Criterion`], [`evaluate`], [`check_excitation`] |
//! | search | [`Problem`], [`Search`], [`optimise`], [`best_by_score`], [`random_plan`] |
//! | plan file | [`Plan`], [`parse_plan`], [`plan_text`] |
//!
//! ```
//! use plumbline_excite::{Bounds, Fourier, Margins, verify};
//! use plumbline_model::Robot;
//!
//! let panda = Robot::load("panda", None)?;
//! let bounds = Bounds::new(&panda.chain, &panda.limits, Margins::default());
//! let mut motion = Fourier::still(10.0, vec![0.0, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5], 5)?;
//! assert!(verify(&bounds, &motion, None).is_feasible());
//! // The joint's range ends at 2.8973 rad.
//! motion.q0[0] = 2.9;
//! assert!(!verify(&bounds, &motion, None).is_feasible());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]

mod criterion;
mod error;
mod fourier;
mod guard_check;
mod limits;
mod nominal;
mod optimiser;
mod plan;
mod scored;
mod search;
mod usage;

pub use criterion::{Criterion, MAX_CONDITION, check_excitation, evaluate, sampled};
pub use fourier::{Fourier, PeriodicMotion, Point};
pub use guard_check::check_points_with_guard;
pub use limits::{Bounds, Margins, Peak, Quantity, check_pose, verify};
pub use nominal::Nominal;
pub use optimiser::grid::Grid;
pub use optimiser::objective::{Objective, Smoothing};
pub use optimiser::optimise;
pub use plan::{Constraints, Plan, PlanSearch, PlanUsage, parse_plan, plan_text};
pub use scored::best_by_score;
pub use search::{
    Problem, Progress, Search, SearchControl, motion_samples, random_plan, stacked_conditions, verify_with_guard,
};
pub use usage::{MIN_USAGE, Usage, check_usage, least_usage, usage};

pub use error::ExciteError;
