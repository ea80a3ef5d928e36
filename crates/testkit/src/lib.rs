//! Fixtures shared by tests, benchmarks and campaigns. Each feature adds a part with the crates that it needs, so that the tests of
//! one crate build no more than that crate does.
//!
//! | feature | modules |
//! |---|---|
//! | none | `conformance`, `logs`, `page`, `peers`, `turns`, `wait` |
//! | `model` | `arms` |
//! | `loop` | `fake_arm` |
//! | `sim` | `sim` |
//! | `identify` | `scene`, `bodies`, `peers::nearest` |
//! | `diagnose` | `diagnosis` |
//! | `franka` | `emulator`, `franka_loop`, `fuzz` |
//! | `ipc` | `memory`, `other_layout` |
//! | `inclinometer` | `inclinometer` |
//! | `program` | `job`, `kill`, `paper`, `rig`, `fuzz::files`: they run the program or read its files |

#![allow(missing_docs)]

#[cfg(feature = "model")]
pub mod arms;
#[cfg(feature = "identify")]
pub mod bodies;
pub mod conformance;
#[cfg(feature = "diagnose")]
pub mod diagnosis;
#[cfg(feature = "franka")]
pub mod emulator;
#[cfg(feature = "loop")]
pub mod fake_arm;
#[cfg(feature = "franka")]
pub mod franka_loop;
#[cfg(feature = "franka")]
pub mod fuzz;
#[cfg(feature = "inclinometer")]
pub mod inclinometer;
#[cfg(feature = "program")]
pub mod job;
#[cfg(feature = "program")]
pub mod kill;
pub mod logs;
#[cfg(feature = "ipc")]
pub mod memory;
#[cfg(feature = "ipc")]
pub mod other_layout;
pub mod page;
#[cfg(feature = "program")]
pub mod paper;
pub mod peers;
#[cfg(feature = "program")]
pub mod rig;
#[cfg(feature = "identify")]
pub mod scene;
#[cfg(feature = "sim")]
pub mod sim;
pub mod turns;
pub mod wait;

use std::path::{Path, PathBuf};

pub const ROOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../..");

pub fn path(of: impl AsRef<Path>) -> PathBuf {
    Path::new(ROOT).join(of)
}
