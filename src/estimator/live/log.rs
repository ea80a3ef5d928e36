//! The log of the live watch, `live.json`.

use crate::report::diagnosis::Effect;
use serde::Serialize;
use std::collections::VecDeque;

/// Content of `live.json`.
#[derive(Default, Serialize)]
pub struct Log {
    /// Usual error at the identification, and alarm threshold, per joint \[Nm\].
    pub usual: Vec<f64>,
    pub limit: Vec<f64>,
    pub events: Vec<Event>,
    pub stretches: VecDeque<Stretch>,
}

/// An event, with the time of the arm \[s\].
#[derive(Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// The error exceeds the alarm threshold.
    Lost {
        t: f64,
        since: f64,
        joint: usize,
        rms: f64,
        usual: f64,
    },
    /// The error is below the threshold again.
    Holds {
        t: f64,
        since: f64,
    },
    /// A model for what changed, first or refined, or an earlier one that holds again.
    Proposed {
        t: f64,
        since: f64,
        model: String,
        what: String,
        effects: Vec<Effect>,
        before: Vec<f64>,
        after: Vec<f64>,
    },
    /// No change was found that lowers the error.
    Unexplained {
        t: f64,
        tried: usize,
        rms: Vec<f64>,
    },
    Served {
        t: f64,
        model: String,
    },
    Rejected {
        t: f64,
    },
}

/// Errors over a stretch, per joint \[Nm\]: of the model along the measured motion after the low-pass, and of the torque that was
/// served, raw.
#[derive(Serialize)]
pub struct Stretch {
    pub start: f64,
    pub end: f64,
    pub model: String,
    pub rms: Vec<f64>,
    pub served_rms: Vec<f64>,
}
