//! State of a loop between two cycles, from which another loop continues: the start of a replay.
//!
//! The next command depends on the motion under way and the last three commands: the planner's motions are planned again
//! from the setpoint that they began at, and the guard differences three positions. So a checkpoint can be had from any four cycles in a row.

use super::torque::Succession;
use plumbline_core::{FeedForward, JointVec, Phase, Record, Reference, Setpoint};

/// What a loop is in the middle of.
pub enum Doing {
    /// Holding, ready for an order.
    Hold,
    /// A point-to-point motion.
    Move {
        /// How its records are marked.
        phase: Phase,
        /// The setpoint that it began at, at rest.
        from: Setpoint,
        /// Where to \[rad\].
        target: JointVec,
    },
    /// A reference.
    Follow(Box<dyn Reference>),
    /// A rest of some length.
    Dwell {
        /// Length \[ms\].
        ticks: u64,
    },
    /// A controlled stop.
    Brake {
        /// The setpoint that it began at.
        from: Setpoint,
    },
    /// At rest after a stop.
    Stopped,
}

/// A loop between two of its cycles.
pub struct Checkpoint {
    /// What it is in the middle of.
    pub doing: Doing,
    /// Its last three cycles, oldest first, consecutive.
    pub last: [Record; 3],
    /// The serving model, and its fallback.
    pub models: Succession<Box<dyn FeedForward>>,
}
