//! plumbline identifies the dynamics of a serial robot arm for any mounting and serves the torques it needs at 1 kHz.
//!
//! The libraries, each a crate of its own; a crate imports those above it in this table only:
//!
//! | crate | what |
//! |---|---|
//! | [`plumbline_core`] | per-joint values, interfaces of the loop (backend, reference, feed-forward, kinematics), bad input |
//! | [`plumbline_model`] | the arm's dynamics: kinematics, Newton-Euler, regressor, base parameters, effects |
//! | [`plumbline_rt`] | the 1 kHz loop: orders, guard, controlled stop, hand-over of models |
//! | [`plumbline_excite`] | optimal excitation trajectories within the limits of the arm |
//! | [`plumbline_identify`] | parameters with standard deviations from samples |
//! | [`plumbline_diagnose`] | detection of effects that a model lacks |
//! | [`plumbline_sim`], [`plumbline_franka`] | arms: simulated, and over the Franka Control Interface |
//! | [`plumbline_ipc`] | samples, torques, commands between processes |
//!
//! This package is the program:
//!
//! | module | what |
//! |---|---|
//! | [`cli`] | one file per subcommand |
//! | [`offline`] | identification, diagnosis, comparison, prediction, planning from files; called by `cli` and by `crates/python` |
//! | `daemon` | the process that drives the arm and serves the torque |
//! | `estimator` | the process that identifies models from samples |
//! | `setup` | preparation of a job: robot, locks, plans |
//! | `analysis` | from recorded runs to model, errors and diagnosis; shared by estimator and offline commands |
//! | `monitor` | a running daemon as its clients see it; shared by the live view and the metrics endpoint |
//! | `relay` | torque, model and states across users of one machine |
//! | [`config`], [`dataset`], [`store`], [`recording`] | files: jobs, recorded motions, models and plans, the last seconds before a fault |
//! | [`urdf`] | an arm from a URDF |
//! | [`report`], [`postmortem`] | report of a job; analysis of a recording |
//! | [`inclinometer`], [`machine`], `process` | the gravity sensor; real-time fitness of the computer; log, signals and systemd |
//!
//! Data flow: `excite` plans a motion, `rt` drives it through a backend and puts one record per cycle into a ring, the daemon's
//! bridge thread publishes the records through `ipc`, the estimator turns them into a model with `identify`, and the daemon serves that
//! model's torque.

#![forbid(unsafe_code)]
// The interface is the command line and the files; a doc comment stands where a name does not say everything.
#![allow(missing_docs)]

mod analysis;
pub use analysis::checks;
pub mod atomic;
pub mod cli;
pub mod config;
mod daemon;
pub mod dataset;
mod date;
mod estimator;
mod failure;
pub mod import;
pub mod inclinometer;
pub mod machine;
mod monitor;
pub mod offline;
pub mod postmortem;
mod process;
pub mod recording;
mod relay;
pub mod report;
mod setup;
pub mod store;
pub mod urdf;

pub use failure::Failure;
