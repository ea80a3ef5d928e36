//! Notifications to systemd, when a process runs as a service: ready, status, watchdog.
//!
//! Only progress triggers the watchdog. A bridge thread that still runs while the real-time loop hangs does not, and systemd
//! ends the process; the arm then stops by its own means.

use crate::process::outbox::Outbox;
use sd_notify::NotifyState;
use std::time::{Duration, Instant};

/// Notifications queued at a time; more are dropped.
const MAX_MESSAGES: usize = 64;
const FAREWELL: Duration = Duration::from_secs(1);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Progress {
    /// None required: there is no connection to an arm, or simulated time is paused.
    Waiting,
    /// Cycles of the loop, which must increase.
    Count(u64),
}

/// Decides when the watchdog is triggered. Time is an argument; the caller sends.
#[derive(Clone, Copy, Debug)]
struct Pulse {
    /// At most this often; `None` where no watchdog runs.
    every: Option<Duration>,
    fed: Option<Instant>,
    seen: Option<Progress>,
}

impl Pulse {
    /// A quarter of the time after which systemd would act.
    fn new(watchdog: Option<Duration>) -> Pulse {
        Pulse { every: watchdog.map(|limit| limit / 4), fed: None, seen: None }
    }

    fn beats(&mut self, progress: Progress, now: Instant) -> bool {
        let Some(every) = self.every else { return false };
        if self.fed.is_some_and(|fed| now.saturating_duration_since(fed) < every) {
            return false;
        }
        let stuck = matches!(progress, Progress::Count(_)) && self.seen == Some(progress);
        if !stuck {
            (self.fed, self.seen) = (Some(now), Some(progress));
        }
        !stuck
    }
}

/// This process as a service of systemd; does nothing outside systemd.
pub struct Service {
    watchdog: Option<Duration>,
    pulse: Pulse,
    /// Turns of a loop that counts nothing else.
    turns: u64,
    /// The watchdog waits longer for now.
    extended: bool,
    messenger: Option<Messenger>,
}

impl Service {
    /// Reads systemd's environment. Starts a thread under systemd: call it before the priority of this thread goes up.
    pub fn of_environment() -> Service {
        let watchdog = sd_notify::watchdog_enabled();
        let messenger = std::env::var_os("NOTIFY_SOCKET").and_then(|_| Messenger::start());
        Service { watchdog, pulse: Pulse::new(watchdog), turns: 0, extended: false, messenger }
    }

    /// The process is up; units that wait for it may start.
    pub fn ready(&self, status: &str) {
        self.notify(&[NotifyState::Ready, NotifyState::Status(status)]);
    }

    /// What `systemctl status` shows.
    pub fn status(&self, status: &str) {
        self.notify(&[NotifyState::Status(status)]);
    }

    pub fn stopping(&self) {
        self.notify(&[NotifyState::Stopping]);
    }

    /// Feeds the watchdog where something has got on since it was fed last.
    pub fn beat(&mut self, progress: Progress) {
        if !self.pulse.beats(progress, Instant::now()) {
            return;
        }
        if std::mem::take(&mut self.extended) {
            self.limit(self.watchdog);
        }
        self.notify(&[NotifyState::Watchdog]);
    }

    /// The process's own loop has come round once more.
    pub fn turned(&mut self) {
        self.turns += 1;
        self.beat(Progress::Count(self.turns));
    }

    /// One step that may take `longest` begins, such as a connection over a network; the next beat brings the usual limit back.
    pub fn long_step(&mut self, longest: Duration) {
        if let Some(watchdog) = self.watchdog {
            self.extended = true;
            self.pulse = Pulse::new(self.watchdog);
            self.limit(Some(watchdog.max(longest)));
            self.notify(&[NotifyState::Watchdog]);
        }
    }

    fn limit(&self, limit: Option<Duration>) {
        let micros = limit.and_then(|limit| u32::try_from(limit.as_micros()).ok());
        self.notify(&micros.map(NotifyState::WatchdogUsec).into_iter().collect::<Vec<_>>());
    }

    /// systemd is not needed for anything: what it does not take is not an error of the job.
    fn notify(&self, state: &[NotifyState]) {
        if let Some(messenger) = self.messenger.as_ref().filter(|_| !state.is_empty()) {
            messenger.send(state.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"));
        }
    }
}

/// Sends notifications to systemd. A socket that is not read blocks its sender, which must be a thread of its own: an arm does not stop turning
/// because the first process of its machine has died.
struct Messenger(Outbox<String>);

impl Messenger {
    fn start() -> Option<Messenger> {
        let started = Outbox::start("plumbline-notify", MAX_MESSAGES, |_dropped, message: String| {
            if let Err(error) = sd_notify::notify(&[NotifyState::Custom(&message)]) {
                tracing::debug!("systemd was not notified: {error}");
            }
        });
        started
            .map(Messenger)
            .inspect_err(|error| tracing::warn!("systemd can't be notified of this process: {error}"))
            .ok()
    }

    fn send(&self, message: String) {
        if !self.0.offer(message) {
            tracing::debug!("systemd does not read its notifications");
        }
    }
}

impl Drop for Messenger {
    /// The last notification gets some time to arrive.
    fn drop(&mut self) {
        self.0.flush(FAREWELL);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: Duration = Duration::from_secs(8);

    #[test]
    fn progress_alone_feeds_the_watchdog() {
        let start = Instant::now();
        let at = |seconds| start + Duration::from_secs(seconds);
        let mut pulse = Pulse::new(Some(LIMIT));
        assert!(pulse.beats(Progress::Count(1), at(0)));
        // Not more often than needed.
        assert!(!pulse.beats(Progress::Count(900), at(1)));
        assert!(pulse.beats(Progress::Count(2000), at(2)));
        // The loop hangs: no further trigger, however often this is called.
        assert!((3..40).all(|second| !pulse.beats(Progress::Count(2000), at(second))));
        assert!(pulse.beats(Progress::Count(2001), at(40)));
    }

    #[test]
    fn waiting_on_purpose_feeds_it_too() {
        let start = Instant::now();
        let mut pulse = Pulse::new(Some(LIMIT));
        assert!((0..10).all(|n| pulse.beats(Progress::Waiting, start + n * LIMIT / 4)));
        // The first count after it is progress, the same one again is not.
        assert!(pulse.beats(Progress::Count(0), start + 10 * LIMIT));
        assert!(!pulse.beats(Progress::Count(0), start + 11 * LIMIT));
    }

    #[test]
    fn without_a_watchdog_there_is_nothing_to_feed() {
        assert!(!Pulse::new(None).beats(Progress::Count(1), Instant::now()));
    }
}
