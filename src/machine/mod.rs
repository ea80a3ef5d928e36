//! Whether this computer is fit for a loop at 1 kHz, and what to change where it is not.
//!
//! | file | what |
//! |---|---|
//! | `tree` | reads `/proc` and `/sys`, or a copy of them |
//! | `look` | what is found there: kernel, processors, interrupts, memory, network |
//! | `wake` | a short measurement: how late a thread with the loop's rights wakes up |

mod look;
mod tree;
mod wake;

pub use look::inspect;
pub use tree::Tree;
pub use wake::{Class, wake_ups};

use plumbline_rt::{Grant, Granted, Rights, become_realtime};
use serde::Serialize;
use std::net::IpAddr;

/// What the machine is to be fit for.
#[derive(Clone, Debug, PartialEq)]
pub struct Requirements {
    /// What the loop's thread will ask for.
    pub rights: Rights,
    /// The robot at the other end of a network.
    pub robot: Option<IpAddr>,
}

/// What a finding means.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Verdict {
    /// As it should be.
    Fit,
    /// It could not be found out, or it does not apply.
    Unknown,
    /// It costs wake-ups now and then: worth changing, and no reason to refuse.
    Advice,
    /// A loop at 1 kHz can't be trusted here.
    Unfit,
}

/// One thing that was looked at.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Its name.
    pub name: &'static str,
    /// What it means.
    pub verdict: Verdict,
    /// What was found.
    pub found: String,
    /// What to change, where there is something to change.
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

/// Asks for the loop's rights on a thread of its own and says which are granted; empty when no thread could be started.
pub fn rights(requirements: &Requirements) -> Vec<Finding> {
    let rights = requirements.rights.clone();
    let asked = std::thread::Builder::new().spawn(move || become_realtime(&rights)).map(|thread| thread.join());
    let Ok(Ok(Granted { fifo, memory, cpu, kernel })) = asked else { return Vec::new() };
    let finding = |(name, grant): (&'static str, Grant)| match grant {
        Grant::Granted(found) => Finding::fit(name, found),
        Grant::NotAsked => Finding::unknown(name, "not asked for"),
        // The refusal says both, what is and what to change.
        Grant::Refused(text) => Finding { name, verdict: Verdict::Unfit, found: text, change: None },
    };
    [("priority", fifo), ("locked-memory", memory), ("pinning", cpu), ("kernel", kernel)].map(finding).into()
}
