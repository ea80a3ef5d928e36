//! Requests and responses on the command service: JSON in a byte slice of bounded length.
//!
//! JSON, because requests are rare, come from scripts in any language, and may come from another version. A request that
//! can't be parsed gets [`Response::Refused`] with a reason.

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::error::IpcError;
use super::guest::GuestCounts;
use plumbline_core::{Distribution, Link, LoopStatistics, Phase};

/// Maximum length of a request \[bytes\]: a model file of 1 MiB fits even when every second character needs an escape.
pub const MAX_REQUEST_BYTES: usize = 2 << 20;
/// Maximum length of a response \[bytes\].
pub(super) const MAX_RESPONSE_BYTES: usize = 64 << 10;

/// Request of a client.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "request", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Request {
    /// Status of the daemon; response [`Response::Status`].
    Status {},
    /// Drive the motions of the job, once.
    Start {},
    /// Controlled stop; the arm stays at rest.
    Stop {},
    /// Controlled stop; [`Request::Resume`] continues with the interrupted motion.
    Pause {},
    /// Allow motion again after a stop; continue the job after a pause.
    Resume {},
    /// Controlled stop, then the daemon ends.
    Quit {},
    /// Serve this model from the next cycle on.
    OfferModel {
        /// Text of a model file.
        toml: String,
    },
    /// Propose a model because the served one no longer explains the torques. The job decides whether it is served at once or held for a
    /// decision. It replaces a held model.
    ProposeModel {
        /// Text of a model file.
        toml: String,
        /// Reason of the proposal.
        proposal: Proposal,
    },
    /// Mark the torque of the served model as doubtful, because the measured torques contradict it, or trust it again.
    Doubt {
        /// Identity of the model.
        model: u64,
        /// How they contradict it; absent to trust it again.
        why: Option<String>,
    },
    /// Serve the held model.
    Adopt {},
    /// Discard the held model.
    Reject {},
    /// Write a recording of the last seconds.
    Record {},
}

impl Request {
    /// Whether the request contains a model, which takes long to parse and to check.
    pub(super) fn is_heavy(&self) -> bool {
        matches!(self, Request::OfferModel { .. } | Request::ProposeModel { .. })
    }

    /// Name of the order as in `plumbline command`; `None` for a status request.
    pub fn order(&self) -> Option<&'static str> {
        Some(match self {
            Request::Status {} => return None,
            Request::Start {} => "start",
            Request::Stop {} => "stop",
            Request::Pause {} => "pause",
            Request::Resume {} => "resume",
            Request::Quit {} => "quit",
            Request::OfferModel { .. } => "offer-model",
            Request::ProposeModel { .. } => "propose-model",
            Request::Doubt { .. } => "doubt",
            Request::Adopt {} => "adopt",
            Request::Reject {} => "reject",
            Request::Record {} => "record",
        })
    }
}

/// A request with the epoch that it is bound to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Envelope {
    /// [`Served::epoch`] of the daemon; `None` for any daemon.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub epoch: Option<u64>,
    /// The request.
    #[serde(flatten)]
    pub request: Request,
}

/// Reason of a proposed model.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Proposal {
    /// Detected change in words: `payload of 0.731 +- 0.004 kg`.
    pub what: String,
    /// Time of the change on the arm's clock \[s\].
    pub since: f64,
    /// Joint with the largest error, from 1.
    pub joint: usize,
    /// RMS error of that joint with the served model, after the estimator's low-pass \[Nm\].
    pub before: f64,
    /// RMS error of that joint with the proposed model \[Nm\].
    pub after: f64,
}

/// Proposed model that is held for a decision.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeldModel {
    /// Identity of the model.
    pub model: u64,
    /// Reason of the proposal.
    #[serde(flatten)]
    pub proposal: Proposal,
}

