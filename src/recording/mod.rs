//! Recordings of the last seconds before a fault, as MCAP files with ROS 2 messages.
//!
//! | file | what |
//! |---|---|
//! | `history` | the last seconds in memory |
//! | `about` | everything that the loop was given, as data |
//! | `messages`, `cdr` | the messages and their bytes |
//! | `write`, `read` | the file |
//!
//! Format: MCAP (<https://mcap.dev/spec>), profile `ros2`, messages in CDR with their definitions in the file, chunks of some tenths of
//! a second with checksums, so that a file that was cut short reads up to the cut. Every `f64` of the loop reads back bit by bit.

pub mod about;
pub mod cdr;
pub mod history;
pub mod messages;
mod read;
mod write;

use about::About;
use plumbline_core::Record;
use plumbline_rt::TimedEvent;

/// A recording in memory.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Where it comes from, and what the loop was given.
    pub about: About,
    /// The cycles, oldest first; numbers that are missing were never recorded.
    pub records: Vec<Record>,
    /// The cycle that was begun and not answered: only its state means anything.
    pub unanswered: Option<Record>,
    /// What happened, in order.
    pub events: Vec<TimedEvent>,
    /// Texts by name: `robot.toml`, `job.toml`, `model-<identity>.toml`.
    pub texts: Vec<(String, String)>,
    /// Where the file ends early, and why, for people; `None` for a whole file.
    pub cut: Option<String>,
}

impl Recording {
    /// The text of this name.
    pub fn text(&self, name: &str) -> Option<&str> {
        self.texts.iter().find(|(other, _)| other == name).map(|(_, text)| text.as_str())
    }
}

/// Name of the text of a model.
pub fn model_name(id: u64) -> String {
    format!("model-{id:016x}.toml")
}
