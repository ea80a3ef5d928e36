//! Requests and responses on the command service: JSON in a byte slice of bounded length.
//!
//! JSON, because these are rare, made by people and scripts in any language, and must survive a newer or older peer: what
//! can't be read is answered with [`Response::Refused`] and a reason.

use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::error::IpcError;
use plumbline_core::{Distribution, Link, LoopStatistics, Phase};

/// Longest request. A model file of 1 MiB fits in even when every second character needs an escape.
pub const MAX_REQUEST_BYTES: usize = 2 << 20;
/// Longest answer.
pub(super) const MAX_RESPONSE_BYTES: usize = 64 << 10;

/// What a client may ask of the daemon.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "request", rename_all = "kebab-case", deny_unknown_fields)]
pub enum Request {
    /// How is the daemon? Answered with [`Response::Status`].
    Status {},
    /// Drive the programme of the job, once.
    Start {},
    /// Brake now and stay at rest.
    Stop {},
    /// Go on after a stop.
    Resume {},
    /// Stop, then end the daemon.
    Quit {},
    /// Serve the model that this text describes from the next cycle on.
    OfferModel {
        /// A model file's text.
        toml: String,
    },
    /// The served model does not hold any more; this one does. The job says whether it is served at once or held until somebody adopts
    /// it. It takes the place of one that is held.
    ProposeModel {
        /// A model file's text.
        toml: String,
        /// Why.
        proposal: Proposal,
    },
    /// Serve the model that is held.
    Adopt {},
    /// Drop the model that is held.
    Reject {},
    /// Write a recording of the last seconds.
    Record {},
}

impl Request {
    /// Whether it carries a model, which takes long to read and to check.
    pub(super) fn is_heavy(&self) -> bool {
        matches!(self, Request::OfferModel { .. } | Request::ProposeModel { .. })
    }

    /// What this tells the daemon to do, as `plumbline command` calls it; nothing for a question.
    pub fn order(&self) -> Option<&'static str> {
        Some(match self {
            Request::Status {} => return None,
            Request::Start {} => "start",
            Request::Stop {} => "stop",
            Request::Resume {} => "resume",
            Request::Quit {} => "quit",
            Request::OfferModel { .. } => "offer-model",
            Request::ProposeModel { .. } => "propose-model",
            Request::Adopt {} => "adopt",
            Request::Reject {} => "reject",
            Request::Record {} => "record",
        })
    }
}

/// A request, and the start of the daemon that it is meant for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Envelope {
    /// [`Served::epoch`] of that start; every daemon takes a request that names none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub epoch: Option<u64>,
    /// What is asked.
    #[serde(flatten)]
    pub request: Request,
}

/// Why a model is proposed while another is served.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Proposal {
    /// What has changed, for people to read: `payload of 0.731 +- 0.004 kg`.
    pub what: String,
    /// Since when the served model does not hold, on the arm's clock \[s\].
    pub since: f64,
    /// Joint with the largest error, from 1.
    pub joint: usize,
    /// Its RMS under the served model, after the estimator's low-pass \[Nm\].
    pub before: f64,
    /// The same under the proposed one \[Nm\].
    pub after: f64,
}

/// A proposed model that waits for a decision.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct HeldModel {
    /// Identity of the model.
    pub model: u64,
    /// Why it was proposed.
    #[serde(flatten)]
    pub proposal: Proposal,
}

/// What the daemon answers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "response", rename_all = "kebab-case")]
pub enum Response {
    /// To [`Request::Status`].
    Status(Box<Status>),
    /// The request will be carried out.
    Accepted {},
    /// The model is served under this identity.
    ModelAccepted {
        /// Identity of the model as it appears in records and feed-forward values.
        model: u64,
    },
    /// The proposed model is held under this identity until somebody adopts or rejects it.
    ModelHeld {
        /// Identity that it will have when it is served.
        model: u64,
    },
    /// The request won't be carried out.
    Refused {
        /// Why not, in one sentence.
        reason: String,
    },
}

