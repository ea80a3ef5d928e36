//! Waiting for a condition.

use std::time::{Duration, Instant};

/// Timeout, long enough for a loaded machine.
pub const TIMEOUT: Duration = Duration::from_secs(300);
/// Pause between two polls.
const POLL: Duration = Duration::from_millis(2);

/// Result of a poll: `true` and `Some` end a wait.
pub trait Condition {
    type Found;
    fn found(self) -> Option<Self::Found>;
}

impl Condition for bool {
    type Found = ();

    fn found(self) -> Option<()> {
        self.then_some(())
    }
}

impl<T> Condition for Option<T> {
    type Found = T;

    fn found(self) -> Option<T> {
        self
    }
}

/// Polls `condition` until it holds; what it found.
///
/// # Panics
/// After [`TIMEOUT`].
#[track_caller]
pub fn wait_for<C: Condition>(what: &str, mut condition: impl FnMut() -> C) -> C::Found {
    let start = Instant::now();
    loop {
        if let Some(found) = condition().found() {
            return found;
        }
        assert!(start.elapsed() < TIMEOUT, "{what} did not happen");
        std::thread::sleep(POLL);
    }
}

/// Polls `condition` for at most `limit`; the time until it held.
pub fn within(limit: Duration, mut condition: impl FnMut() -> bool) -> Option<Duration> {
    let start = Instant::now();
    loop {
        if condition() {
            return Some(start.elapsed());
        }
        if start.elapsed() > limit {
            return None;
        }
        std::thread::sleep(POLL);
    }
}
