//! Floor 2: the arms. Every one of them implements [`crate::rt::Backend`] and passes the same [`conformance`] suite.

pub mod conformance;
pub mod franka;
pub mod sim;

/// A clock that an arm without hardware is paced by; the program passes in the real-time one.
pub trait Clock: Send {
    /// Time now, `CLOCK_MONOTONIC` \[ns\].
    fn now_ns(&self) -> u64;

    /// Returns at `ns` on the same clock, at once when that is past. Allocates nothing.
    fn sleep_until(&self, ns: u64);
}
