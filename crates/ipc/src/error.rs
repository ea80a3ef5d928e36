//! Errors of interprocess communication.

/// Error of interprocess communication.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum IpcError {
    /// No daemon serves this robot.
    #[error("no daemon serves robot `{robot}` (waited {waited_ms} ms)")]
    NoDaemon {
        /// The robot asked for.
        robot: String,
        /// Timeout \[ms\].
        waited_ms: u64,
    },
    /// The daemon runs but did not respond in time.
    #[error("the daemon of robot `{robot}` did not respond within {waited_ms} ms")]
    NoAnswer {
        /// The robot asked for.
        robot: String,
        /// Timeout \[ms\].
        waited_ms: u64,
    },
    /// All slots of a service are in use.
    #[error("service `{service}` has no free slot for another {port}")]
    Full {
        /// Name of the service.
        service: String,
        /// Kind of port, and the processes that hold the slots where known.
        port: String,
    },
    /// The service was created by another version of plumbline.
    #[error("service `{service}` exists with other types or sizes than this version of plumbline uses: {reason}")]
    Incompatible {
        /// Name of the service.
        service: String,
        /// Error of iceoryx2.
        reason: String,
    },
    /// A request or a response exceeds its maximum length.
    #[error("{what} has {bytes} bytes, the limit is {limit}")]
    TooLong {
        /// Kind of message.
        what: &'static str,
        /// Its size.
        bytes: usize,
        /// The limit.
        limit: usize,
    },
    /// A message that can't be parsed.
    #[error("{what} can't be read: {reason}")]
    Malformed {
        /// Expected kind of message.
        what: &'static str,
        /// Parse error.
        reason: String,
    },
    /// iceoryx2 failed.
    #[error("shared memory failed: {doing} `{service}`: {reason}")]
    Transport {
        /// Attempted operation.
        doing: &'static str,
        /// Name of the service.
        service: String,
        /// Error of iceoryx2.
        reason: String,
    },
}
