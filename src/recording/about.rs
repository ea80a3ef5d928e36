//! What a recording says beside its cycles: where it comes from, and everything that the loop was given, so that it can be run again.

use plumbline_core::{JointVec, Limits, Phase, Setpoint, SpeedEnvelope, Workspace};
use plumbline_rt::Rights;
use plumbline_rt::{CycleSettings, GuardSettings, MoveFactors};
use serde::{Deserialize, Serialize};
use std::any::Any;

/// The format that this program writes and reads.
pub const FORMAT: u32 = 1;

/// Where a recording comes from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct About {
    /// [`FORMAT`].
    pub format: u32,
    /// Version of the program.
    pub plumbline: String,
    /// Name of the robot's description.
    pub robot: String,
    /// Name under which the robot is served.
    pub id: String,
    /// Number of joints.
    pub joints: usize,
    /// How the arm was mounted, for people.
    pub mounting: String,
    /// Polar angle of gravity \[rad\].
    pub rho: f64,
    /// Azimuth of gravity \[rad\].
    pub phi: f64,
    /// Name of the connection to the arm.
    pub session: String,
    /// The job's file, as it was named.
    pub job: String,
    /// SHA-256 of that file's text.
    pub job_sha256: String,
    /// When the recording was written, UTC.
    pub recorded: String,
    /// Why it was written.
    pub reason: Reason,
    /// How the loop ended, where it has.
    pub end: Option<String>,
    /// What the operator does next, in the backend's own words.
    #[serde(default)]
    pub next: Vec<String>,
    /// Whether the daemon was about to go on by itself: to recover the arm, and to drive what was interrupted.
    #[serde(default)]
    pub goes_on: bool,
    /// How the time stamps of the file's messages follow from the loop's.
    pub clock: LogClock,
    /// Cycles that the arm has lost since the loop started, as far as known.
    pub lost: u64,
    /// Late cycles since the loop started.
    pub late: u64,
    /// Events that found no room in the ring since the loop started; with any of them a replay is impossible.
    #[serde(alias = "untold")]
    pub dropped_events: u64,
    /// Names of the motions.
    #[serde(default)]
    pub motions: Vec<(u32, String)>,
    /// Remarks of the daemon.
    #[serde(default)]
    pub notes: Vec<Note>,
    /// What the loop was built from.
    pub settings: Settings,
    /// What the loop was in the middle of after the first cycle of the recording.
    pub under_way: UnderWay,
    /// Orders taken out of the queue by then.
    pub orders_before: u32,
    /// Models taken over by then.
    pub models_before: u32,
    /// Every order that the loop was given since it started, in order.
    #[serde(default)]
    pub orders: Vec<Given>,
    /// Every model that the loop was given since it started, in order, but for those long before the recording; `models_before` counts these alone.
    #[serde(default)]
    pub models: Vec<Handed>,
}

/// Kind of a reason.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum ReasonKind {
    /// A recording was requested.
    OnDemand,
    /// The guard stopped the arm.
    Guard,
    /// A stop was requested.
    Requested,
    /// States were lost.
    LostStates,
    /// The supervisor's heartbeat timed out.
    #[serde(alias = "unattended")]
    HeartbeatLost,
    /// A motion did not start where the arm rested.
    NotAtStart,
    /// No point-to-point motion was found.
    NoPath,
    /// No state came in time.
    Silent,
    /// The arm stopped by itself.
    Reflex,
    /// The arm refused a command.
    Refused,
    /// The connection was lost.
    Disconnected,
    /// The first command was unsafe.
    Unsafe,
    /// No controlled stop was possible.
    NoBrake,
    /// The machine did not grant real-time rights.
    NotRealTime,
    /// The arm's counter did not go forward.
    Clock,
    /// A thread panicked.
    Panic,
    /// The mounting was in doubt.
    Mounting,
    /// No model came in time.
    ModelTimeout,
    /// The estimator was lost.
    EstimatorLost,
    /// A signal ended the program.
    Signal,
    /// The program that started the daemon ended.
    ParentEnded,
    /// Of another version of the program.
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

/// Why a recording was written.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Reason {
    /// Kind, for advice and file names.
    pub kind: ReasonKind,
    /// One sentence.
    pub text: String,
}

impl Reason {
    /// Both parts.
    pub fn new(kind: ReasonKind, text: impl Into<String>) -> Reason {
        Reason { kind, text: text.into() }
    }
}

/// How a loop ended that a panic ended.
pub fn panicked(message: &str) -> String {
    format!("the loop's thread panicked: {message}")
}

/// What a panic said.
pub fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| text.to_string());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_default()
}

/// A remark of the daemon: something that did not happen in the loop.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Note {
    /// `CLOCK_MONOTONIC` \[ns\].
    pub stamp_ns: u64,
    /// The arm's counter then.
    pub seq: u64,
    /// One sentence.
    pub text: String,
}

