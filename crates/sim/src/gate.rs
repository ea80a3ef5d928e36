//! Back-pressure for an arm at full speed: simulated time pauses, and no sample is lost.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;

/// Polls before the waiting thread yields, and before it sleeps.
const SPINS: u32 = 200;
const YIELDS: u32 = 400;
const POLL_INTERVAL: Duration = Duration::from_micros(50);

/// Counts states delivered against records consumed. The arm waits at it while it is shut, or while `capacity` records are under way.
///
/// Shared by an `Arc`: the arm passes through it, the consumer of the records reports to it. No lock, no allocation.
#[derive(Debug)]
pub struct Gate {
    capacity: u64,
    produced: AtomicU64,
    consumed: AtomicU64,
    shut: AtomicBool,
    ended: AtomicBool,
}

/// The program is shutting down; the gate is closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ended;

impl Gate {
    /// An open gate that lets at most `capacity` (at least 1) states through ahead of the consumer.
    pub fn new(capacity: u64) -> Gate {
        Gate {
            capacity: capacity.max(1),
            produced: AtomicU64::new(0),
            consumed: AtomicU64::new(0),
            shut: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        }
    }

    /// A gate that never waits for a consumer.
    pub fn unlimited() -> Gate {
        Gate::new(u64::MAX)
    }

    /// The consumer has taken `records` more records off the ring.
    pub fn consumed(&self, records: u64) {
        self.consumed.fetch_add(records, Ordering::Release);
    }

    /// Continues simulated time.
    pub fn open(&self) {
        self.shut.store(false, Ordering::Release);
    }

    /// Pauses simulated time before the next state.
    pub fn shut(&self) {
        self.shut.store(true, Ordering::SeqCst);
    }

    /// Ends all waiting: the arm returns `Fault::Disconnected` from now on.
    pub fn end(&self) {
        self.ended.store(true, Ordering::Release);
    }

    /// States delivered and not yet consumed as records.
    pub fn under_way(&self) -> u64 {
        // `consumed` first, so that it cannot exceed `produced`.
        let consumed = self.consumed.load(Ordering::Acquire);
        self.produced.load(Ordering::SeqCst).saturating_sub(consumed)
    }

    /// Waits until one more state may be delivered, and counts it.
    #[expect(clippy::disallowed_methods, reason = "simulated time pauses; no arm waits")]
    #[cfg_attr(feature = "rtsan", rtsan_standalone::no_sanitize_realtime)]
    pub(super) fn pass(&self) -> Result<(), Ended> {
        let mut tries = 0;
        loop {
            if self.ended.load(Ordering::Acquire) {
                return Err(Ended);
            }
            if !self.shut.load(Ordering::Acquire) && self.under_way() < self.capacity {
                self.produced.fetch_add(1, Ordering::SeqCst);
                // Shut in between: either this thread sees that here, or the one that has shut it sees the state under way.
                if !self.shut.load(Ordering::SeqCst) {
                    return Ok(());
                }
                self.produced.fetch_sub(1, Ordering::SeqCst);
            }
            match tries {
                0..SPINS => std::hint::spin_loop(),
                SPINS..YIELDS => std::thread::yield_now(),
                _ => std::thread::sleep(POLL_INTERVAL),
            }
            tries = (tries + 1).min(YIELDS);
        }
    }
}

#[cfg(test)]
mod tests {
    #![expect(clippy::disallowed_methods, reason = "threads of tests")]

    use super::*;
    use std::sync::Arc;

    #[test]
    fn never_lets_more_than_its_capacity_ahead() {
        let gate = Arc::new(Gate::new(3));
        let arm = std::thread::spawn({
            let gate = gate.clone();
            move || (0..1000).map(|_| gate.pass().map(|()| gate.under_way())).collect::<Result<Vec<_>, _>>()
        });
        let mut taken = 0;
        while taken < 1000 {
            let waiting = gate.under_way();
            assert!(waiting <= 3);
            gate.consumed(waiting.min(2));
            taken += waiting.min(2);
        }
        let seen = arm.join().unwrap().unwrap();
        assert_eq!(seen.len(), 1000);
        assert!(seen.iter().all(|&ahead| ahead <= 3));
        assert!(seen.iter().any(|&ahead| ahead > 0));
    }

    #[test]
    fn pauses_while_shut_and_ends_finally() {
        let gate = Arc::new(Gate::new(10));
        gate.shut();
        let arm = std::thread::spawn({
            let gate = gate.clone();
            move || (gate.pass(), gate.pass(), gate.pass())
        });
        std::thread::sleep(Duration::from_millis(5));
        assert_eq!(gate.under_way(), 0);
        gate.open();
        while gate.under_way() < 3 {
            std::thread::yield_now();
        }
        assert_eq!(arm.join().unwrap(), (Ok(()), Ok(()), Ok(())));
        gate.end();
        assert_eq!(gate.pass(), Err(Ended));
    }
}
