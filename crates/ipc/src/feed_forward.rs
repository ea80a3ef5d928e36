//! Client of the feed-forward torque: latest value, age and validity.

use std::thread;
use std::time::{Duration, Instant};

use iceoryx2::port::subscriber::Subscriber;
use iceoryx2::prelude::*;

use super::clock::{self, StampClock};
use super::error::IpcError;
use super::messages::FeedForwardMessage;
use super::robot::RobotId;
use super::services::{self, boot_ns};
use plumbline_core::Validity;

/// Maximum time stamp in the future \[ns\]; a later one is not of the clock that its value names.
const CLOCK_SLACK_NS: u64 = 1_000_000;
/// Maximum values read in one call; the buffer holds one per daemon, running or ended.
const VALUES_PER_CALL: usize = 4;

/// Settings of a feed-forward client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FeedForwardSettings {
    /// Age above which a value is stale \[ms\].
    pub stale_after_ms: u64,
}

impl Default for FeedForwardSettings {
    fn default() -> Self {
        FeedForwardSettings { stale_after_ms: 5 }
    }
}

/// Latest value with its age.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Latest {
    /// The value.
    pub message: FeedForwardMessage,
    /// Age: time since the state of this value was read \[ns\]. Of a daemon with another clock ([`FeedForwardMessage::clock`]: another machine) it
    /// is the age beyond that of the fastest transit of the last 5 to 10 s of values.
    pub age_ns: u64,
    /// Whether it is older than [`FeedForwardSettings::stale_after_ms`].
    pub stale: bool,
    /// Whether its torque may be used: not stale, and a model is served ([`FeedForwardMessage::validity`]).
    pub usable: bool,
}

impl Latest {
    fn at(message: FeedForwardMessage, age_ns: u64, settings: FeedForwardSettings) -> Latest {
        let stale = age_ns > settings.stale_after_ms.saturating_mul(1_000_000);
        let served = message.validity().is_ok_and(Validity::is_served);
        Latest { message, age_ns, stale, usable: served && !stale }
    }
}

/// Whether a daemon serves the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Presence {
    /// A daemon's process runs.
    Running,
    /// No daemon runs. The client stays connected and receives the values of the next daemon.
    Gone,
}

/// Client of the feed-forward torque of one robot.
pub struct FeedForwardClient {
    settings: FeedForwardSettings,
    newest: Option<FeedForwardMessage>,
    clock: StampClock,
    rejected: u64,
    subscriber: Subscriber<ipc_threadsafe::Service, FeedForwardMessage, ()>,
    service: services::FeedForwardForThreads,
    node: Node<ipc_threadsafe::Service>,
}

impl FeedForwardClient {
    /// Connects to the daemon of `robot`, waiting up to `timeout` for it to appear.
    ///
    /// # Errors
    /// [`IpcError::NoDaemon`], [`IpcError::Full`], [`IpcError::Incompatible`], [`IpcError::Transport`].
    pub fn connect(
        robot: &RobotId,
        settings: FeedForwardSettings,
        timeout: Duration,
    ) -> Result<FeedForwardClient, IpcError> {
        let start = Instant::now();
        let node = services::joining_node()?;
        let service = services::join_feed_forward(&node, robot, timeout)?;
        while service.dynamic_config().number_of_publishers() == 0 {
            if start.elapsed() >= timeout {
                return Err(services::no_daemon(robot, timeout));
            }
            thread::sleep(Duration::from_millis(1));
        }
        let name = services::feed_forward_name(robot);
        let subscriber = services::retry_until(&name, timeout.saturating_sub(start.elapsed()), || {
            Ok(service.subscriber_builder().buffer_size(1).create())
        })?;
        let clock = StampClock::new(clock::identity());
        Ok(FeedForwardClient { settings, newest: None, clock, rejected: 0, subscriber, service, node })
    }