/// How the daemon is. Numbers are since its start.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Status {
    /// The robot served.
    pub robot: String,
    /// The daemon's process.
    #[serde(default)]
    pub process: u32,
    /// Number of joints.
    pub joints: usize,
    /// What the loop is doing.
    #[serde(with = "phase_name")]
    pub phase: Phase,
    /// Number of the present motion.
    pub motion: u32,
    /// Cycles run.
    pub cycles: u64,
    /// States of the arm that were never seen.
    pub lost: u64,
    /// Cycles that started after their deadline.
    pub late: u64,
    /// Records that found no room between the loop and the bridge thread.
    pub dropped_records: u64,
    /// Identity of the served model, 0 while there is none.
    pub model: u64,
    /// A proposed model that waits for `adopt` or `reject`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offered: Option<HeldModel>,
    /// Direction of gravity, as far as it is known.
    pub mounting: Option<Mounting>,
    /// Where that direction comes from, who agrees with it, and what has happened to it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gravity: Option<Gravity>,
    /// Where the job stands.
    pub progress: Progress,
    /// Samples published when everything had been driven; absent before.
    #[serde(default)]
    pub driven: Option<u64>,
    /// What the job is at, for people to read.
    pub job: String,
    /// Why the arm was stopped last, if it was.
    #[serde(default)]
    pub stopped: Option<String>,
    /// What the machine does not grant the present loop, or the last one, with what to change: while there is anything here, its torques
    /// come without a promise of time.
    #[serde(default)]
    pub degraded: Vec<String>,
    /// How the loop kept its time, one entry per connection to the arm that has ended.
    pub sessions: Vec<Session>,
    /// Counters of the shared-memory side; take them from [`Server::served`](super::Server::served).
    pub served: Served,
}

/// Where the job stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Progress {
    /// Nothing was started yet.
    #[default]
    Idle,
    /// Motions are being driven.
    Driving,
    /// The arm holds until the estimator offers the model.
    AwaitingModel,
    /// Everything was driven.
    Done,
    /// A stop ended the job.
    Stopped,
}

/// One connection to the arm, from its first state to its end.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Session {
    /// What it was for.
    pub name: String,
    /// Counts and times of the loop.
    #[serde(flatten)]
    pub statistics: LoopStatistics,
    /// Allocations inside the loop; `None` when the allocator was not watched.
    pub allocations: Option<u32>,
    /// From state read to shared memory, on the bridge thread.
    pub bridge: Distribution,
    /// What the operating system did not grant, with what to change.
    pub refusals: Vec<String>,
    /// How it ended.
    pub end: String,
    /// The network to the robot; absent where there is none.
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

/// What is known of the direction of gravity. Directions are `[rho, phi]` of paper eq. 3 \[rad\].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Gravity {
    /// Where the gravity that the model has comes from: `declared`, `measured`, or `held` from before the sensor was lost.
    pub source: String,
    /// How the inclinometer is; absent where there is none.
    pub inclinometer: Option<String>,
    /// What it measured last.
    pub measured: Option<[f64; 2]>,
    /// Standard deviations of that.
    pub std: Option<[f64; 2]>,
    /// Standard deviation of its direction \[rad\].
    #[serde(default)]
    pub uncertainty: Option<f64>,
    /// What the robot's own accelerometers say.
    pub robot: Option<[f64; 2]>,
    /// What the torques at rest imply under the model.
    pub torques: Option<[f64; 2]>,
    /// Gravity in the base frame that the arm's own controller compensates \[m/s2\].
    #[serde(default)]
    pub vendor: Option<[f64; 3]>,
    /// Why the model is not served, where it is not.
    pub refused: Option<String>,
    /// What has happened, the latest last.
    pub events: Vec<String>,
    /// Events that there was no room for any more, the oldest ones.
    #[serde(default)]
    pub forgotten: u64,
    /// What the inclinometer measured when each motion began.
    pub motions: Vec<MotionGravity>,
    /// No bus is listened to, but a socket that plays one.
    #[serde(default)]
    pub simulated: bool,
    /// What is served without a reading: `refuse`, `hold` or `declared`; absent without an inclinometer.
    #[serde(default)]
    pub on_loss: Option<String>,
    /// How often the inclinometer was lost after it had been there.
    #[serde(default)]
    pub losses: u64,
    /// How long it was gone, all together \[s\].
    #[serde(default)]
    pub lost_s: f64,
    /// How often the model got another gravity.
    #[serde(default)]
    pub hand_overs: u64,
    /// Largest angle between the gravity that the model had and the declared one \[rad\].
    #[serde(default)]
    pub furthest: f64,
}

/// Direction of gravity at the beginning of a motion, as measured.
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

/// What the shared-memory side has done since the daemon's start.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Served {
    /// Identity of the daemon's start.
    pub epoch: u64,
    /// Records published.
    pub published: u64,
    /// Number of the oldest record still held; as many have been given up.
    pub first_retained: u64,
    /// Records given up that no follower had acknowledged before.
    pub given_up_unacknowledged: u64,
    /// The furthest acknowledgement of any follower: all records before it arrived.
    pub acknowledged: u64,
    /// Records sent again because a follower missed them.
    pub replayed: u64,
    /// Batches that shared memory had no room for; followers fetch their records by replay.
    pub unsent_batches: u64,
    /// Feed-forward values published.
    pub feed_forward: u64,
    /// Requests that could not be read.
    pub garbled_requests: u64,
    /// Time that the daemon's bridge thread has spent on requests \[ns\]: a fifth of all time at most, however many there are.
    #[serde(default)]
    pub answering_ns: u64,
    /// The last thing that shared memory refused to do, if any.
    pub trouble: Option<String>,
    /// Whoever follows the samples.
    pub followers: Vec<Follower>,
}

