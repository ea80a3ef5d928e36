//! MCAP files with ROS 2 messages: recordings of the last seconds before a fault, and runs of a dataset.
//!
//! | file | what |
//! |---|---|
//! | `history` | the last seconds in memory |
//! | `about` | metadata and the loop's inputs |
//! | `messages`, `cdr` | messages and their encoding |
//! | `scene` | description and placements of the arm, for 3-D viewers |
//! | `write`, `read` | the recording's file |
//! | `records` | records of any file, checked |
//! | `run` | a run of a dataset |
//! | `foreign` | messages of files that other programs wrote |
//!
//! Format: MCAP (<https://mcap.dev/spec>), profile `ros2`, messages in CDR with their definitions in the file. A recording's chunks of about
//! 50 ms have checksums, so a truncated one is readable up to the cut. Every `f64` of the loop is stored bitwise.

pub mod about;
pub mod cdr;
pub mod foreign;
pub mod history;
pub mod messages;
mod read;
mod records;
pub mod run;
mod scene;
mod write;

pub(crate) use records::bytes_of;

use about::About;
use plumbline_core::Record;
use plumbline_rt::TimedEvent;

/// Profile of the files.
const PROFILE: &str = "ros2";

#[derive(Clone, Debug)]
pub struct Recording {
    pub about: About,
    /// Records, oldest first, possibly with gaps.
    pub records: Vec<Record>,
    /// The last cycle, if it ended without a command: only its state is valid.
    pub unanswered: Option<Record>,
    pub events: Vec<TimedEvent>,
    /// Texts by name: `robot.toml`, `job.toml`, `model-<identity>.toml`.
    pub texts: Vec<(String, String)>,
    /// Position and cause of a truncation or damage; `None` for a complete file.
    pub cut: Option<String>,
}

impl Recording {
    pub fn text(&self, name: &str) -> Option<&str> {
        self.texts.iter().find(|(other, _)| other == name).map(|(_, text)| text.as_str())
    }
}

pub fn model_name(id: u64) -> String {
    format!("model-{id:016x}.toml")
}
