//! Followers of the samples: acknowledgements and heartbeats. No clock: times are arguments.

use std::collections::VecDeque;

use super::command::Follower;

/// Event of a follower, for the log.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum FollowerEvent {
    #[error("{name} (process {pid}) follows the samples from {from} on")]
    Joined { name: String, pid: u32, from: u64 },
    /// Heartbeat timeout of a follower whose process runs.
    #[error("{name} (process {pid}) has been silent for {silent_ms} ms; it had acknowledged {acknowledged} records")]
    Silent { name: String, pid: u32, acknowledged: u64, silent_ms: u64 },
    /// Heartbeat after a timeout.
    #[error("{name} (process {pid}) is back and has acknowledged {acknowledged} records")]
    Back { name: String, pid: u32, acknowledged: u64 },
    #[error("{name} (process {pid}) left after {acknowledged} records")]
    Left { name: String, pid: u32, acknowledged: u64 },
    /// A follower's process ended without disconnecting.
    #[error("{name} (process {pid}) died after {acknowledged} records; they are kept for its successor")]
    Died { name: String, pid: u32, acknowledged: u64 },
}

/// Content of one request, with the identity of its port.
#[derive(Clone, Debug)]
pub(super) struct Heartbeat {
    pub port: u128,
    pub pid: u32,
    pub name: String,
    pub acknowledged: u64,
    pub from: u64,
    pub leaving: bool,
}

#[derive(Debug)]
struct Entry {
    port: u128,
    pid: u32,
    name: String,
    acknowledged: u64,
    last_heartbeat_ns: u64,
    silent: bool,
}

#[derive(Debug, Default)]
pub(super) struct Followers {
    entries: Vec<Entry>,
    highest_acknowledged: u64,
    events: VecDeque<FollowerEvent>,
}

/// Maximum remembered followers, more than can be connected at once; the oldest is dropped.
const MAX_FOLLOWERS: usize = 16;
/// Maximum pending events; the oldest is dropped.
const MAX_PENDING_EVENTS: usize = 64;

impl Followers {
    /// Updates a follower by one request at `now_ns`. Acknowledgements are bounded by `end`.
    pub(super) fn update(&mut self, heartbeat: Heartbeat, end: u64, now_ns: u64) {
        let acknowledged = heartbeat.acknowledged.min(end);
        self.highest_acknowledged = self.highest_acknowledged.max(acknowledged);
        let known = self.entries.iter().position(|entry| entry.port == heartbeat.port);
        if heartbeat.leaving {
            if let Some(index) = known {
                self.entries.remove(index);
                self.emit(FollowerEvent::Left { name: heartbeat.name, pid: heartbeat.pid, acknowledged });
            }
            return;
        }
        let Some(entry) = known.and_then(|index| self.entries.get_mut(index)) else {
            if self.entries.len() == MAX_FOLLOWERS {
                self.entries.remove(0);
            }
            self.emit(FollowerEvent::Joined { name: heartbeat.name.clone(), pid: heartbeat.pid, from: heartbeat.from });
            let Heartbeat { port, pid, name, .. } = heartbeat;
            self.entries.push(Entry { port, pid, name, acknowledged, last_heartbeat_ns: now_ns, silent: false });
            return;
        };
        entry.acknowledged = acknowledged;
        entry.last_heartbeat_ns = now_ns;
        if entry.silent {
            entry.silent = false;
            self.emit(FollowerEvent::Back { name: heartbeat.name, pid: heartbeat.pid, acknowledged });
        }
    }

    /// Checks heartbeats with timeout `limit_ns`; `alive` is whether a port's process still runs.
    pub(super) fn check(&mut self, now_ns: u64, limit_ns: u64, mut alive: impl FnMut(u128) -> bool) {
        let mut dead = Vec::new();
        let mut events = Vec::new();
        for entry in &mut self.entries {
            let silent_ns = now_ns.saturating_sub(entry.last_heartbeat_ns);
            if silent_ns < limit_ns {
                continue;
            }
            let (name, pid, acknowledged) = (entry.name.clone(), entry.pid, entry.acknowledged);
            if !alive(entry.port) {
                dead.push(entry.port);
                events.push(FollowerEvent::Died { name, pid, acknowledged });
            } else if !entry.silent {
                entry.silent = true;
                events.push(FollowerEvent::Silent { name, pid, acknowledged, silent_ms: silent_ns / 1_000_000 });
            }
        }
        self.entries.retain(|entry| !dead.contains(&entry.port));
        events.into_iter().for_each(|event| self.emit(event));
    }

