//! plumbline identifies the dynamics of a serial robot arm for any mounting and serves the torques it needs at 1 kHz.
//!
//! The map, floor by floor; imports point to lower floors only (`tests/floors.rs` holds that wall):
//!
//! | floor | modules | what |
//! |---|---|---|
//! | 0 | [`joint`], [`input`], [`atomic`], [`parallel`], [`decomposition`] | fixed-size values with units; how bad input is reported; how files are written; work on all processors; eigenvalues and singular values |
//! | 1 | [`model`], [`rt`] | the arm's dynamics, pure; the real-time loop and its traits |
//! | 2 | [`excite`], [`estimate`], [`backend`], [`inclinometer`], [`ipc`], [`machine`], [`recording`] | motions that excite; parameters from samples; arms; which way is down; shared memory; whether this computer keeps time; the last seconds before a fault |
//! | 3 | [`config`], [`dataset`], [`diagnose`], [`postmortem`], [`report`], [`store`] | typed configuration; recorded motions; what a model lacks; what happened before a fault; what a job says; model and plan files |
//! | 4 | [`app`] | one file per subcommand: wiring only |
//!
//! The way of the data: `excite` plans a motion, `rt` drives it through a `backend` and puts one record per cycle into a ring,
//! the daemon's bridge thread (`app::daemon`) publishes the records through `ipc`, the estimator process (`app::estimator`) turns
//! them into a model with `estimate`, and the daemon serves that model's torque.

pub mod app;
pub mod atomic;
pub mod config;
pub mod dataset;
pub mod inclinometer;
pub mod machine;
pub mod postmortem;
pub mod recording;
pub mod report;
pub mod store;
