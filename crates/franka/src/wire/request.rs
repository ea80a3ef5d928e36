//! What a client asks for over TCP.

use super::codes::{Architecture, System};
use super::cursor::{Reader, Writer, message};
use super::error::WireError;
use super::header::HEADER_BYTES;
use super::kind::CommandKind;
use super::payload::{CollisionBehavior, Connect, Filters, GuidingMode, LibraryTarget, Load, Move};
use super::protocol::Protocol;

/// Length of the longest request, header included \[bytes\].
pub const MAX_REQUEST: usize = HEADER_BYTES + 416;

/// A command with what it carries.
#[derive(Clone, Copy, Debug, PartialEq)]
// A request lives on the stack for as long as it is encoded or served; a box would allocate.
#[allow(clippy::large_enum_variant)]
pub enum Request {
    /// Opens a session.
    Connect(Connect),
    /// Starts a motion.
    Move(Move),
    /// Ends the running motion.
    StopMove,
    /// Reads the virtual wall of this number.
    GetCartesianLimit(i32),
    /// Sets the thresholds of contact and collision.
    SetCollisionBehavior(CollisionBehavior),
    /// Sets the stiffness per joint \[Nm/rad\].
    SetJointImpedance([f64; 7]),
    /// Sets the stiffness per direction x, y, z \[N/m\], R, P, Y \[Nm/rad\].
    SetCartesianImpedance([f64; 6]),
    /// Sets what can be guided by hand.
    SetGuidingMode(GuidingMode),
    /// Sets `EE_T_K`, column-major.
    SetEeToK([f64; 16]),
    /// Sets `NE_T_EE`, column-major.
    SetNeToEe([f64; 16]),
    /// Sets the load.
    SetLoad(Load),
    /// Sets the filters.
    SetFilters(Filters),
    /// Recovers from a reflex.
    AutomaticErrorRecovery,
    /// Loads the arm's model as a shared library.
    LoadModelLibrary(LibraryTarget),
    /// Reads the arm's model as URDF.
    GetRobotModel,
}

impl Request {
    /// The command.
    pub const fn kind(&self) -> CommandKind {
        match self {
            Request::Connect(_) => CommandKind::Connect,
            Request::Move(_) => CommandKind::Move,
            Request::StopMove => CommandKind::StopMove,
            Request::GetCartesianLimit(_) => CommandKind::GetCartesianLimit,
            Request::SetCollisionBehavior(_) => CommandKind::SetCollisionBehavior,
            Request::SetJointImpedance(_) => CommandKind::SetJointImpedance,
            Request::SetCartesianImpedance(_) => CommandKind::SetCartesianImpedance,
            Request::SetGuidingMode(_) => CommandKind::SetGuidingMode,
            Request::SetEeToK(_) => CommandKind::SetEeToK,
            Request::SetNeToEe(_) => CommandKind::SetNeToEe,
            Request::SetLoad(_) => CommandKind::SetLoad,
            Request::SetFilters(_) => CommandKind::SetFilters,
            Request::AutomaticErrorRecovery => CommandKind::AutomaticErrorRecovery,
            Request::LoadModelLibrary(_) => CommandKind::LoadModelLibrary,
            Request::GetRobotModel => CommandKind::GetRobotModel,
        }
    }

