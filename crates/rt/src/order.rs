//! Orders, models and events between the loop and its supervisor, over lock-free rings and atomics.
//!
//! [`Handles`] is the outside end. Nothing here ever blocks the loop; every box that the loop no longer uses travels back over the
//! `retired` ring, so that it is freed on the outside.

pub use super::controls::Controls;

use super::guard::Violation;
use super::retired::Retired;
use super::rights::Granted;
use plumbline_core::{FeedForward, JointVec, Phase, Reference};
use rtrb::{Consumer, Producer, PushError};
use std::sync::{Arc, OnceLock};

/// One motion for the queue. Motions run in sequence, each from the rest that the one before it ended in.
pub struct Order {
    /// The caller's number for the motion; records and events carry it. Not 0.
    pub motion: u32,
    /// Kind of motion.
    pub kind: OrderKind,
}

/// Kind of motion.
pub enum OrderKind {
    /// Point to point with the ruckig limits of the settings.
    MoveTo {
        /// Where to \[rad\].
        target: JointVec,
        /// `Approach` or `Return`: how the records are marked.
        phase: Phase,
    },
    /// Samples of a reference, one per cycle of the arm. The arm must already rest at its first sample.
    Follow(Box<dyn Reference>),
    /// Hold for a number of cycles.
    Dwell {
        /// Length \[ms\].
        ticks: u64,
    },
}

/// An order with the permission under which it was given.
pub(super) struct Permitted {
    pub order: Order,
    pub permission: u32,
}

/// Why the arm was braked.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum StopReason {
    /// A command or a measured state broke a limit of the guard.
    #[error("guard: {0}")]
    Guard(Violation),
    /// [`Controls::stop`] was called.
    #[error("a stop was requested")]
    Requested,
    /// [`Controls::quit`] was called in mid-motion.
    #[error("the program is ending")]
    Quit,
    /// Too many states in a row never arrived.
    #[error("{lost} states of the arm in a row were lost")]
    LostStates {
        /// Length of the run of lost states.
        lost: u64,
    },
    /// The supervisor's heartbeat timed out: it may be unable to stop the arm.
    #[error("the supervisor's heartbeat timed out: none for {cycles} cycles")]
    HeartbeatLost {
        /// Cycles of the arm since the last heartbeat.
        cycles: u64,
    },
    /// A reference does not start where the arm rests.
    #[error("motion {motion} starts {distance:.6} rad away from where joint {} rests", .joint + 1)]
    NotAtStart {
        /// Number of the motion.
        motion: u32,
        /// Joint, counted from 0.
        joint: usize,
        /// Signed distance \[rad\].
        distance: f64,
    },
    /// Ruckig found no motion from here to the target.
    #[error("no point-to-point motion was found for motion {motion}")]
    NoPath {
        /// Number of the motion.
        motion: u32,
    },
}

/// What happened in the loop, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Event {
    /// A motion took its first sample.
    Started {
        /// Its number.
        motion: u32,
    },
    /// A motion has sent its last sample and the arm holds.
    Ended {
        /// Its number.
        motion: u32,
    },
    /// The arm is braking; a motion under way is aborted.
    Stopping {
        /// Number of the motion, 0 before the first.
        motion: u32,
        /// Why.
        reason: StopReason,
    },
    /// The arm rests after a stop; nothing moves before [`Controls::resume`].
    Stopped,
    /// An operator has allowed motion again.
    Resumed,
    /// An order was given before a stop, or during it, and will not run.
    Discarded {
        /// Its number.
        motion: u32,
    },
    /// A model serves from this cycle on.
    Serving {
        /// Its identity.
        model: u64,
    },
    /// The model's torque broke a limit: the one before it serves.
    Distrusted {
        /// Its identity.
        model: u64,
        /// Identity of the model that serves instead, 0 for none until the next is handed over.
        instead: u64,
    },
}

/// An event and the cycle that it belongs to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TimedEvent {
    /// Number of the cycle, as in [`Record::cycle`](plumbline_core::Record::cycle).
    pub cycle: u64,
    /// The arm's counter in that cycle.
    pub seq: u64,
    /// `CLOCK_MONOTONIC` when that cycle's state had been read \[ns\].
    pub stamp_ns: u64,
    /// Orders taken out of the queue so far, that of this event included. It identifies the order of the event, also where several have
    /// one number.
    pub orders: u32,
    /// What happened.
    pub event: Event,
}

/// The queue of motions, outside end.
pub struct Orders {
    ring: Producer<Permitted>,
    controls: Arc<Controls>,
}

impl Orders {
    /// Adds a motion to the end of the queue; gives it back when the queue is full.
    pub fn give(&mut self, order: Order) -> Result<(), Order> {
        let permission = self.controls.permission();
        self.ring.push(Permitted { order, permission }).map_err(|PushError::Full(permitted)| permitted.order)
    }

    /// How many orders still fit.
    pub fn room(&self) -> usize {
        self.ring.slots()
    }
}

/// The queue of models, outside end.
pub struct Models {
    ring: Producer<Box<dyn FeedForward>>,
}

impl Models {
    /// Hands a model over; it serves from one of the next cycles on. Gives it back when the ring is full.
    pub fn serve(&mut self, model: Box<dyn FeedForward>) -> Result<(), Box<dyn FeedForward>> {
        self.ring.push(model).map_err(|PushError::Full(model)| model)
    }
}

/// The outside end of the loop. The fields are apart, because different threads may own them.
pub struct Handles {
    /// Motions into the loop.
    pub orders: Orders,
    /// Models into the loop.
    pub models: Models,
    /// Boxes that the loop no longer uses. Drain it: with a full ring new orders and models wait.
    pub retired: Consumer<Retired>,
    /// What happened, and when.
    pub events: Consumer<TimedEvent>,
    /// Stop, resume, quit, and the loop's state.
    pub controls: Arc<Controls>,
    /// Rights that the operating system granted; empty until the loop's thread has requested them, before its first cycle.
    pub granted: Arc<OnceLock<Granted>>,
}

impl Handles {
    /// Frees every box that the loop no longer uses; their number.
    pub fn free_retired(&mut self) -> usize {
        let mut freed = 0;
        while self.retired.pop().is_ok() {
            freed += 1;
        }
        freed
    }
}

/// The loop's end of the rings.
pub(super) struct Inlets {
    pub orders: Consumer<Permitted>,
    pub models: Consumer<Box<dyn FeedForward>>,
    pub retired: Producer<Retired>,
    pub events: Producer<TimedEvent>,
    pub controls: Arc<Controls>,
    pub granted: Arc<OnceLock<Granted>>,
}

/// Rings with room for `orders` queued motions, and what goes with them.
pub(super) fn rings(orders: usize) -> (Inlets, Handles) {
    let controls = Arc::new(Controls::default());
    let (give, given) = rtrb::RingBuffer::new(orders.max(1));
    let (serve, served) = rtrb::RingBuffer::new(4);
    let (retire, retired) = rtrb::RingBuffer::new(orders + 16);
    let (emit, emitted) = rtrb::RingBuffer::new(4 * orders + 256);
    let granted = Arc::new(OnceLock::new());
    let inlets = Inlets {
        orders: given,
        models: served,
        retired: retire,
        events: emit,
        controls: Arc::clone(&controls),
        granted: Arc::clone(&granted),
    };
    let handles = Handles {
        orders: Orders { ring: give, controls: Arc::clone(&controls) },
        models: Models { ring: serve },
        retired,
        events: emitted,
        controls,
        granted,
    };
    (inlets, handles)
}