/// Response of the daemon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "response", rename_all = "kebab-case")]
pub enum Response {
    /// Response to [`Request::Status`].
    Status(Box<Status>),
    /// The request was accepted.
    Accepted {},
    /// The model is served under this identity.
    ModelAccepted {
        /// Identity of the model as it appears in records and feed-forward values.
        model: u64,
    },
    /// The proposed model is held under this identity until it is adopted or rejected.
    ModelHeld {
        /// Identity of the held model.
        model: u64,
    },
    /// The request was refused.
    Refused {
        /// Reason in one sentence.
        reason: String,
    },
}

/// Status of the daemon. Counters are since its start.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The robot served.
    pub robot: String,
    /// The daemon's process.
    #[serde(default)]
    pub process: u32,
    /// Number of joints.
    pub joints: usize,
    /// Motion phase of the loop.
    #[serde(with = "phase_name")]
    pub phase: Phase,
    /// Number of the current motion.
    pub motion: u32,
    /// Cycles run.
    pub cycles: u64,
    /// States of the arm that were not received.
    pub lost: u64,
    /// Cycles with a missed deadline.
    pub late: u64,
    /// Records dropped because the ring to the bridge thread was full.
    pub dropped_records: u64,
    /// Identity of the served model, 0 while there is none.
    pub model: u64,
    /// Why the served torque is doubtful; absent while it is trusted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub doubt: Option<String>,
    /// Why the identified model is not served, where the rest of the job is driven without it; absent otherwise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub without_model: Option<String>,
    /// Proposed model that is held for `adopt` or `reject`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offered: Option<HeldModel>,
    /// Direction of gravity, where known.
    pub mounting: Option<Mounting>,
    /// Sources, agreement and events of that direction.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gravity: Option<Gravity>,
    /// Progress of the job.
    pub progress: Progress,
    /// Samples published when all motions had been driven; absent before.
    #[serde(default)]
    pub driven: Option<u64>,
    /// Progress of the job in words.
    pub job: String,
    /// Time that the motions of the job still take, without the ways between them \[s\]; absent before the start and where nothing is planned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left: Option<f64>,
    /// Reason of the last stop.
    #[serde(default)]
    pub stopped: Option<String>,
    /// Real-time rights that the machine does not grant to the current or last loop, with remedies. While not empty, the timing of the torques
    /// is not guaranteed.
    #[serde(default)]
    pub degraded: Vec<String>,
    /// Statistics of each ended connection to the arm.
    pub sessions: Vec<Session>,
    /// States of an arm that another program controls; absent where the daemon drives the arm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub guest: Option<GuestStatus>,
    /// Statistics of shared memory, from [`Server::served`](super::Server::served).
    pub served: Served,
}

/// States of an arm that another program controls, as the daemon has received them.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct GuestStatus {
    /// Counters by name.
    #[serde(flatten)]
    pub counts: GuestCounts,
    /// Why no states are used now, with the operator's next step.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub problem: Option<String>,
}

/// Progress of the job.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Progress {
    /// Not started.
    #[default]
    Idle,
    /// Motions are being driven.
    Driving,
    /// The arm holds until the estimator sends the model.
    AwaitingModel,
    /// A pause interrupted the job; it continues after [`Request::Resume`].
    Paused,
    /// All motions were driven.
    Done,
    /// A stop ended the job.
    Stopped,
}

/// One connection to the arm, from its first state to its end.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Session {
    /// Purpose of the connection.
    pub name: String,
    /// Counters and timing of the loop.
    #[serde(flatten)]
    pub statistics: LoopStatistics,
    /// Allocations inside the loop; `None` when they were not counted.
    pub allocations: Option<u32>,
    /// Latency from state read to shared memory, on the bridge thread.
    pub bridge: Distribution,
    /// Real-time rights that the operating system did not grant, with remedies.
    pub refusals: Vec<String>,
    /// How the connection ended.
    pub end: String,
    /// Statistics of the network link; absent where there is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub link: Option<Link>,
}