/// One follower of the samples.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Follower {
    /// What it calls itself.
    pub name: String,
    /// Its process.
    pub pid: u32,
    /// All records before this number arrived there.
    pub acknowledged: u64,
    /// Time since it was last heard of \[ms\].
    pub silent_ms: u64,
}

/// Writes `value` as JSON of at most `limit` bytes.
pub(super) fn encode<T: Serialize>(what: &'static str, value: &T, limit: usize) -> Result<Vec<u8>, IpcError> {
    let bytes = serde_json::to_vec(value).map_err(|error| IpcError::Malformed { what, reason: error.to_string() })?;
    if bytes.len() > limit {
        return Err(IpcError::TooLong { what, bytes: bytes.len(), limit });
    }
    Ok(bytes)
}

/// Reads JSON of at most `limit` bytes.
pub(super) fn decode<T: DeserializeOwned>(what: &'static str, bytes: &[u8], limit: usize) -> Result<T, IpcError> {
    if bytes.len() > limit {
        return Err(IpcError::TooLong { what, bytes: bytes.len(), limit });
    }
    serde_json::from_slice(bytes).map_err(|error| IpcError::Malformed { what, reason: error.to_string() })
}

/// A phase by its name, as people read it.
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
    fn requests_and_responses_come_back_as_they_were() {
        let toml = "name = \"a\"\n# \u{3c1}\n".to_string();
        for request in [
            Request::Status {},
            Request::Start {},
            Request::Stop {},
            Request::Resume {},
            Request::Quit {},
            Request::OfferModel { toml: toml.clone() },
            Request::ProposeModel { toml, proposal: Proposal { what: "payload".into(), ..Proposal::default() } },
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
    fn a_request_may_name_the_daemon_that_it_is_meant_for() {
        for request in [Request::Start {}, Request::OfferModel { toml: "a = 1".into() }] {
            for epoch in [None, Some(u64::MAX)] {
                let envelope = Envelope { epoch, request: request.clone() };
                let bytes = encode("request", &envelope, MAX_REQUEST_BYTES).unwrap();
                assert_eq!(decode::<Envelope>("request", &bytes, MAX_REQUEST_BYTES).unwrap(), envelope);
            }
            // One that names none is the request alone, as earlier versions sent it.
            let bytes = encode("request", &request, MAX_REQUEST_BYTES).unwrap();
            let read = decode::<Envelope>("request", &bytes, MAX_REQUEST_BYTES).unwrap();
            assert_eq!(read, Envelope { epoch: None, request });
        }
        for text in [r#"{"request":"stop","now":1}"#, r#"{"epoch":1}"#, r#"{"epoch":"a","request":"stop"}"#] {
            let error = decode::<Envelope>("request", text.as_bytes(), MAX_REQUEST_BYTES).unwrap_err();
            assert!(matches!(error, IpcError::Malformed { .. }), "{text:?}: {error}");
        }
    }

    #[test]
    fn what_a_shell_would_write_is_understood() {
        let read = |text: &str| decode::<Request>("request", text.as_bytes(), MAX_REQUEST_BYTES);
        assert_eq!(read(r#"{"request":"stop"}"#).unwrap(), Request::Stop {});
        assert_eq!(read(r#"{"request":"offer-model","toml":""}"#).unwrap(), Request::OfferModel { toml: "".into() });
    }

    #[test]
    fn garbage_is_an_error() {
        for text in ["", "{", "null", "[]", r#"{"request":"dance"}"#, r#"{"request":"stop","now":1}"#, "\u{0}\u{1}"] {
            let error = decode::<Request>("request", text.as_bytes(), MAX_REQUEST_BYTES).unwrap_err();
            assert!(matches!(error, IpcError::Malformed { .. }), "{text:?}: {error}");
        }
        let deep = "[".repeat(100_000);
        assert!(decode::<Request>("request", deep.as_bytes(), MAX_REQUEST_BYTES).is_err());
        let error = encode("request", &Request::OfferModel { toml: "x".repeat(99) }, 64).unwrap_err();
        assert!(matches!(error, IpcError::TooLong { limit: 64, .. }), "{error}");
        assert!(matches!(decode::<Request>("request", &[b' '; 65], 64), Err(IpcError::TooLong { bytes: 65, .. })));
    }
}
