//! The head of every message over TCP.

use super::error::WireError;

/// Length of a header \[bytes\].
pub const HEADER_BYTES: usize = 12;

/// Bound for the length of any message \[bytes\]: far above a model library or a robot description, the longest things there are.
pub const MAX_MESSAGE: u32 = 16 << 20;

/// Which command, which of its calls, and how long the message is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Number of the command, see [`super::CommandKind::from_number`].
    pub command: u32,
    /// Chosen by the client; every response to the call carries it.
    pub command_id: u32,
    /// Length of header and payload \[bytes\].
    pub size: u32,
}

impl Header {
    /// The header that `bytes` hold, whose message may have at most `most` bytes (a server takes [`super::MAX_REQUEST`], a client
    /// [`MAX_MESSAGE`]).
    ///
    /// # Errors
    ///
    /// [`WireError::Size`] when the message would be shorter than its header, or longer than `most`.
    pub fn decode(bytes: &[u8; HEADER_BYTES], most: u32) -> Result<Header, WireError> {
        let [a0, a1, a2, a3, b0, b1, b2, b3, c0, c1, c2, c3] = *bytes;
        let size = u32::from_le_bytes([c0, c1, c2, c3]);
        let least = HEADER_BYTES as u32;
        if !(least..=most).contains(&size) {
            return Err(WireError::Size { least, most, found: size });
        }
        let command = u32::from_le_bytes([a0, a1, a2, a3]);
        Ok(Header { command, command_id: u32::from_le_bytes([b0, b1, b2, b3]), size })
    }

    /// The header as bytes.
    pub fn encode(&self) -> [u8; HEADER_BYTES] {
        let mut bytes = [0; HEADER_BYTES];
        let words = [self.command, self.command_id, self.size];
        for (chunk, word) in bytes.as_chunks_mut().0.iter_mut().zip(words) {
            *chunk = word.to_le_bytes();
        }
        bytes
    }

    /// Length of what follows the header \[bytes\].
    pub fn payload_bytes(&self) -> usize {
        (self.size as usize).saturating_sub(HEADER_BYTES)
    }
}