/// How the time stamps of the file's messages follow from the loop's.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum LogClock {
    /// `CLOCK_MONOTONIC` plus this.
    Wall {
        /// What has to be added \[ns\].
        epoch_ns: u64,
    },
    /// One millisecond per cycle of an arm in simulated time.
    Arm {
        /// The arm's counter of one cycle.
        seq: u64,
        /// Its time \[ns since 1970\].
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

/// What the loop was in the middle of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum UnderWay {
    /// Holding.
    #[default]
    Hold,
    /// An order.
    Order {
        /// Its place in [`About::orders`].
        index: u32,
        /// The setpoint that it began at, where that is known.
        from: Option<Point>,
    },
    /// A controlled stop.
    Brake {
        /// The setpoint that it began at, where that is known.
        from: Option<Point>,
    },
    /// At rest after a stop.
    Stopped,
}

/// A setpoint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Point {
    /// Position \[rad\].
    pub q: JointVec,
    /// Velocity \[rad/s\].
    pub dq: JointVec,
    /// Acceleration \[rad/s2\].
    pub ddq: JointVec,
}

impl From<Setpoint> for Point {
    fn from(Setpoint { q, dq, ddq }: Setpoint) -> Point {
        Point { q, dq, ddq }
    }
}

impl From<Point> for Setpoint {
    fn from(Point { q, dq, ddq }: Point) -> Setpoint {
        Setpoint { q, dq, ddq }
    }
}

/// An order, as data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum Given {
    /// Point to point.
    Move {
        /// Number of the motion.
        motion: u32,
        /// Where to \[rad\].
        target: JointVec,
        /// How its records are marked: a number as in records.
        phase: u32,
    },
    /// A periodic motion.
    Follow {
        /// Number of the motion.
        motion: u32,
        /// The motion.
        series: Series,
    },
    /// A rest.
    Dwell {
        /// Number of the motion.
        motion: u32,
        /// Length \[ms\].
        ticks: u64,
    },
    /// A reference that can't be written down.
    Opaque {
        /// Number of the motion.
        motion: u32,
    },
}

impl Given {
    /// The phase of a point-to-point motion.
    pub fn phase(&self) -> Phase {
        match self {
            Given::Move { phase, .. } => Phase::from_u32(*phase).unwrap_or_default(),
            _ => Phase::Hold,
        }
    }
}

/// A Fourier series per joint, paper eq. 12, for a number of periods.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Period \[s\].
    pub period: f64,
    /// Number of periods.
    pub periods: u32,
    /// Offsets \[rad\].
    pub q0: Vec<f64>,
    /// Sine amplitudes, one row per joint \[rad\].
    pub a: Vec<Vec<f64>>,
    /// Cosine amplitudes, one row per joint \[rad\].
    pub b: Vec<Vec<f64>>,
}

/// A model that the loop was given.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Handed {
    /// Its identity; its text is the attachment `model-<identity>.toml`.
    pub id: u64,
    /// Gravity that it was evaluated for, in the base frame \[m/s2\].
    pub gravity: [f64; 3],
    /// Gravity that the arm's own controller compensates, in the base frame; that of the model where a recording names none \[m/s2\].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub vendor: Option<[f64; 3]>,
}

/// [`CycleSettings`], as data.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    q_min: JointVec,
    q_max: JointVec,
    dq: JointVec,
    ddq: JointVec,
    jerk: JointVec,
    tau: JointVec,
    dtau: JointVec,
    tracking: JointVec,
    /// Offset and deceleration.
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
        let Limits { q_min, q_max, dq, ddq, jerk, tau, dtau } = limits;
        let MoveFactors { velocity, acceleration, jerk: jerk_share, brake } = settings.moves;
        Settings {
            q_min,
            q_max,
            dq,
            ddq,
            jerk,
            tau,
            dtau,
            tracking,
            envelope: envelope.map(|envelope| [envelope.offset, envelope.deceleration]),
            workspace: workspace.map(|space| (space.box_min, space.box_max, space.base_radius)),
            moves: [velocity, acceleration, jerk_share, brake],
            max_lost: settings.max_consecutive_lost,
        }
    }
}

impl Settings {
    /// The limits that the guard held commands against.
    pub fn limits(&self) -> Limits {
        let Settings { q_min, q_max, dq, ddq, jerk, tau, dtau, .. } = *self;
        Limits { q_min, q_max, dq, ddq, jerk, tau, dtau }
    }

    /// Largest distance of the measured position from the position sent last \[rad\].
    pub fn tracking(&self) -> JointVec {
        self.tracking
    }

    /// Settings of a loop that asks nothing of the operating system, with room for so many orders.
    pub fn for_replay(&self, queue: usize) -> CycleSettings {
        let [velocity, acceleration, jerk, brake] = self.moves;
        let space = |(box_min, box_max, base_radius)| Workspace { box_min, box_max, base_radius };
        let guard = GuardSettings {
            limits: self.limits(),
            envelope: self.envelope.map(|[offset, deceleration]| SpeedEnvelope { offset, deceleration }),
            workspace: self.workspace.map(space),
            tracking: self.tracking,
        };
        // Nobody is silent in a replay: what came of silence is handed over as the stop that it was.
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
