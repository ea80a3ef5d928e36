//! Requests of a client over TCP, and what they carry.

use super::bytes::{Reader, Writer, message};
use super::codes::{Architecture, MoveController, MoveGenerator, System};
use super::protocol::{CommandKind, HEADER_BYTES, Protocol, WireError};
use std::f64::consts::TAU;

/// Opens a session. Has the same bytes in every version, so it can be read before the version is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Connect {
    /// Version that the client speaks, which need not be one of [`Protocol`].
    pub version: u16,
    /// UDP port at which the client waits for states.
    pub udp_port: u16,
}

impl Connect {
    /// The payload of a header with command [`super::CommandKind::CONNECT`].
    ///
    /// # Errors
    ///
    /// [`WireError::Length`] unless it has 4 bytes.
    pub fn decode(payload: &[u8]) -> Result<Connect, WireError> {
        if payload.len() != 4 {
            return Err(WireError::Length { what: "Connect", expected: 4, found: payload.len() });
        }
        Connect::read(&mut Reader::new("Connect", payload))
    }

    pub(super) fn read(reader: &mut Reader) -> Result<Connect, WireError> {
        Ok(Connect { version: reader.u16()?, udp_port: reader.u16()? })
    }

    pub(super) fn write(&self, writer: &mut Writer) -> Result<(), WireError> {
        writer.u16(self.version)?;
        writer.u16(self.udp_port)
    }
}

/// Largest deviation of the arm's internal motion generator. The default is what libfranka sends with every motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// \[m\]
    pub translation: f64,
    /// \[rad\]
    pub rotation: f64,
    /// \[rad\]
    pub elbow: f64,
}

impl Default for Deviation {
    fn default() -> Deviation {
        Deviation { translation: 10.0, rotation: 3.12, elbow: TAU }
    }
}

impl Deviation {
    fn read(reader: &mut Reader) -> Result<Deviation, WireError> {
        let [translation, rotation, elbow] = reader.reals()?;
        Ok(Deviation { translation, rotation, elbow })
    }
}

/// Starts a motion.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Move {
    /// Who makes the torques.
    pub controller: MoveController,
    /// What the commands hold.
    pub generator: MoveGenerator,
    /// From the path.
    pub max_path_deviation: Deviation,
    /// From the goal.
    pub max_goal_pose_deviation: Deviation,
    /// Commands may come rarely, and the arm plans between them; version 10 alone.
    pub use_async: bool,
    /// Highest joint velocity of such a motion \[rad/s\], else zero; not on the wire before version 10.
    pub max_velocity: [f64; 7],
}

impl Move {
    /// The motion as libfranka asks for it: its deviations, one command per state.
    pub fn new(controller: MoveController, generator: MoveGenerator) -> Move {
        Move {
            controller,
            generator,
            max_path_deviation: Deviation::default(),
            max_goal_pose_deviation: Deviation::default(),
            use_async: false,
            max_velocity: [0.0; 7],
        }
    }

    pub(super) fn read(protocol: Protocol, reader: &mut Reader) -> Result<Move, WireError> {
        let (controller, generator) = (reader.u32()?, reader.u32()?);
        let value = |what, most, found| WireError::Value { what, most, found };
        let mut request = Move::new(
            u8::try_from(controller).ok().and_then(MoveController::from_code).ok_or(value(
                "the controller of Move",
                2,
                controller,
            ))?,
            u8::try_from(generator)
                .ok()
                .and_then(MoveGenerator::from_code)
                .filter(|generator| *generator != MoveGenerator::None || protocol.has_torque_only())
                .ok_or(value(
                    "the motion generator of Move",
                    if protocol.has_torque_only() { 4 } else { 3 },
                    generator,
                ))?,
        );
        request.max_path_deviation = Deviation::read(reader)?;
        request.max_goal_pose_deviation = Deviation::read(reader)?;
        if protocol >= Protocol::V10 {
            request.use_async = reader.flag("use_async")?;
            request.max_velocity = reader.reals()?;
        }
        Ok(request)
    }

