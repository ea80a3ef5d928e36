//! Metadata of a recording: its origin, and all inputs of the loop, from which a replay is possible.

use plumbline_core::{JointVec, Limits, Phase, Setpoint, SpeedEnvelope, Workspace};
use plumbline_rt::Rights;
use plumbline_rt::{CycleSettings, GuardSettings, MoveFactors};
use serde::{Deserialize, Serialize};
use std::any::Any;

/// Orders that bring the arm to a motion's start carry the motion's number plus this.
pub const APPROACH: u32 = 1 << 16;
/// Number of the order that brings the arm back.
pub const RETURN: u32 = 1 << 17;

pub const FORMAT: u32 = 1;

/// Metadata of a recording (`about.json`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct About {
    pub format: u32,
    pub plumbline: String,
    pub robot: String,
    pub id: String,
    pub joints: usize,
    pub mounting: String,
    /// Polar angle of gravity \[rad\].
    pub rho: f64,
    /// Azimuth of gravity \[rad\].
    pub phi: f64,
    pub session: String,
    pub job: String,
    /// SHA-256 of that file's text.
    pub job_sha256: String,
    /// Time of writing, UTC.
    pub recorded: String,
    pub reason: Reason,
    /// End of the loop; `None` while it runs.
    pub end: Option<String>,
    /// Next steps for the operator, from the backend.
    #[serde(default)]
    pub next: Vec<String>,
    /// Whether the daemon was about to recover the arm and repeat the interrupted motion without an operator.
    #[serde(default, rename = "goes_on")]
    pub automatic_recovery: bool,
    /// Conversion from the loop's time stamps to those of the file's messages.
    pub clock: LogClock,
    /// Lost states since the loop started.
    pub lost: u64,
    /// Late cycles since the loop started.
    pub late: u64,
    /// Events dropped since the loop started, because the ring was full; with any, there is no replay.
    #[serde(alias = "untold")]
    pub dropped_events: u64,
    #[serde(default)]
    pub motions: Vec<(u32, String)>,
    #[serde(default)]
    pub notes: Vec<Note>,
    pub settings: Settings,
    /// Activity of the loop after the first cycle of the recording.
    pub under_way: Activity,
    /// Orders taken from the queue up to the first cycle of the recording.
    pub orders_before: u32,
    /// Models of `models` taken over up to the first cycle of the recording.
    pub models_before: u32,
    #[serde(default)]
    pub orders: Vec<RecordedOrder>,
    /// Models handed over since the loop started, without old ones that no replay needs.
    #[serde(default)]
    pub models: Vec<RecordedModel>,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReasonKind {
    OnDemand,
    Guard,
    Requested,
    LostStates,
    /// The supervisor's heartbeat timed out.
    #[serde(alias = "unattended")]
    HeartbeatLost,
    /// A motion did not start where the arm rested.
    NotAtStart,
    /// No point-to-point motion was found.
    NoPath,
    Silent,
    Reflex,
    Refused,
    Disconnected,
    Unsafe,
    NoBrake,
    /// The machine did not grant real-time rights.
    NotRealTime,
    /// The arm's counter did not go forward.
    Clock,
    Panic,
    Mounting,
    ModelTimeout,
    EstimatorLost,
    Signal,
    ParentEnded,
    #[default]
    #[serde(other)]
    Unknown,
}

/// The name in a recording and in its file name: `lost-states`.
impl std::fmt::Display for ReasonKind {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        self.serialize(f)
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reason {
    /// Kind, for advice and file names.
    pub kind: ReasonKind,
    /// One sentence.
    pub text: String,
}

impl Reason {
    pub fn new(kind: ReasonKind, text: impl Into<String>) -> Reason {
        Reason { kind, text: text.into() }
    }
}

/// [`About::end`] of a loop that panicked.
pub fn panicked(message: &str) -> String {
    format!("the loop's thread panicked: {message}")
}

pub fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| text.to_string());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default()
}

/// A remark of the daemon about something outside the loop.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// `CLOCK_MONOTONIC` \[ns\].
    pub stamp_ns: u64,
    /// Sequence number of the arm at that time.
    pub seq: u64,
    /// One sentence.
    pub text: String,
}

/// Conversion from the loop's time stamps to those of the file's messages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum LogClock {
    /// `CLOCK_MONOTONIC` plus an offset.
    Wall {
        /// Offset \[ns\].
        epoch_ns: u64,
    },
    /// One millisecond per cycle of an arm in simulated time.
    Arm {
        /// Sequence number of a reference cycle.
        seq: u64,
        /// Time of that cycle \[ns since 1970\].
        epoch_ns: u64,
    },
}

