//! plumbline identifies the dynamics of a serial robot arm for any mounting and serves the torques it needs at 1 kHz.
//!
//! The map, floor by floor; imports point to lower floors only (`tests/floors.rs` holds that wall):
//!
//! | floor | modules | what |
//! |---|---|---|
//! | 0 | [`joint`], [`input`] | fixed-size values with units; how bad input is reported |
//! | 1 | [`model`], [`rt`] | the arm's dynamics, pure; the real-time loop and its traits |
//! | 2 | [`ipc`] | shared memory between the daemon, the estimator and clients |

pub mod input;
pub mod ipc;
pub mod joint;
pub mod model;
pub mod rt;