    /// The latest value with its current age; `None` before the first, and before the second of a daemon with another clock. The same value
    /// is returned until a newer one arrives, and becomes stale.
    ///
    /// # Errors
    /// [`IpcError::Transport`] when shared memory failed.
    pub fn latest(&mut self) -> Result<Option<Latest>, IpcError> {
        for _ in 0..VALUES_PER_CALL {
            let received = self.subscriber.receive();
            let received = received.map_err(|error| services::transport("reading", "feed-forward", error))?;
            let Some(sample) = received else { break };
            let (message, now) = (*sample.payload(), boot_ns());
            let is_future =
                !self.clock.is_foreign(message.clock) && message.stamp_ns > now.saturating_add(CLOCK_SLACK_NS);
            if !is_future && supersedes(&message, self.newest.as_ref()) {
                self.clock.take(message.clock, message.stamp_ns, now);
                self.newest = Some(message);
            } else {
                self.rejected += 1;
            }
        }
        let now = boot_ns();
        Ok(self.newest.and_then(|message| {
            let age_ns = self.clock.age_ns(message.stamp_ns, now)?;
            Some(Latest::at(message, age_ns, self.settings))
        }))
    }

    /// Number of rejected values: invalid, older than the one before, or with a stamp in the future.
    pub fn rejected(&self) -> u64 {
        self.rejected
    }

    /// Whether the daemon's process runs; on another machine, whether that of the tunnel does. Reads files: call it when a value is stale, not in
    /// a control loop.
    pub fn daemon(&self) -> Presence {
        let mut state = Presence::Gone;
        self.service.dynamic_config().list_publishers(|details| {
            if services::runs(&self.node, details.node_id) {
                state = Presence::Running;
            }
            CallbackProgression::Continue
        });
        state
    }
}

/// Whether `message` is valid and newer than `newest`. Time stamps of one clock increase across restarts of the daemon, sequence numbers
/// within one epoch.
fn supersedes(message: &FeedForwardMessage, newest: Option<&FeedForwardMessage>) -> bool {
    let is_newer = |old: &FeedForwardMessage| {
        message.clock != old.clock
            || message.stamp_ns >= old.stamp_ns && (message.epoch != old.epoch || message.sequence > old.sequence)
    };
    message.check().is_ok() && newest.is_none_or(is_newer)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_torque_is_usable_while_not_stale_and_a_model_is_served() {
        let settings = FeedForwardSettings { stale_after_ms: 5 };
        let usable = |validity: Validity, age_ns| {
            let message = FeedForwardMessage { validity: validity as u32, ..FeedForwardMessage::default() };
            Latest::at(message, age_ns, settings).usable
        };
        assert!(usable(Validity::Valid, 5_000_000) && usable(Validity::HandOver, 0));
        assert!(!usable(Validity::Valid, 5_000_001) && !usable(Validity::None, 0) && !usable(Validity::Withdrawn, 0));
    }

    #[test]
    fn only_valid_and_newer_values_are_accepted() {
        let now = 1_000_000_000;
        let old =
            FeedForwardMessage { sequence: 5, stamp_ns: now - 10, epoch: 1, n: 7, ..FeedForwardMessage::default() };
        let newer = FeedForwardMessage { sequence: 6, stamp_ns: now - 5, ..old };
        assert!(supersedes(&old, None));
        assert!(supersedes(&newer, Some(&old)));
        assert!(!supersedes(&old, Some(&newer)));
        assert!(!supersedes(&newer, Some(&newer)));

        let restarted = FeedForwardMessage { sequence: 1, epoch: 2, stamp_ns: now, ..old };
        assert!(supersedes(&restarted, Some(&newer)));
        let left_over = FeedForwardMessage { sequence: 1, epoch: 2, stamp_ns: now - 20, ..old };
        assert!(!supersedes(&left_over, Some(&newer)));

        // The daemon's machine was started again: its clock begins anew.
        let rebooted = FeedForwardMessage { clock: 3, ..left_over };
        assert!(supersedes(&rebooted, Some(&newer)));
        assert!(!supersedes(&FeedForwardMessage { phase: 99, ..newer }, Some(&old)));
        assert!(!supersedes(&FeedForwardMessage { n: 9, ..newer }, Some(&old)));
    }
}
