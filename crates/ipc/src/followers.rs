//! Who follows the samples, as the daemon sees it. Pure bookkeeping: times come in as arguments.

use std::collections::VecDeque;

use super::command::Follower;

/// Something that the daemon should say about a follower.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FollowerEvent {
    /// A follower was heard of for the first time.
    #[error("{name} (process {pid}) follows the samples from {from} on")]
    Joined {
        /// What it calls itself.
        name: String,
        /// Its process.
        pid: u32,
        /// Its first record.
        from: u64,
    },
    /// A follower is alive but has said nothing for a while.
    #[error("{name} (process {pid}) has been silent for {silent_ms} ms; it had acknowledged {acknowledged} records")]
    Silent {
        /// What it calls itself.
        name: String,
        /// Its process.
        pid: u32,
        /// How far it was.
        acknowledged: u64,
        /// Time since it was last heard of \[ms\].
        silent_ms: u64,
    },
    /// A silent follower was heard of again.
    #[error("{name} (process {pid}) is back and has acknowledged {acknowledged} records")]
    Back {
        /// What it calls itself.
        name: String,
        /// Its process.
        pid: u32,
        /// How far it is.
        acknowledged: u64,
    },
    /// A follower left of its own will.
    #[error("{name} (process {pid}) left after {acknowledged} records")]
    Left {
        /// What it calls itself.
        name: String,
        /// Its process.
        pid: u32,
        /// How far it was.
        acknowledged: u64,
    },
    /// A follower's process ended without a word.
    #[error("{name} (process {pid}) died after {acknowledged} records; they are kept for its successor")]
    Died {
        /// What it calls itself.
        name: String,
        /// Its process.
        pid: u32,
        /// How far it was.
        acknowledged: u64,
    },
}

/// What one request said, with the identity of the port that it came from.
#[derive(Clone, Debug)]
pub(super) struct Word {
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
    heard_ns: u64,
    silent: bool,
}

/// The followers of one daemon.
#[derive(Debug, Default)]
pub(super) struct Followers {
    entries: Vec<Entry>,
    furthest: u64,
    news: VecDeque<FollowerEvent>,
}

/// More followers than can be connected at once are not remembered; the oldest is forgotten.
const MAX_ENTRIES: usize = 16;
/// FollowerEvent that nobody takes are bounded, too.
const MAX_NEWS: usize = 64;

impl Followers {
    /// Takes note of one request at `now_ns`. `end` bounds what can have been acknowledged.
    pub(super) fn heard(&mut self, word: Word, end: u64, now_ns: u64) {
        let acknowledged = word.acknowledged.min(end);
        self.furthest = self.furthest.max(acknowledged);
        let known = self.entries.iter().position(|entry| entry.port == word.port);
        if word.leaving {
            if let Some(index) = known {
                self.entries.remove(index);
                self.tell(FollowerEvent::Left { name: word.name, pid: word.pid, acknowledged });
            }
            return;
        }
        let Some(entry) = known.and_then(|index| self.entries.get_mut(index)) else {
            if self.entries.len() == MAX_ENTRIES {
                self.entries.remove(0);
            }
            self.tell(FollowerEvent::Joined { name: word.name.clone(), pid: word.pid, from: word.from });
            let Word { port, pid, name, .. } = word;
            self.entries.push(Entry { port, pid, name, acknowledged, heard_ns: now_ns, silent: false });
            return;
        };
        entry.acknowledged = acknowledged;
        entry.heard_ns = now_ns;
        if entry.silent {
            entry.silent = false;
            self.tell(FollowerEvent::Back { name: word.name, pid: word.pid, acknowledged });
        }
    }

    /// Looks for followers that have been silent for `limit_ns`; `alive` tells whether a port's process still runs.
    pub(super) fn check(&mut self, now_ns: u64, limit_ns: u64, mut alive: impl FnMut(u128) -> bool) {
        let mut dead = Vec::new();
        let mut told = Vec::new();
        for entry in &mut self.entries {
            let silent_ns = now_ns.saturating_sub(entry.heard_ns);
            if silent_ns < limit_ns {
                continue;
            }
            let (name, pid, acknowledged) = (entry.name.clone(), entry.pid, entry.acknowledged);
            if !alive(entry.port) {
                dead.push(entry.port);
                told.push(FollowerEvent::Died { name, pid, acknowledged });
            } else if !entry.silent {
                entry.silent = true;
                told.push(FollowerEvent::Silent { name, pid, acknowledged, silent_ms: silent_ns / 1_000_000 });
            }
        }
        self.entries.retain(|entry| !dead.contains(&entry.port));
        told.into_iter().for_each(|news| self.tell(news));
    }