/// Direction of the gravitational acceleration in the base frame, paper eq. 3.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Mounting {
    /// Angle from the base frame's z axis; pi is upright on a table \[rad\].
    pub rho: f64,
    /// Angle about the z axis \[rad\].
    pub phi: f64,
    /// The acceleration itself \[m/s2\].
    pub gravity: [f64; 3],
}

/// Status of the direction of gravity. Directions are `[rho, phi]` of paper eq. 3 \[rad\].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Gravity {
    /// Source of the model's gravity: `declared`, `measured`, or `held` since the sensor was lost.
    pub source: String,
    /// State of the inclinometer; absent where there is none.
    pub inclinometer: Option<String>,
    /// Last measured direction.
    pub measured: Option<[f64; 2]>,
    /// Standard deviations of its two angles \[rad\].
    pub std: Option<[f64; 2]>,
    /// Standard deviation of the measured direction \[rad\].
    #[serde(default)]
    pub uncertainty: Option<f64>,
    /// Direction by the robot's accelerometers.
    pub robot: Option<[f64; 2]>,
    /// Direction implied by the torques at rest and the model.
    pub torques: Option<[f64; 2]>,
    /// Gravity in the base frame that the arm's own controller compensates \[m/s2\].
    #[serde(default)]
    pub vendor: Option<[f64; 3]>,
    /// Reason why the model is not served, where it is not.
    pub refused: Option<String>,
    /// Events, the latest last.
    pub events: Vec<String>,
    /// Number of dropped events, the oldest ones.
    #[serde(default)]
    pub forgotten: u64,
    /// Measurement of the inclinometer at the start of each motion.
    pub motions: Vec<MotionGravity>,
    /// The bus is a simulated one.
    #[serde(default)]
    pub simulated: bool,
    /// Policy without a reading: `refuse`, `hold` or `declared`; absent without an inclinometer.
    #[serde(default)]
    pub on_loss: Option<String>,
    /// Number of losses of the inclinometer.
    #[serde(default)]
    pub losses: u64,
    /// Total time without the inclinometer \[s\].
    #[serde(default)]
    pub lost_s: f64,
    /// Number of changes of the model's gravity.
    #[serde(default)]
    pub hand_overs: u64,
    /// Largest angle between the model's gravity and the declared one \[rad\].
    #[serde(default)]
    pub furthest: f64,
}

/// Measured direction of gravity at the start of a motion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MotionGravity {
    /// Number of the motion.
    pub motion: u32,
    /// See [`Mounting::rho`] \[rad\].
    pub rho: f64,
    /// See [`Mounting::phi`] \[rad\].
    pub phi: f64,
    /// Standard deviation of the direction \[rad\].
    pub std: f64,
}

/// Statistics of shared memory since the daemon's start.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Served {
    /// Epoch: identity of the daemon's start.
    pub epoch: u64,
    /// Records published.
    pub published: u64,
    /// Sequence number of the oldest retained record: the number of discarded records.
    pub first_retained: u64,
    /// Records discarded before any follower acknowledged them.
    pub given_up_unacknowledged: u64,
    /// Highest acknowledgement of any follower: all records before it were received.
    pub acknowledged: u64,
    /// Records replayed to followers.
    pub replayed: u64,
    /// Batches that could not be published; followers fetch their records by replay.
    pub unsent_batches: u64,
    /// Feed-forward values published.
    pub feed_forward: u64,
    /// Requests that could not be parsed.
    pub garbled_requests: u64,
    /// Time that the bridge thread has spent on requests, at most a fifth of all time \[ns\].
    #[serde(default)]
    pub answering_ns: u64,
    /// Last error of shared memory.
    pub trouble: Option<String>,
    /// Connected followers of the samples.
    pub followers: Vec<Follower>,
}

/// One follower of the samples.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Follower {
    /// Name that it gave.
    pub name: String,
    /// Process of the follower.
    pub pid: u32,
    /// All records before this number were received.
    pub acknowledged: u64,
    /// Time since its last heartbeat \[ms\].
    pub silent_ms: u64,
}

