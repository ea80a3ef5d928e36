//! Torque, model and states across users of one machine.
//!
//! iceoryx2 gives its memory to one user: every port writes to the service's memory, and the permissions are constants of the library. So two relays connect
//! two users' services over a socket, which a group may open:
//!
//! | end | user | what |
//! |---|---|---|
//! | [`serve()`] | the daemon's | client of the daemon: sends torque and model, publishes the states that arrive |
//! | [`join()`] | another of the group | serves torque and model to that user's clients, sends the states of that user's publisher |
//!
//! No request of a user passes: a [`Frame`] that is not `States` ends the connection. Neither end is real-time.

mod join;
mod serve;

pub use join::join;
pub use serve::serve;

use plumbline_core::BadInput;
use plumbline_ipc::{FeedForwardMessage, GuestMessage, ModelHeader, RobotId};
use serde::{Deserialize, Serialize};
use std::io::{self, Read, Write};
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Folder of the sockets, made by systemd-tmpfiles for the group of the service.
pub const FOLDER: &str = "/run/plumbline-relay";
/// Largest frame \[bytes\]: a model file of 2 MiB with escapes.
const MAX_FRAME_BYTES: u32 = 8 << 20;
/// Interval at which new values are looked for.
const INTERVAL: Duration = Duration::from_micros(500);
/// Interval of [`Frame::Alive`], and of looking whether the daemon runs.
const ALIVE: Duration = Duration::from_millis(100);
/// Silence after which the other end counts as gone.
const GONE: Duration = Duration::from_secs(2);

/// What the two ends send.
#[allow(clippy::large_enum_variant, reason = "most frames are the largest")]
#[derive(Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Frame {
    /// From [`serve()`]: the latest feed-forward value.
    Torque(FeedForwardMessage),
    /// From [`serve()`]: the served model and the text of its file.
    Model { header: ModelHeader, text: String },
    /// To [`serve()`]: states of an arm that the user controls.
    States(Vec<GuestMessage>),
    /// Either: nothing new.
    Alive,
    /// From [`serve()`]: why it ends the connection.
    Refused(String),
}

/// Writes a frame: its length as 4 bytes, least significant first, then JSON.
fn write(to: &mut impl Write, frame: &Frame) -> io::Result<()> {
    let text = serde_json::to_vec(frame).map_err(io::Error::other)?;
    let length = u32::try_from(text.len()).ok().filter(|length| *length <= MAX_FRAME_BYTES);
    let length = length
        .ok_or_else(|| io::Error::other(format!("a frame has {} bytes, the limit is {MAX_FRAME_BYTES}", text.len())))?;
    let mut bytes = length.to_le_bytes().to_vec();
    bytes.extend(text);
    to.write_all(&bytes)
}

/// Reads a frame.
fn read(from: &mut impl Read) -> io::Result<Frame> {
    let mut length = [0; 4];
    from.read_exact(&mut length)?;
    let length = u32::from_le_bytes(length);
    if length > MAX_FRAME_BYTES {
        return Err(io::Error::other(format!("a frame has {length} bytes, the limit is {MAX_FRAME_BYTES}")));
    }
    let mut text = vec![0; length as usize];
    from.read_exact(&mut text)?;
    serde_json::from_slice(&text).map_err(io::Error::other)
}

/// The socket of a robot in `folder`, which no user but its owner and root may write to: another one could put a socket of the same name there.
fn socket(folder: &Path, robot: &RobotId) -> Result<PathBuf, BadInput> {
    let bad = |value: String| {
        let expected = "a folder that only its owner can write to, as systemd-tmpfiles makes /run/plumbline-relay";
        BadInput::new("command line", "--folder", format!("{}: {value}", folder.display()), expected)
    };
    let found = std::fs::symlink_metadata(folder).map_err(|error| bad(error.to_string()))?;
    if !found.is_dir() || found.mode() & 0o022 != 0 {
        return Err(bad(format!("mode {:o}", found.mode() & 0o7777)));
    }
    Ok(folder.join(format!("{robot}.sock")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_read_as_they_were_written_and_others_are_errors() {
        let guest = GuestMessage { n: 7, q: [0.1 + 0.2; 8], stamp_ns: u64::MAX, ..GuestMessage::default() };
        let header = ModelHeader { model: u64::MAX - 1, gravity: [9.81, 1e-300, -0.0], ..ModelHeader::default() };
        let torque = FeedForwardMessage { tau_ff: [-1.0 / 3.0; 8], sequence: 9, ..FeedForwardMessage::default() };
        let text = "name = \"\u{3c4}\"\n".to_string();
        let frames =
            [Frame::Torque(torque), Frame::Model { header, text }, Frame::States(vec![guest; 3]), Frame::Alive];
        let mut bytes = Vec::new();
        frames.iter().for_each(|frame| write(&mut bytes, frame).unwrap());
        let mut from = &bytes[..];
        frames.iter().for_each(|frame| assert_eq!(read(&mut from).unwrap(), *frame));
        assert_eq!(read(&mut from).unwrap_err().kind(), io::ErrorKind::UnexpectedEof);

        assert!(read(&mut &[255; 16][..]).unwrap_err().to_string().contains("the limit is 8388608"));
        for garbage in [&b"\x03\x00\x00\x00abc"[..], b"\x08\x00\x00\x00\"start\"\n", b"\x02\x00\x00\x00{}"] {
            assert!(read(&mut &garbage[..]).is_err());
        }
    }

    #[test]
    fn a_folder_that_others_can_write_to_is_refused() {
        use std::os::unix::fs::PermissionsExt;
        let robot = RobotId::parse("test", "robot", "panda").unwrap();
        let folder = tempfile::tempdir().unwrap();
        let with = |mode| {
            std::fs::set_permissions(folder.path(), std::fs::Permissions::from_mode(mode)).unwrap();
            socket(folder.path(), &robot)
        };
        assert_eq!(with(0o750).unwrap(), folder.path().join("panda.sock"));
        assert!(with(0o770).unwrap_err().to_string().contains("mode 770"));
        assert!(socket(&folder.path().join("none"), &robot).is_err());
    }
}
