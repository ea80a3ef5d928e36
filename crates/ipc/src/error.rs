//! Errors of interprocess communication.

/// Error of interprocess communication.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum IpcError {
    #[error("no daemon serves robot `{robot}` (waited {waited_ms} ms)")]
    NoDaemon { robot: String, waited_ms: u64 },
    /// The daemon runs but did not respond in time.
    #[error("the daemon of robot `{robot}` did not respond within {waited_ms} ms")]
    NoAnswer { robot: String, waited_ms: u64 },
    #[error("service `{service}` has no free slot for another {port}")]
    Full { service: String, port: String },
    #[error("service `{service}` exists with other types or sizes than this version of plumbline uses: {reason}")]
    Incompatible { service: String, reason: String },
    /// A request or a response exceeds its maximum length.
    #[error("{what} has {bytes} bytes, the limit is {limit}")]
    TooLong { what: &'static str, bytes: usize, limit: usize },
    #[error("{what} can't be read: {reason}")]
    Malformed { what: &'static str, reason: String },
    #[error("shared memory failed: {doing} `{service}`: {reason}")]
    Transport { doing: &'static str, service: String, reason: String },
}