/// Encodes `value` as JSON of at most `limit` bytes.
pub(super) fn encode<T: Serialize>(what: &'static str, value: &T, limit: usize) -> Result<Vec<u8>, IpcError> {
    let bytes = serde_json::to_vec(value).map_err(|error| IpcError::Malformed { what, reason: error.to_string() })?;
    if bytes.len() > limit {
        return Err(IpcError::TooLong { what, bytes: bytes.len(), limit });
    }
    Ok(bytes)
}

/// Parses JSON of at most `limit` bytes.
pub(super) fn decode<T: DeserializeOwned>(what: &'static str, bytes: &[u8], limit: usize) -> Result<T, IpcError> {
    if bytes.len() > limit {
        return Err(IpcError::TooLong { what, bytes: bytes.len(), limit });
    }
    serde_json::from_slice(bytes).map_err(|error| IpcError::Malformed { what, reason: error.to_string() })
}

/// Serialises a phase by its name.
mod phase_name {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    use plumbline_core::Phase;

    const NAMES: [(Phase, &str); 6] = [
        (Phase::Hold, "hold"),
        (Phase::Approach, "approach"),
        (Phase::Excite, "excite"),
        (Phase::Return, "return"),
        (Phase::Stop, "stop"),
        (Phase::Stopped, "stopped"),
    ];

    pub fn serialize<S: Serializer>(phase: &Phase, serializer: S) -> Result<S::Ok, S::Error> {
        let name = NAMES.iter().find(|(known, _)| known == phase).map_or("unknown", |(_, name)| name);
        serializer.serialize_str(name)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Phase, D::Error> {
        let text = String::deserialize(deserializer)?;
        let known = NAMES.iter().find(|(_, name)| *name == text).map(|(phase, _)| *phase);
        known.ok_or_else(|| D::Error::custom(format!("phase `{text}` does not exist")))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_and_responses_are_restored_from_json() {
        let toml = "name = \"a\"\n# \u{3c1}\n".to_string();
        for request in [
            Request::Status {},
            Request::Start {},
            Request::Stop {},
            Request::Pause {},
            Request::Resume {},
            Request::Quit {},
            Request::OfferModel { toml: toml.clone() },
            Request::ProposeModel { toml, proposal: Proposal { what: "payload".into(), ..Proposal::default() } },
            Request::Doubt { model: 7, why: Some("joint 3".into()) },
            Request::Doubt { model: u64::MAX, why: None },
            Request::Adopt {},
            Request::Reject {},
        ] {
            let bytes = encode("request", &request, MAX_REQUEST_BYTES).unwrap();
            assert_eq!(decode::<Request>("request", &bytes, MAX_REQUEST_BYTES).unwrap(), request);
        }
        for code in 0..6 {
            let status = Status {
                phase: Phase::from_u32(code).unwrap(),
                offered: Some(HeldModel { model: 7, proposal: Proposal { since: 30.0, ..Proposal::default() } }),
                mounting: Some(Mounting { rho: 1.0, phi: 0.25, gravity: [0.0, 0.0, -9.81] }),
                served: Served { followers: vec![Follower::default()], ..Served::default() },
                ..Status::default()
            };
            let response = Response::Status(Box::new(status));
            let bytes = encode("answer", &response, MAX_RESPONSE_BYTES).unwrap();
            assert_eq!(decode::<Response>("answer", &bytes, MAX_RESPONSE_BYTES).unwrap(), response);
        }
    }

    #[test]
    fn requests_written_by_hand_are_parsed() {
        let read = |text: &str| decode::<Request>("request", text.as_bytes(), MAX_REQUEST_BYTES);
        assert_eq!(read(r#"{"request":"stop"}"#).unwrap(), Request::Stop {});
        assert_eq!(read(r#"{"request":"offer-model","toml":""}"#).unwrap(), Request::OfferModel { toml: "".into() });
    }
}
