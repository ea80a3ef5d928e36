//! The atomics of the hand-overs, by one name, so that a model checker can put its own in their place (`hil/loom/`).

pub(super) use std::sync::atomic::{AtomicBool, AtomicU32, AtomicU64, Ordering};