    /// Whether any heartbeat is older than `limit_ns`.
    pub(super) fn any_silent(&self, now_ns: u64, limit_ns: u64) -> bool {
        self.entries.iter().any(|entry| now_ns.saturating_sub(entry.last_heartbeat_ns) >= limit_ns)
    }

    pub(super) fn highest_acknowledged(&self) -> u64 {
        self.highest_acknowledged
    }

    pub(super) fn list(&self, now_ns: u64) -> Vec<Follower> {
        let follower = |entry: &Entry| Follower {
            name: entry.name.clone(),
            pid: entry.pid,
            acknowledged: entry.acknowledged,
            silent_ms: now_ns.saturating_sub(entry.last_heartbeat_ns) / 1_000_000,
        };
        self.entries.iter().map(follower).collect()
    }

    /// Takes the oldest pending event.
    pub(super) fn take_follower_event(&mut self) -> Option<FollowerEvent> {
        self.events.pop_front()
    }

    fn emit(&mut self, event: FollowerEvent) {
        if self.events.len() == MAX_PENDING_EVENTS {
            self.events.pop_front();
        }
        self.events.push_back(event);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn heartbeat(port: u128, acknowledged: u64) -> Heartbeat {
        Heartbeat { port, pid: 42, name: "estimator".into(), acknowledged, from: 0, leaving: false }
    }

    fn events(followers: &mut Followers) -> Vec<String> {
        std::iter::from_fn(|| followers.take_follower_event()).map(|event| event.to_string()).collect()
    }

    #[test]
    fn join_timeout_return_and_disconnect_are_events() {
        let mut followers = Followers::default();
        followers.update(heartbeat(1, 0), 100, 0);
        followers.update(heartbeat(1, 50), 100, 10 * MS);
        assert_eq!(events(&mut followers), ["estimator (process 42) follows the samples from 0 on"]);
        assert_eq!(followers.list(15 * MS)[0].silent_ms, 5);

        for now in [20 * MS, 600 * MS, 700 * MS] {
            followers.check(now, 500 * MS, |_| true);
        }
        let silent = "estimator (process 42) has been silent for 590 ms; it had acknowledged 50 records";
        assert_eq!(events(&mut followers), [silent]);
        followers.update(heartbeat(1, 60), 100, 800 * MS);
        assert_eq!(events(&mut followers), ["estimator (process 42) is back and has acknowledged 60 records"]);
        followers.update(Heartbeat { leaving: true, ..heartbeat(1, 61) }, 100, 801 * MS);
        assert_eq!(events(&mut followers), ["estimator (process 42) left after 61 records"]);
        assert!(followers.list(0).is_empty());
        assert_eq!(followers.highest_acknowledged(), 61);
    }

    #[test]
    fn the_death_of_a_follower_is_an_event_and_its_successor_starts_over() {
        let mut followers = Followers::default();
        followers.update(heartbeat(1, 70), 100, 0);
        followers.check(MS, 500 * MS, |_| false);
        followers.check(600 * MS, 500 * MS, |_| false);
        followers.update(heartbeat(2, 0), 100, 700 * MS);
        let found = events(&mut followers);
        assert_eq!(found[1], "estimator (process 42) died after 70 records; they are kept for its successor");
        assert_eq!(found.len(), 3);
        assert_eq!(followers.list(700 * MS)[0].acknowledged, 0);
        assert_eq!(followers.highest_acknowledged(), 70);
    }

    #[test]
    fn acknowledgements_are_bounded_by_the_published_records() {
        let mut followers = Followers::default();
        for port in 0..1000 {
            followers.update(heartbeat(port, u64::MAX), 100, 0);
        }
        assert_eq!(followers.highest_acknowledged(), 100);
        assert_eq!(followers.list(0).len(), MAX_FOLLOWERS);
        assert_eq!(events(&mut followers).len(), MAX_PENDING_EVENTS);
    }
}
