//! What can go wrong between processes.

/// Why a message could not be passed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IpcError {
    /// No daemon serves this robot.
    #[error("no daemon serves robot `{robot}` (waited {waited_ms} ms)")]
    NoDaemon {
        /// The robot asked for.
        robot: String,
        /// How long it was waited for \[ms\].
        waited_ms: u64,
    },
    /// The daemon did not answer in time.
    #[error("the daemon of robot `{robot}` gave no answer within {waited_ms} ms")]
    NoAnswer {
        /// The robot asked for.
        robot: String,
        /// How long it was waited for \[ms\].
        waited_ms: u64,
    },
    /// Every place of a service is taken.
    #[error("service `{service}` has no place left for another {port}")]
    Full {
        /// Name of the service.
        service: String,
        /// Kind of port that found no place, and who has them where that is known.
        port: String,
    },
    /// A service of that name exists, but was made by another version of plumbline.
    #[error("service `{service}` exists with other types or sizes than this version of plumbline uses: {reason}")]
    Incompatible {
        /// Name of the service.
        service: String,
        /// iceoryx2's own word for it.
        reason: String,
    },
    /// A request or an answer exceeds what is passed.
    #[error("{what} has {bytes} bytes, the limit is {limit}")]
    TooLong {
        /// What was to be sent.
        what: &'static str,
        /// Its size.
        bytes: usize,
        /// The limit.
        limit: usize,
    },
    /// Bytes that are not what they should be.
    #[error("{what} can't be read: {reason}")]
    Malformed {
        /// What was expected.
        what: &'static str,
        /// Why it is not that.
        reason: String,
    },
    /// iceoryx2 failed by itself.
    #[error("shared memory failed: {doing} `{service}`: {reason}")]
    Transport {
        /// What was attempted.
        doing: &'static str,
        /// On which service.
        service: String,
        /// iceoryx2's own word for it.
        reason: String,
    },
}
