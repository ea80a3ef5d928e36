//! What the arm answers over TCP.

use super::bytes::{Reader, Writer, message};
use super::codes::{
    ConnectStatus, LoadModelStatus, MoveStatus, RecoveryStatus, RobotModelStatus, SetterStatus, StopStatus,
};
use super::protocol::{CommandKind, HEADER_BYTES, Protocol, WireError};

/// Length of the longest response that carries neither library nor text, header included \[bytes\].
pub const MAX_FIXED_RESPONSE: usize = HEADER_BYTES + 154;

/// Answer to Connect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Connected {
    /// Whether the session is open.
    pub status: ConnectStatus,
    /// Version that the arm speaks, which need not be one of [`Protocol`].
    pub version: u16,
}

impl Connected {
    /// The payload of the answer to Connect, which is the same in every version.
    ///
    /// # Errors
    ///
    /// [`WireError::Short`], and [`WireError::Value`] for an unknown status.
    pub fn decode(payload: &[u8]) -> Result<Connected, WireError> {
        Connected::read(&mut Reader::new("the answer to Connect", payload))
    }

    fn read(reader: &mut Reader) -> Result<Connected, WireError> {
        // The numbers of this status never changed: any version reads them.
        Ok(Connected { status: ConnectStatus::read(Protocol::V10, reader)?, version: reader.u16()? })
    }
}

/// Answer to GetCartesianLimit: a virtual wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CartesianLimit {
    /// Whether the rest counts.
    pub status: SetterStatus,
    /// Edges of the cuboid \[m\].
    pub size: [f64; 3],
    /// Its pose in the base, column-major.
    pub frame: [f64; 16],
    /// Whether it is on.
    pub active: bool,
}

/// An answer with what it carries; text and library stay in the buffer that they came in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Response<'a> {
    /// To Connect.
    Connect(Connected),
    /// To Move.
    Move(MoveStatus),
    /// To StopMove.
    StopMove(StopStatus),
    /// To GetCartesianLimit.
    GetCartesianLimit(CartesianLimit),
    /// To a command that sets something, see [`CommandKind::is_setter`].
    Setter(CommandKind, SetterStatus),
    /// To AutomaticErrorRecovery.
    AutomaticErrorRecovery(RecoveryStatus),
    /// To LoadModelLibrary.
    LoadModelLibrary {
        /// Whether a library follows.
        status: LoadModelStatus,
        /// The shared library.
        library: &'a [u8],
    },
    /// To GetRobotModel.
    GetRobotModel {
        /// Whether a description follows.
        status: RobotModelStatus,
        /// The description as URDF.
        urdf: &'a str,
    },
}

impl<'a> Response<'a> {
    /// The command that is answered.
    pub const fn kind(&self) -> CommandKind {
        match self {
            Response::Connect(_) => CommandKind::Connect,
            Response::Move(_) => CommandKind::Move,
            Response::StopMove(_) => CommandKind::StopMove,
            Response::GetCartesianLimit(_) => CommandKind::GetCartesianLimit,
            Response::Setter(kind, _) => *kind,
            Response::AutomaticErrorRecovery(_) => CommandKind::AutomaticErrorRecovery,
            Response::LoadModelLibrary { .. } => CommandKind::LoadModelLibrary,
            Response::GetRobotModel { .. } => CommandKind::GetRobotModel,
        }
    }

    /// Length of the whole message, header included \[bytes\].
    pub const fn bytes(&self) -> usize {
        HEADER_BYTES
            + match self {
                Response::Connect(_) => 3,
                Response::GetCartesianLimit(_) => 154,
                Response::LoadModelLibrary { library, .. } => 1 + library.len(),
                Response::GetRobotModel { urdf, .. } => 1 + urdf.len(),
                _ => 1,
            }
    }

