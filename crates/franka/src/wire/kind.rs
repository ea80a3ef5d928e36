//! The commands, and their numbers, which versions 6 and 10 have shifted.

use super::error::WireError;
use super::protocol::Protocol;

/// A command over TCP.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum CommandKind {
    /// Opens a session; the same number and layout in every version.
    Connect,
    /// Starts a motion; answered when it starts and again when it ends.
    Move,
    /// Ends the running motion.
    StopMove,
    /// Reads a virtual wall; version 5 alone.
    GetCartesianLimit,
    /// Sets the thresholds of contact and collision.
    SetCollisionBehavior,
    /// Sets the stiffness of the joint impedance controller.
    SetJointImpedance,
    /// Sets the stiffness of the Cartesian impedance controller.
    SetCartesianImpedance,
    /// Sets which directions can be guided by hand.
    SetGuidingMode,
    /// Sets the stiffness frame in the end effector.
    SetEeToK,
    /// Sets the end effector in the nominal one.
    SetNeToEe,
    /// Sets the load.
    SetLoad,
    /// Sets cut-off frequencies of the arm's filters; version 5 alone.
    SetFilters,
    /// Recovers from a reflex.
    AutomaticErrorRecovery,
    /// Loads the arm's model as a shared library; until version 9.
    LoadModelLibrary,
    /// Reads the arm's model as URDF; from version 8 on.
    GetRobotModel,
}

impl CommandKind {
    /// All commands, in the order of version 5.
    pub const ALL: [CommandKind; 15] = [
        CommandKind::Connect,
        CommandKind::Move,
        CommandKind::StopMove,
        CommandKind::GetCartesianLimit,
        CommandKind::SetCollisionBehavior,
        CommandKind::SetJointImpedance,
        CommandKind::SetCartesianImpedance,
        CommandKind::SetGuidingMode,
        CommandKind::SetEeToK,
        CommandKind::SetNeToEe,
        CommandKind::SetLoad,
        CommandKind::SetFilters,
        CommandKind::AutomaticErrorRecovery,
        CommandKind::LoadModelLibrary,
        CommandKind::GetRobotModel,
    ];

    /// Number of [`CommandKind::Connect`], which is read before the version is known.
    pub const CONNECT: u32 = 0;

    /// The number in a header; `None` when `protocol` does not have the command.
    pub const fn number(self, protocol: Protocol) -> Option<u32> {
        // Versions 3 to 5, 6 to 9, and 10.
        let (a, b, c) = match self {
            CommandKind::Connect => {
                (Some(CommandKind::CONNECT), Some(CommandKind::CONNECT), Some(CommandKind::CONNECT))
            }
            CommandKind::Move => (Some(1), Some(1), Some(1)),
            CommandKind::StopMove => (Some(2), Some(2), Some(2)),
            CommandKind::GetCartesianLimit => (Some(3), None, None),
            CommandKind::SetCollisionBehavior => (Some(4), Some(3), Some(3)),
            CommandKind::SetJointImpedance => (Some(5), Some(4), Some(4)),
            CommandKind::SetCartesianImpedance => (Some(6), Some(5), Some(5)),
            CommandKind::SetGuidingMode => (Some(7), Some(6), Some(6)),
            CommandKind::SetEeToK => (Some(8), Some(7), Some(7)),
            CommandKind::SetNeToEe => (Some(9), Some(8), Some(8)),
            CommandKind::SetLoad => (Some(10), Some(9), Some(9)),
            CommandKind::SetFilters => (Some(11), None, None),
            CommandKind::AutomaticErrorRecovery => (Some(12), Some(10), Some(10)),
            CommandKind::LoadModelLibrary => (Some(13), Some(11), None),
            CommandKind::GetRobotModel => (None, Some(12), Some(11)),
        };
        match protocol {
            Protocol::V5 => a,
            Protocol::V9 => b,
            Protocol::V10 => c,
        }
    }

    /// The command of a number in a header.
    ///
    /// # Errors
    ///
    /// [`WireError::Command`] when `protocol` has no such number.
    pub fn from_number(protocol: Protocol, number: u32) -> Result<CommandKind, WireError> {
        let found = CommandKind::ALL.into_iter().find(|kind| kind.number(protocol) == Some(number));
        found.ok_or(WireError::Command { found: number, version: protocol.number() })
    }

    /// The number, or the error of a command that `protocol` does not have.
    pub(super) fn number_or_absent(self, protocol: Protocol) -> Result<u32, WireError> {
        self.number(protocol).ok_or(WireError::Absent { what: self.name(), version: protocol.number() })
    }

    /// Length of the request without its header \[bytes\].
    pub const fn request_bytes(self, protocol: Protocol) -> usize {
        match self {
            CommandKind::Connect | CommandKind::GetCartesianLimit => 4,
            CommandKind::Move => protocol.move_bytes() - super::HEADER_BYTES,
            CommandKind::StopMove | CommandKind::AutomaticErrorRecovery | CommandKind::GetRobotModel => 0,
            CommandKind::SetCollisionBehavior => 416,
            CommandKind::SetJointImpedance => 56,
            CommandKind::SetCartesianImpedance => 48,
            CommandKind::SetGuidingMode => 7,
            CommandKind::SetEeToK | CommandKind::SetNeToEe => 128,
            CommandKind::SetLoad => 104,
            CommandKind::SetFilters => 40,
            CommandKind::LoadModelLibrary => 2,
        }
    }

    /// Whether the arm answers with a [`super::SetterStatus`] and nothing else.
    pub const fn is_setter(self) -> bool {
        matches!(
            self,
            CommandKind::SetCollisionBehavior
                | CommandKind::SetJointImpedance
                | CommandKind::SetCartesianImpedance
                | CommandKind::SetGuidingMode
                | CommandKind::SetEeToK
                | CommandKind::SetNeToEe
                | CommandKind::SetLoad
                | CommandKind::SetFilters
        )
    }

    /// The name in libfranka's headers.
    pub const fn name(self) -> &'static str {
        match self {
            CommandKind::Connect => "Connect",
            CommandKind::Move => "Move",
            CommandKind::StopMove => "StopMove",
            CommandKind::GetCartesianLimit => "GetCartesianLimit",
            CommandKind::SetCollisionBehavior => "SetCollisionBehavior",
            CommandKind::SetJointImpedance => "SetJointImpedance",
            CommandKind::SetCartesianImpedance => "SetCartesianImpedance",
            CommandKind::SetGuidingMode => "SetGuidingMode",
            CommandKind::SetEeToK => "SetEEToK",
            CommandKind::SetNeToEe => "SetNEToEE",
            CommandKind::SetLoad => "SetLoad",
            CommandKind::SetFilters => "SetFilters",
            CommandKind::AutomaticErrorRecovery => "AutomaticErrorRecovery",
            CommandKind::LoadModelLibrary => "LoadModelLibrary",
            CommandKind::GetRobotModel => "GetRobotModel",
        }
    }
}

impl std::fmt::Display for CommandKind {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(self.name())
    }
}
