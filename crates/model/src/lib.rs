//! Floor 1: the arm's dynamics as pure functions. No I/O, no clock, no configuration.

pub mod base;
pub mod chain;
pub mod conditioning;
pub mod expression;
pub mod fast;
pub mod gravity;
pub mod inertia;
pub mod regressor;
pub mod rnea;
pub mod robot;
pub mod shape;
pub mod structure;
pub mod term;
pub mod torque;
