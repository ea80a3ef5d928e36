//! Why bytes are not a message, or a message can't become bytes.

use super::kind::CommandKind;

/// What was expected and what was found. `Copy` and without text of its own, so that it can leave the real-time loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// A packet or payload of fixed length has another one.
    #[error("{what} has {found} bytes instead of {expected}")]
    Length {
        /// The message.
        what: &'static str,
        /// Its length in this version.
        expected: usize,
        /// The length that came.
        found: usize,
    },
    /// A message ends before its last field.
    #[error("{what} has {found} bytes, but needs at least {least}")]
    Short {
        /// The message.
        what: &'static str,
        /// The least length that holds every field.
        least: usize,
        /// The length that came.
        found: usize,
    },
    /// The size field of a header is out of bounds.
    #[error("a header says {found} bytes, expected {least} to {most}")]
    Size {
        /// Length of a header alone.
        least: u32,
        /// The bound of the reader.
        most: u32,
        /// The size in the header.
        found: u32,
    },
    /// An enumeration holds a number that this version does not know.
    #[error("{what} is {found}, expected 0 to {most}")]
    Value {
        /// The field.
        what: &'static str,
        /// The greatest number that this version knows.
        most: u32,
        /// The number that came.
        found: u32,
    },
    /// A byte that is a flag holds neither 0 nor 1.
    #[error("{what}[{index}] is {found}, expected 0 or 1")]
    Flag {
        /// The field.
        what: &'static str,
        /// Place in the field, 0 where it is a single flag.
        index: usize,
        /// The byte that came.
        found: u8,
    },
    /// The number of a command that this version does not have.
    #[error("command number {found} does not exist in protocol version {version}")]
    Command {
        /// The number in the header.
        found: u32,
        /// The protocol version.
        version: u16,
    },
    /// Something that this version has no bytes for.
    #[error("{what} does not exist in protocol version {version}")]
    Absent {
        /// The command, status, mode or option.
        what: &'static str,
        /// The protocol version.
        version: u16,
    },
    /// A response that does not belong to the command that it names.
    #[error("{kind} does not answer with the status of a setter")]
    NotASetter {
        /// The command named.
        kind: CommandKind,
    },
    /// A robot description that is not UTF-8.
    #[error("the robot description is not UTF-8 from byte {valid} on")]
    NotText {
        /// Bytes that are good.
        valid: usize,
    },
    /// The buffer to write to is too small.
    #[error("a buffer of {found} bytes is too small for the message")]
    Buffer {
        /// Length of the buffer.
        found: usize,
    },
}
