//! The loop's thread: its rights, its end, and what is left of a panic.

use super::super::recorder::LoopEnd;
use super::{PAUSE, RING};
use crate::config::job;
use crate::recording::about::panic_message;
use plumbline_core::{Backend, Sink, TimeGate};
use plumbline_rt::Controls;
use plumbline_rt::Rights;
use plumbline_rt::cycle::Cycle;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The longest that the loop takes to end after a panic of the bridge thread: a stop, and the last state of the arm.
const PANIC_STOP_TIMEOUT: Duration = Duration::from_secs(5);
/// How many levels the bridge thread's priority lies below the loop's.
pub const BELOW_LOOP: u8 = 10;

/// Does the bridge thread's `work`.
/// Errors: the message of a panic in it; the loop's end has been requested then, which brakes an arm that moves.
pub fn catch_panic<T>(controls: &Controls, work: impl FnOnce() -> T) -> Result<T, String> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|panic| {
        controls.quit();
        panic_message(&*panic)
    })
}

/// Waits for the end of a loop after it was requested, up to [`PANIC_STOP_TIMEOUT`].
pub fn await_end<T>(thread: &JoinHandle<T>, gate: Option<&dyn TimeGate>) {
    let deadline = Instant::now() + PANIC_STOP_TIMEOUT;
    while !thread.is_finished() && Instant::now() < deadline {
        gate.into_iter().for_each(|gate| {
            gate.open();
            gate.consumed(RING as u64);
        });
        std::thread::sleep(PAUSE);
    }
}

/// Runs the loop to its end. After a panic the arm is stopped, and the last cycles come out.
pub fn run_to_end<B: Backend, S: Sink>(cycle: &mut Cycle<B, S>) -> LoopEnd {
    // What the loop leaves behind after a panic is only read.
    match catch_unwind(AssertUnwindSafe(|| cycle.run())) {
        Ok(outcome) => LoopEnd::Ended(Box::new(outcome)),
        Err(panic) => {
            let (flight, unanswered) = cycle.after_panic();
            LoopEnd::Panicked { message: panic_message(&*panic), flight, unanswered: unanswered.map(Box::new) }
        }
    }
}

/// Rights of the stop relay: before the bridge thread, after the loop.
pub fn stop_listener_rights(realtime: &job::Realtime) -> Rights {
    let Rights { priority, .. } = rights(realtime, BELOW_LOOP / 2);
    Rights { priority, ..Rights::NONE }
}

/// Rights that the job asks of the operating system, `below` levels lower.
pub fn rights(realtime: &job::Realtime, below: u8) -> Rights {
    Rights {
        priority: Some(realtime.priority.saturating_sub(below)).filter(|&priority| priority > 0),
        cpu: realtime.cpu.filter(|_| below == 0),
        lock_memory: realtime.lock_memory,
        preempt_rt: realtime.preempt_rt && below == 0,
    }
}

#[cfg(test)]
mod tests;