impl LogClock {
    /// Time of a message \[ns since 1970\].
    pub fn at(&self, seq: u64, stamp_ns: u64) -> u64 {
        match *self {
            LogClock::Wall { epoch_ns } => epoch_ns.saturating_add(stamp_ns),
            LogClock::Arm { seq: reference, epoch_ns } => {
                let ms = |cycles: u64| cycles.saturating_mul(1_000_000);
                let later = epoch_ns.saturating_add(ms(seq.saturating_sub(reference)));
                later.saturating_sub(ms(reference.saturating_sub(seq)))
            }
        }
    }
}

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Activity {
    #[default]
    Hold,
    Order {
        /// Index in [`About::orders`].
        index: u32,
        /// Setpoint at its start, if known.
        from: Option<Setpoint>,
    },
    Brake {
        /// Setpoint at its start, if known.
        from: Option<Setpoint>,
    },
    Stopped,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum RecordedOrder {
    Move {
        motion: u32,
        /// Target position \[rad\].
        target: JointVec,
        phase: u32,
    },
    Follow {
        motion: u32,
        series: Series,
    },
    Dwell {
        motion: u32,
        /// Length \[ms\].
        ticks: u64,
    },
    /// A reference without a serialisable form.
    Opaque {
        motion: u32,
    },
}

impl About {
    /// What an order does, from the number that it carries: the name of a motion, the way to it (the rest before it where `resting`), or the
    /// way back.
    pub fn order_name(&self, number: u32, resting: bool) -> String {
        let named =
            |wanted: u32| self.motions.iter().find(|(motion, _)| *motion == wanted).map(|(_, name)| name.as_str());
        let to = number.checked_sub(APPROACH).and_then(named);
        match (named(number), to) {
            (Some(name), _) => name.to_string(),
            (None, Some(name)) if resting => format!("the rest before {name}"),
            (None, Some(name)) => format!("the way to {name}"),
            (None, None) if number == RETURN => "the way back".to_string(),
            (None, None) => format!("motion {number}"),
        }
    }
}

impl RecordedOrder {
    pub fn phase(&self) -> Phase {
        match self {
            RecordedOrder::Move { phase, .. } => Phase::from_u32(*phase).unwrap_or_default(),
            _ => Phase::Hold,
        }
    }
}

/// A Fourier series per joint, paper eq. 12, for a number of periods.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Period \[s\].
    pub period: f64,
    pub periods: u32,
    /// Offsets \[rad\].
    pub q0: Vec<f64>,
    /// Sine amplitudes, one row per joint \[rad\].
    pub a: Vec<Vec<f64>>,
    /// Cosine amplitudes, one row per joint \[rad\].
    pub b: Vec<Vec<f64>>,
}

/// A model that was handed over to the loop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordedModel {
    /// Identity; the model's text is the attachment `model-<identity>.toml`.
    pub id: u64,
    /// Gravity of the model, in the base frame \[m/s2\].
    pub gravity: [f64; 3],
    /// Gravity that the arm's controller compensates, in the base frame \[m/s2\]; `gravity` if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vendor: Option<[f64; 3]>,
}

/// [`CycleSettings`] in serialisable form.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    #[serde(flatten)]
    limits: Limits,
    tracking: JointVec,
    envelope: Option<[JointVec; 2]>,
    /// Lower and upper corner, radius of the base.
    workspace: Option<([f64; 3], [f64; 3], f64)>,
    /// Velocity, acceleration, jerk, brake.
    moves: [f64; 4],
    max_lost: u64,
}

impl From<&CycleSettings> for Settings {
    fn from(settings: &CycleSettings) -> Settings {
        let GuardSettings { limits, envelope, workspace, tracking } = settings.guard;
        let MoveFactors { velocity, acceleration, jerk, brake } = settings.moves;
        Settings {
            limits,
            tracking,
            envelope: envelope.map(|envelope| [envelope.offset, envelope.deceleration]),
            workspace: workspace.map(|space| (space.box_min, space.box_max, space.base_radius)),
            moves: [velocity, acceleration, jerk, brake],
            max_lost: settings.max_consecutive_lost,
        }
    }
}

impl Settings {
    pub fn limits(&self) -> Limits {
        self.limits
    }

    /// Tracking tolerance of the guard: distance of the measured position from the previous command \[rad\].
    pub fn tracking(&self) -> JointVec {
        self.tracking
    }

    /// Settings of a loop for a replay: without real-time rights, with a queue of `queue` orders.
    pub fn for_replay(&self, queue: usize) -> CycleSettings {
        let [velocity, acceleration, jerk, brake] = self.moves;
        let space = |(box_min, box_max, base_radius)| Workspace { box_min, box_max, base_radius };
        let guard = GuardSettings {
            limits: self.limits,
            envelope: self.envelope.map(|[offset, deceleration]| SpeedEnvelope { offset, deceleration }),
            workspace: self.workspace.map(space),
            tracking: self.tracking,
        };
        // No heartbeat is checked in a replay: a recorded heartbeat timeout is replayed as a stop.
        CycleSettings {
            moves: MoveFactors { velocity, acceleration, jerk, brake },
            max_consecutive_lost: self.max_lost,
            queue,
            flight: 1,
            rights: Rights::NONE,
            ..CycleSettings::new(guard)
        }
    }
}
