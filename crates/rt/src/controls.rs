//! Requests to the loop, and its state: atomics only, so that neither side waits for the other.
//!
//! `hil/loom/run.sh` runs it under every order in which two processors may see it.

use super::sync::{AtomicBool, AtomicU32, AtomicU64, Ordering};
use plumbline_core::Phase;

/// Requests to the loop and its state at a glance; shared with the supervisor.
#[derive(Debug, Default)]
pub struct Controls {
    stop: AtomicBool,
    quit: AtomicBool,
    /// The loop rests after a stop and waits for permission.
    waiting: AtomicBool,
    /// Counts the permissions given; an order runs only under the permission it was given in.
    permission: AtomicU32,
    phase: AtomicU32,
    cycles: AtomicU64,
    lost: AtomicU64,
    late: AtomicU64,
    dropped_records: AtomicU64,
    /// Heartbeats of the supervisor: it takes the loop's events and can stop it.
    heartbeats: AtomicU64,
    /// Identity of the model that the measured torques contradict, 0 for none.
    doubted: AtomicU64,
}

impl Controls {
    /// Brakes the arm and waits for [`resume`](Controls::resume). Orders given so far are discarded.
    pub fn stop(&self) {
        // A swap, as on the loop's side: read-modify-writes have one order, in which a stop can't be lost between a read and its reset.
        self.stop.swap(true, Ordering::AcqRel);
    }

    /// One heartbeat of the supervisor; see [`CycleSettings::heartbeat_timeout`](super::settings::CycleSettings::heartbeat_timeout).
    pub fn heartbeat(&self) {
        self.heartbeats.fetch_add(1, Ordering::Relaxed);
    }

    /// Marks the torque of the model with this identity as [`Validity::Doubtful`](plumbline_core::Validity::Doubtful); 0 for no model.
    pub fn doubt(&self, model: u64) {
        self.doubted.store(model, Ordering::Relaxed);
    }

    /// Ends the loop: at once when the arm rests, after a controlled stop when it moves.
    pub fn quit(&self) {
        self.quit.store(true, Ordering::Release);
    }

    /// An operator's permission to move again after a stop; `false` when the loop is not waiting for one.
    pub fn resume(&self) -> bool {
        let granted = self.waiting.compare_exchange(true, false, Ordering::AcqRel, Ordering::Acquire).is_ok();
        if granted {
            self.permission.fetch_add(1, Ordering::AcqRel);
        }
        granted
    }

    /// What the loop was doing in the last cycle.
    pub fn phase(&self) -> Phase {
        Phase::from_u32(self.phase.load(Ordering::Relaxed)).unwrap_or_default()
    }

    /// Whether the arm rests after a stop and waits for [`resume`](Controls::resume).
    pub fn is_waiting(&self) -> bool {
        self.waiting.load(Ordering::Acquire)
    }

    /// Whether a stop was requested that the loop has not taken up yet.
    pub fn stop_requested(&self) -> bool {
        self.stop.load(Ordering::Acquire)
    }

    /// Cycles run so far.
    pub fn cycles(&self) -> u64 {
        self.cycles.load(Ordering::Relaxed)
    }

    /// States lost so far.
    pub fn lost(&self) -> u64 {
        self.lost.load(Ordering::Relaxed)
    }

    /// Late cycles so far.
    pub fn late(&self) -> u64 {
        self.late.load(Ordering::Relaxed)
    }

    /// Records that found no room so far.
    pub fn dropped_records(&self) -> u64 {
        self.dropped_records.load(Ordering::Relaxed)
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(crate) fn take_stop(&self) -> bool {
        self.stop.swap(false, Ordering::AcqRel)
    }

    /// Heartbeats so far.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn heartbeats(&self) -> u64 {
        self.heartbeats.load(Ordering::Relaxed)
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(crate) fn doubts(&self, model: u64) -> bool {
        self.doubted.load(Ordering::Relaxed) == model
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(crate) fn wants_quit(&self) -> bool {
        self.quit.load(Ordering::Acquire)
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(crate) fn wait_for_permission(&self) {
        self.waiting.store(true, Ordering::Release);
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(crate) fn permission(&self) -> u32 {
        self.permission.load(Ordering::Acquire)
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub(crate) fn show(&self, phase: Phase, cycles: u64, lost: u64, late: u64, dropped_records: u64) {
        self.phase.store(phase as u32, Ordering::Relaxed);
        self.cycles.store(cycles, Ordering::Relaxed);
        self.lost.store(lost, Ordering::Relaxed);
        self.late.store(late, Ordering::Relaxed);
        self.dropped_records.store(dropped_records, Ordering::Relaxed);
    }
}

#[cfg(all(loom, test))]
mod loom_tests;
