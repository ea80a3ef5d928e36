//! The dynamics of a serial arm for any direction of gravity: kinematics, recursive Newton-Euler algorithm, regressor, base parameters, and the
//! effects that a real arm adds to rigid bodies. Pure functions; only [`Robot`] reads files.
//!
//! | what | items |
//! |---|---|
//! | kinematics | [`Chain`], [`Robot`], [`Shape`] |
//! | mounting and gravity | [`Mounting`] |
//! | inverse dynamics and regressor of standard parameters | [`rnea()`], [`regressor()`] |
//! | base parameters | [`Reduction`], [`Structure`] |
//! | friction, rotor inertia, effects | [`term`] |
//! | identified model, evaluated in the loop | [`TorqueModel`], [`Evaluator`], [`ServedModel`] |
//! | physical consistency of a body | [`Body`], [`is_consistent`] |
//!
//! ```
//! use plumbline_model::{Mounting, Reduction, Robot, Structure};
//!
//! let panda = Robot::load("panda", None)?.chain;
//! let parameters = |reduction| Structure::of(panda.clone(), reduction, &["friction"]).map(|model| model.columns().len());
//! // Two parameters have no influence on the torque while gravity is parallel to the first axis.
//! assert_eq!(parameters(Reduction::any_mounting(&panda))?, 59);
//! assert_eq!(parameters(Reduction::in_mounting(&panda, &Mounting::UPRIGHT))?, 57);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]
// The real-time wall (clippy.toml): what the loop calls neither allocates by these means, locks, logs, reads files nor panics.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

mod axes;
mod base;
mod chain;
mod conditioning;
mod enclosing;
mod expression;
mod fast;
mod gravity;
mod inertia;
mod loop_regressor;
mod motion;
mod parameter;
mod pose;
mod regressor;
mod rnea;
mod robot;
mod robot_file;
mod sample_regressor;
mod served;
mod shape;
mod structure;
pub mod term;
mod torque;

pub use axes::Axis;
pub use base::{BaseKind, Reduction};
pub use chain::{Chain, Joint, JointKind, Placement, StandardDh};
pub use conditioning::{Conditions, ZERO_COLUMN, condition, conditions, dependent_columns, friction_columns};
pub use enclosing::{Enclosing, enclosing};
pub use expression::{base_columns, parameter_name};
pub use fast::Lanes;
pub use fast::closed::ClosedForm;
pub use fast::links::LinkColumns;
pub use gravity::{G, Mounting, VERTICAL_TOLERANCE, angle_between};
pub use inertia::{Body, is_consistent, link_parameters, pseudo_inertia};
pub use loop_regressor::LoopRegressor;
pub use parameter::{Column, Parameter};
pub use regressor::{LINK_COLUMNS, regressor};
pub use rnea::{LinkParameters, rnea};
pub use robot::Robot;
pub use robot_file::{RobotFile, TorqueSensing};
pub use sample_regressor::SampleRegressor;
pub use served::{NoModel, Reach, ServedModel};
pub use shape::{Capsule, FIRST_BOXED, Shape, nearest};
pub use structure::{ModelError, Structure};
pub use torque::{Evaluator, NamedEffect, NamedTerm, TorqueModel};