    /// The request whose header named `kind` and was followed by `payload`.
    ///
    /// # Errors
    ///
    /// [`WireError::Absent`] when `protocol` does not have the command, [`WireError::Length`], [`WireError::Value`],
    /// [`WireError::Flag`]. Numbers are taken as they come, finite or not.
    pub fn decode(protocol: Protocol, kind: CommandKind, payload: &[u8]) -> Result<Request, WireError> {
        kind.number_or_absent(protocol)?;
        let (expected, found) = (kind.request_bytes(protocol), payload.len());
        if found != expected {
            return Err(WireError::Length { what: kind.name(), expected, found });
        }
        let reader = &mut Reader::new(kind.name(), payload);
        Ok(match kind {
            CommandKind::Connect => Request::Connect(Connect::read(reader)?),
            CommandKind::Move => Request::Move(Move::read(protocol, reader)?),
            CommandKind::StopMove => Request::StopMove,
            CommandKind::GetCartesianLimit => Request::GetCartesianLimit(reader.i32()?),
            CommandKind::SetCollisionBehavior => Request::SetCollisionBehavior(CollisionBehavior::read(reader)?),
            CommandKind::SetJointImpedance => Request::SetJointImpedance(reader.reals()?),
            CommandKind::SetCartesianImpedance => Request::SetCartesianImpedance(reader.reals()?),
            CommandKind::SetGuidingMode => Request::SetGuidingMode(GuidingMode {
                axes: reader.flags("guiding_mode")?,
                nullspace: reader.flag("nullspace")?,
            }),
            CommandKind::SetEeToK => Request::SetEeToK(reader.reals()?),
            CommandKind::SetNeToEe => Request::SetNeToEe(reader.reals()?),
            CommandKind::SetLoad => {
                Request::SetLoad(Load { mass: reader.real()?, com: reader.reals()?, inertia: reader.reals()? })
            }
            CommandKind::SetFilters => {
                let [joint_position, joint_velocity, cartesian_position, cartesian_velocity, controller] =
                    reader.reals()?;
                Request::SetFilters(Filters {
                    joint_position,
                    joint_velocity,
                    cartesian_position,
                    cartesian_velocity,
                    controller,
                })
            }
            CommandKind::AutomaticErrorRecovery => Request::AutomaticErrorRecovery,
            CommandKind::LoadModelLibrary => {
                let (architecture, system) = (reader.u8()?, reader.u8()?);
                let value = |what, most, found| WireError::Value { what, most, found: u32::from(found) };
                Request::LoadModelLibrary(LibraryTarget {
                    architecture: Architecture::from_code(architecture).ok_or(value(
                        "the architecture of LoadModelLibrary",
                        3,
                        architecture,
                    ))?,
                    system: System::from_code(system).ok_or(value("the system of LoadModelLibrary", 1, system))?,
                })
            }
            CommandKind::GetRobotModel => Request::GetRobotModel,
        })
    }

    /// Writes the whole message, header included, to the front of `out` and returns its length.
    ///
    /// # Errors
    ///
    /// [`WireError::Absent`] when `protocol` does not have the command, or a motion without motion generator (use
    /// [`super::MoveGenerator::torque_only`]), or an asynchronous one.
    pub fn encode(&self, protocol: Protocol, command_id: u32, out: &mut [u8; MAX_REQUEST]) -> Result<usize, WireError> {
        message(protocol, self.kind(), command_id, out, |writer| self.write(protocol, writer))
    }

    fn write(&self, protocol: Protocol, writer: &mut Writer) -> Result<(), WireError> {
        match self {
            Request::Connect(connect) => connect.write(writer),
            Request::Move(request) => request.write(protocol, writer),
            Request::StopMove | Request::AutomaticErrorRecovery | Request::GetRobotModel => Ok(()),
            Request::GetCartesianLimit(id) => writer.i32(*id),
            Request::SetCollisionBehavior(behavior) => behavior.write(writer),
            Request::SetJointImpedance(stiffness) => writer.reals(stiffness),
            Request::SetCartesianImpedance(stiffness) => writer.reals(stiffness),
            Request::SetGuidingMode(mode) => {
                writer.flags(&mode.axes)?;
                writer.flags(&[mode.nullspace])
            }
            Request::SetEeToK(pose) | Request::SetNeToEe(pose) => writer.reals(pose),
            Request::SetLoad(load) => {
                writer.reals(&[load.mass])?;
                writer.reals(&load.com)?;
                writer.reals(&load.inertia)
            }
            Request::SetFilters(filters) => writer.reals(&[
                filters.joint_position,
                filters.joint_velocity,
                filters.cartesian_position,
                filters.cartesian_velocity,
                filters.controller,
            ]),
            Request::LoadModelLibrary(target) => {
                writer.u8(target.architecture.code())?;
                writer.u8(target.system.code())
            }
        }
    }
}