    /// Whether anyone has been silent for `limit_ns`.
    pub(super) fn any_silent(&self, now_ns: u64, limit_ns: u64) -> bool {
        self.entries.iter().any(|entry| now_ns.saturating_sub(entry.heard_ns) >= limit_ns)
    }

    /// The furthest acknowledgement ever.
    pub(super) fn furthest(&self) -> u64 {
        self.furthest
    }

    /// The present followers.
    pub(super) fn list(&self, now_ns: u64) -> Vec<Follower> {
        let follower = |entry: &Entry| Follower {
            name: entry.name.clone(),
            pid: entry.pid,
            acknowledged: entry.acknowledged,
            silent_ms: now_ns.saturating_sub(entry.heard_ns) / 1_000_000,
        };
        self.entries.iter().map(follower).collect()
    }

    /// The oldest piece of news that has not been taken yet.
    pub(super) fn take_follower_event(&mut self) -> Option<FollowerEvent> {
        self.news.pop_front()
    }

    fn tell(&mut self, news: FollowerEvent) {
        if self.news.len() == MAX_NEWS {
            self.news.pop_front();
        }
        self.news.push_back(news);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u64 = 1_000_000;

    fn word(port: u128, acknowledged: u64) -> Word {
        Word { port, pid: 42, name: "estimator".into(), acknowledged, from: 0, leaving: false }
    }

    fn news(followers: &mut Followers) -> Vec<String> {
        std::iter::from_fn(|| followers.take_follower_event()).map(|news| news.to_string()).collect()
    }

    #[test]
    fn a_follower_joins_falls_silent_comes_back_and_leaves() {
        let mut followers = Followers::default();
        followers.heard(word(1, 0), 100, 0);
        followers.heard(word(1, 50), 100, 10 * MS);
        assert_eq!(news(&mut followers), ["estimator (process 42) follows the samples from 0 on"]);
        assert_eq!(followers.list(15 * MS)[0].silent_ms, 5);

        for now in [20 * MS, 600 * MS, 700 * MS] {
            followers.check(now, 500 * MS, |_| true);
        }
        let silent = "estimator (process 42) has been silent for 590 ms; it had acknowledged 50 records";
        assert_eq!(news(&mut followers), [silent]);
        followers.heard(word(1, 60), 100, 800 * MS);
        assert_eq!(news(&mut followers), ["estimator (process 42) is back and has acknowledged 60 records"]);
        followers.heard(Word { leaving: true, ..word(1, 61) }, 100, 801 * MS);
        assert_eq!(news(&mut followers), ["estimator (process 42) left after 61 records"]);
        assert!(followers.list(0).is_empty());
        assert_eq!(followers.furthest(), 61);
    }

    #[test]
    fn a_dead_one_is_named_and_its_successor_starts_over() {
        let mut followers = Followers::default();
        followers.heard(word(1, 70), 100, 0);
        followers.check(MS, 500 * MS, |_| false);
        followers.check(600 * MS, 500 * MS, |_| false);
        followers.heard(word(2, 0), 100, 700 * MS);
        let told = news(&mut followers);
        assert_eq!(told[1], "estimator (process 42) died after 70 records; they are kept for its successor");
        assert_eq!(told.len(), 3);
        assert_eq!(followers.list(700 * MS)[0].acknowledged, 0);
        assert_eq!(followers.furthest(), 70);
    }

    #[test]
    fn a_liar_acknowledges_no_more_than_there_is() {
        let mut followers = Followers::default();
        for port in 0..1000 {
            followers.heard(word(port, u64::MAX), 100, 0);
        }
        assert_eq!(followers.furthest(), 100);
        assert_eq!(followers.list(0).len(), MAX_ENTRIES);
        assert_eq!(news(&mut followers).len(), MAX_NEWS);
    }
}