    /// The answer whose header named `kind` and was followed by `payload`. As in libfranka, bytes behind the last field are
    /// ignored.
    ///
    /// # Errors
    ///
    /// [`WireError::Absent`] when `protocol` does not have the command, [`WireError::Short`], [`WireError::Value`] for an unknown
    /// status, [`WireError::Flag`], [`WireError::NotText`].
    pub fn decode(protocol: Protocol, kind: CommandKind, payload: &'a [u8]) -> Result<Response<'a>, WireError> {
        kind.number_or_absent(protocol)?;
        let mut reader = Reader::new(answer_to(kind), payload);
        Ok(match kind {
            CommandKind::Connect => Response::Connect(Connected::read(&mut reader)?),
            CommandKind::Move => Response::Move(MoveStatus::read(protocol, &mut reader)?),
            CommandKind::StopMove => Response::StopMove(StopStatus::read(protocol, &mut reader)?),
            CommandKind::GetCartesianLimit => Response::GetCartesianLimit(CartesianLimit {
                status: SetterStatus::read(protocol, &mut reader)?,
                size: reader.reals()?,
                frame: reader.reals()?,
                active: reader.flag("object_activation")?,
            }),
            CommandKind::SetCollisionBehavior
            | CommandKind::SetJointImpedance
            | CommandKind::SetCartesianImpedance
            | CommandKind::SetGuidingMode
            | CommandKind::SetEeToK
            | CommandKind::SetNeToEe
            | CommandKind::SetLoad
            | CommandKind::SetFilters => Response::Setter(kind, SetterStatus::read(protocol, &mut reader)?),
            CommandKind::AutomaticErrorRecovery => {
                Response::AutomaticErrorRecovery(RecoveryStatus::read(protocol, &mut reader)?)
            }
            CommandKind::LoadModelLibrary => {
                let status = LoadModelStatus::read(protocol, &mut reader)?;
                Response::LoadModelLibrary { status, library: reader.rest() }
            }
            CommandKind::GetRobotModel => {
                let status = RobotModelStatus::read(protocol, &mut reader)?;
                let not_text = |error: std::str::Utf8Error| WireError::NotText { valid: error.valid_up_to() };
                Response::GetRobotModel { status, urdf: std::str::from_utf8(reader.rest()).map_err(not_text)? }
            }
        })
    }

    /// Writes the whole message, header included, to the front of `out` and returns its length, [`Response::bytes`].
    ///
    /// # Errors
    ///
    /// [`WireError::Absent`] when `protocol` does not have the command or the status, [`WireError::NotASetter`],
    /// [`WireError::Buffer`] when `out` is too small ([`MAX_FIXED_RESPONSE`] is enough without text and library).
    pub fn encode(&self, protocol: Protocol, command_id: u32, out: &mut [u8]) -> Result<usize, WireError> {
        message(protocol, self.kind(), command_id, out, |writer| self.write(protocol, writer))
    }

    fn write(&self, protocol: Protocol, writer: &mut Writer) -> Result<(), WireError> {
        match self {
            Response::Connect(connected) => {
                connected.status.write(protocol, writer)?;
                writer.u16(connected.version)
            }
            Response::Move(status) => status.write(protocol, writer),
            Response::StopMove(status) => status.write(protocol, writer),
            Response::GetCartesianLimit(limit) => {
                limit.status.write(protocol, writer)?;
                writer.reals(&limit.size)?;
                writer.reals(&limit.frame)?;
                writer.flags(&[limit.active])
            }
            Response::Setter(kind, status) if kind.is_setter() => status.write(protocol, writer),
            Response::Setter(kind, _) => Err(WireError::NotASetter { kind: *kind }),
            Response::AutomaticErrorRecovery(status) => status.write(protocol, writer),
            Response::LoadModelLibrary { status, library } => {
                status.write(protocol, writer)?;
                writer.bytes(library)
            }
            Response::GetRobotModel { status, urdf } => {
                status.write(protocol, writer)?;
                writer.bytes(urdf.as_bytes())
            }
        }
    }
}

const fn answer_to(kind: CommandKind) -> &'static str {
    match kind {
        CommandKind::Connect => "the answer to Connect",
        CommandKind::GetCartesianLimit => "the answer to GetCartesianLimit",
        CommandKind::LoadModelLibrary => "the answer to LoadModelLibrary",
        CommandKind::GetRobotModel => "the answer to GetRobotModel",
        _ => "the answer of one status",
    }
}
