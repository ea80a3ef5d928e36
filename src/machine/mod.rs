//! Fitness of this computer for a 1 kHz loop, and changes that improve it.
//!
//! | file | what |
//! |---|---|
//! | `tree` | reads `/proc` and `/sys`, or a copy of them |
//! | `look` | findings: kernel, processors, interrupts, memory, network |
//! | `wake` | measurement of the wake-up latency with the loop's rights |

mod look;
mod tree;
mod wake;

pub use look::inspect;
pub use tree::Tree;
pub use wake::{Class, wake_ups};

use plumbline_rt::{Grant, Granted, Rights, become_realtime};
use serde::Serialize;
use std::net::IpAddr;

#[derive(Clone, Debug, PartialEq)]
pub struct Requirements {
    pub rights: Rights,
    pub robot: Option<IpAddr>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    Fit,
    Unknown,
    /// Occasionally causes late wake-ups: a change is recommended.
    Advice,
    /// Not suitable for a 1 kHz loop.
    Unfit,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    pub name: &'static str,
    pub verdict: Verdict,
    pub found: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub change: Option<String>,
}

impl Finding {
    fn fit(name: &'static str, found: impl Into<String>) -> Finding {
        Finding { name, verdict: Verdict::Fit, found: found.into(), change: None }
    }

    fn unknown(name: &'static str, found: impl Into<String>) -> Finding {
        Finding { name, verdict: Verdict::Unknown, found: found.into(), change: None }
    }

    fn advice(name: &'static str, found: impl Into<String>, change: impl Into<String>) -> Finding {
        Finding { name, verdict: Verdict::Advice, found: found.into(), change: Some(change.into()) }
    }

    fn unfit(name: &'static str, found: impl Into<String>, change: impl Into<String>) -> Finding {
        Finding { name, verdict: Verdict::Unfit, found: found.into(), change: Some(change.into()) }
    }
}

/// Requests the loop's rights on a separate thread and returns the result; empty if no thread could be started.
pub fn rights(requirements: &Requirements) -> Vec<Finding> {
    let rights = requirements.rights.clone();
    let asked = std::thread::Builder::new().spawn(move || become_realtime(&rights)).map(|thread| thread.join());
    let Ok(Ok(Granted { fifo, memory, cpu, kernel })) = asked else { return Vec::new() };
    let finding = |(name, grant): (&'static str, Grant)| match grant {
        Grant::Granted(found) => Finding::fit(name, found),
        Grant::NotAsked => Finding::unknown(name, "not asked for"),
        // The text of the refusal contains the change.
        Grant::Refused(text) => Finding { name, verdict: Verdict::Unfit, found: text, change: None },
    };
    [("priority", fifo), ("locked-memory", memory), ("pinning", cpu), ("kernel", kernel)].map(finding).into()
}