    pub(super) fn write(&self, protocol: Protocol, writer: &mut Writer) -> Result<(), WireError> {
        let absent = |what| Err(WireError::Absent { what, version: protocol.number() });
        if self.generator == MoveGenerator::None && !protocol.has_torque_only() {
            return absent("a motion without motion generator");
        }
        if self.use_async && protocol < Protocol::V10 {
            return absent("an asynchronous motion");
        }
        writer.u32(u32::from(self.controller.code()))?;
        writer.u32(u32::from(self.generator.code()))?;
        for deviation in [self.max_path_deviation, self.max_goal_pose_deviation] {
            writer.reals(&[deviation.translation, deviation.rotation, deviation.elbow])?;
        }
        if protocol >= Protocol::V10 {
            writer.flags(&[self.use_async])?;
            writer.reals(&self.max_velocity)?;
        }
        Ok(())
    }
}

/// Thresholds of contact (lower) and collision (upper), while accelerating and at constant velocity (nominal).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CollisionBehavior {
    /// \[Nm\]
    pub lower_torque_acceleration: [f64; 7],
    /// \[Nm\]
    pub upper_torque_acceleration: [f64; 7],
    /// \[Nm\]
    pub lower_torque_nominal: [f64; 7],
    /// \[Nm\]
    pub upper_torque_nominal: [f64; 7],
    /// \[N, Nm\]
    pub lower_force_acceleration: [f64; 6],
    /// \[N, Nm\]
    pub upper_force_acceleration: [f64; 6],
    /// \[N, Nm\]
    pub lower_force_nominal: [f64; 6],
    /// \[N, Nm\]
    pub upper_force_nominal: [f64; 6],
}

impl CollisionBehavior {
    pub(super) fn read(reader: &mut Reader) -> Result<CollisionBehavior, WireError> {
        Ok(CollisionBehavior {
            lower_torque_acceleration: reader.reals()?,
            upper_torque_acceleration: reader.reals()?,
            lower_torque_nominal: reader.reals()?,
            upper_torque_nominal: reader.reals()?,
            lower_force_acceleration: reader.reals()?,
            upper_force_acceleration: reader.reals()?,
            lower_force_nominal: reader.reals()?,
            upper_force_nominal: reader.reals()?,
        })
    }

    pub(super) fn write(&self, writer: &mut Writer) -> Result<(), WireError> {
        writer.reals(&self.lower_torque_acceleration)?;
        writer.reals(&self.upper_torque_acceleration)?;
        writer.reals(&self.lower_torque_nominal)?;
        writer.reals(&self.upper_torque_nominal)?;
        writer.reals(&self.lower_force_acceleration)?;
        writer.reals(&self.upper_force_acceleration)?;
        writer.reals(&self.lower_force_nominal)?;
        writer.reals(&self.upper_force_nominal)
    }
}

/// What can be guided by hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GuidingMode {
    /// Directions x, y, z, R, P, Y.
    pub axes: [bool; 6],
    /// The elbow.
    pub nullspace: bool,
}

/// The load at the flange.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Load {
    /// \[kg\]
    pub mass: f64,
    /// Centre of mass in the flange \[m\].
    pub com: [f64; 3],
    /// About the centre of mass, column-major \[kg m2\].
    pub inertia: [f64; 9],
}

/// Cut-off frequencies of the arm's low-pass filters \[Hz\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Filters {
    /// Commanded joint positions.
    pub joint_position: f64,
    /// Commanded joint velocities.
    pub joint_velocity: f64,
    /// Commanded poses.
    pub cartesian_position: f64,
    /// Commanded Cartesian velocities.
    pub cartesian_velocity: f64,
    /// Torques of the controller.
    pub controller: f64,
}

/// What a model library shall run on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LibraryTarget {
    /// Processor.
    pub architecture: Architecture,
    /// Operating system.
    pub system: System,
}

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
