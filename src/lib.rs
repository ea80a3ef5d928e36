//! plumbline identifies the dynamics of a serial robot arm for any mounting and serves the torques it needs at 1 kHz.
//!
//! The map, floor by floor; imports point to lower floors only (`tests/floors.rs` holds that wall):
//!
//! | floor | modules | what |
//! |---|---|---|
//! | 0 | [`joint`], [`input`], [`atomic`] | fixed-size values with units; how bad input is reported; how files are written |
//! | 1 | [`model`], [`rt`] | the arm's dynamics, pure; the real-time loop and its traits |
//! | 2 | [`excite`], [`estimate`] | excitation motions and their limits; signals, least squares, uncertainty |
//! | 3 | [`config`], [`dataset`], [`store`], [`report`] | typed configuration; recorded motions as folders of CSV files; model files; report |

pub mod atomic;
pub mod config;
pub mod dataset;
pub mod estimate;
pub mod excite;
pub mod input;
pub mod joint;
pub mod model;
pub mod report;
pub mod rt;
pub mod store;
