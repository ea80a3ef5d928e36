//! Enumerations of states, requests and answers. Those of a request number the same things differently from those of a state; version 6 inserted
//! the answers about safety functions, which moved the numbers behind them.

use super::bytes::{Reader, Writer};
use super::protocol::{Protocol, WireError};

/// An enumeration whose numbers on the wire count from 0 in the order written, and its names.
macro_rules! codes {
    ($($(#[$attribute:meta])+ $name:ident { $($(#[$note:meta])* $variant:ident $text:literal,)+ })+) => {$(
        $(#[$attribute])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum $name {
            $(#[doc = $text] $(#[$note])* $variant,)+
        }

        impl $name {
            /// All of them in the order of their numbers.
            pub const ALL: &[$name] = &[$($name::$variant,)+];

            /// The number on the wire.
            pub const fn code(self) -> u8 {
                self as u8
            }

            /// The value of a number, whatever the version; `None` when there is none.
            pub fn from_code(code: u8) -> Option<$name> {
                $name::ALL.get(usize::from(code)).copied()
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                out.write_str(match self {
                    $($name::$variant => $text,)+
                })
            }
        }
    )+};
}

codes! {
    /// The motion generator that a state shows.
    #[derive(Default)]
    MotionGeneratorMode {
        /// No motion runs.
        #[default]
        Idle "idle",
        JointPosition "joint position",
        /// Joint velocities; at version 5 also a motion of torques alone.
        JointVelocity "joint velocity",
        /// Poses of the end effector.
        CartesianPose "cartesian pose",
        /// Velocities of the end effector.
        CartesianVelocity "cartesian velocity",
        /// A motion of torques alone; from version 7 on.
        None "none",
    }

    /// The controller that a state shows.
    #[derive(Default)]
    ControllerMode {
        JointImpedance "joint impedance",
        CartesianImpedance "cartesian impedance",
        /// The torques that the client commands.
        External "external",
        /// No motion runs.
        #[default]
        Other "other",
    }

    /// What the arm is doing.
    #[derive(Default)]
    RobotMode {
        /// Anything else, for example locked brakes.
        #[default]
        Other "other",
        /// Ready for a motion.
        Idle "idle",
        /// A motion runs.
        Move "move",
        /// Guided by hand.
        Guiding "guiding",
        /// Stopped by a violation or a collision; stays until recovered, also after the errors have cleared themselves.
        Reflex "reflex",
        /// The user stop is pressed.
        UserStopped "user stopped",
        /// Recovering from a reflex.
        ErrorRecovery "automatic error recovery",
    }

    /// The controller that a request asks for.
    MoveController {
        JointImpedance "joint impedance",
        CartesianImpedance "cartesian impedance",
        /// The torques that the client commands.
        External "external",
    }

    /// The motion generator that a request asks for.
    MoveGenerator {
        JointPosition "joint position",
        /// Joint velocities.
        JointVelocity "joint velocity",
        /// Poses of the end effector.
        CartesianPose "cartesian pose",
        /// Velocities of the end effector.
        CartesianVelocity "cartesian velocity",
        /// None: torques alone; from version 7 on.
        None "none",
    }

    /// Processor that a model library is asked for.
    Architecture {
        /// 64-bit x86.
        X64 "x64",
        /// 32-bit x86.
        X86 "x86",
        /// 32-bit ARM.
        Arm "ARM",
        /// 64-bit ARM.
        Arm64 "ARM64",
    }

    /// System that a model library is asked for.
    System {
        Linux "Linux",
        Windows "Windows",
    }
}

impl MotionGeneratorMode {
    /// The mode as a state of `protocol` shows it: version 5 shows a motion of torques alone as joint velocity.
    pub const fn shown_at(self, protocol: Protocol) -> MotionGeneratorMode {
        match self {
            MotionGeneratorMode::None if !protocol.has_torque_only() => MotionGeneratorMode::JointVelocity,
            other => other,
        }
    }

    /// The mode of a number in a state of `protocol`.
    pub(super) fn decode(protocol: Protocol, code: u8) -> Result<MotionGeneratorMode, WireError> {
        let mode = MotionGeneratorMode::from_code(code);
        mode.filter(|mode| mode.shown_at(protocol) == *mode).ok_or(WireError::Value {
            what: "motion_generator_mode",
            most: if protocol.has_torque_only() { 5 } else { 4 },
            found: u32::from(code),
        })
    }
}

impl ControllerMode {
    pub(super) fn decode(code: u8) -> Result<ControllerMode, WireError> {
        let unknown = WireError::Value { what: "controller_mode", most: 3, found: u32::from(code) };
        ControllerMode::from_code(code).ok_or(unknown)
    }
}

impl RobotMode {
    pub(super) fn decode(code: u8) -> Result<RobotMode, WireError> {
        let unknown = WireError::Value { what: "robot_mode", most: 6, found: u32::from(code) };
        RobotMode::from_code(code).ok_or(unknown)
    }
}

impl MoveController {
    /// The mode that states show once the motion has started.
    pub const fn shown(self) -> ControllerMode {
        match self {
            MoveController::JointImpedance => ControllerMode::JointImpedance,
            MoveController::CartesianImpedance => ControllerMode::CartesianImpedance,
            MoveController::External => ControllerMode::External,
        }
    }
}

impl MoveGenerator {
    /// The motion generator of a motion of torques alone: none, or joint velocity where that does not exist.
    pub const fn torque_only(protocol: Protocol) -> MoveGenerator {
        if protocol.has_torque_only() { MoveGenerator::None } else { MoveGenerator::JointVelocity }
    }

    /// The mode that states show once the motion has started.
    pub const fn shown(self) -> MotionGeneratorMode {
        match self {
            MoveGenerator::JointPosition => MotionGeneratorMode::JointPosition,
            MoveGenerator::JointVelocity => MotionGeneratorMode::JointVelocity,
            MoveGenerator::CartesianPose => MotionGeneratorMode::CartesianPose,
            MoveGenerator::CartesianVelocity => MotionGeneratorMode::CartesianVelocity,
            MoveGenerator::None => MotionGeneratorMode::None,
        }
    }
}

/// An enumeration with its numbers up to version 5 and from version 6 on (`_` where there is none), and its text.
macro_rules! statuses {
    (@code _) => { None };
    (@code $code:literal) => { Some($code) };
    ($($(#[doc = $doc:literal])+ $name:ident $command:literal {
        $($variant:ident $old:tt $new:tt $text:literal,)+
    })+) => {$(
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name {
            $(#[doc = $text] $variant,)+
        }

        impl $name {
            /// All of them.
            pub const ALL: &[$name] = &[$($name::$variant,)+];

            /// The number on the wire; `None` when `protocol` does not have it.
            pub const fn code(self, protocol: Protocol) -> Option<u8> {
                let (old, new) = match self {
                    $($name::$variant => (statuses!(@code $old), statuses!(@code $new)),)+
                };
                match protocol {
                    Protocol::V5 => old,
                    Protocol::V9 | Protocol::V10 => new,
                }
            }

            /// The status of a number; `None` when `protocol` does not have it.
            pub fn from_code(protocol: Protocol, code: u8) -> Option<$name> {
                $name::ALL.iter().copied().find(|status| status.code(protocol) == Some(code))
            }

            pub(super) fn read(protocol: Protocol, reader: &mut Reader) -> Result<$name, WireError> {
                let code = reader.u8()?;
                let most = $name::ALL.iter().filter_map(|status| status.code(protocol)).max().unwrap_or(0);
                $name::from_code(protocol, code).ok_or(WireError::Value {
                    what: concat!("the status of ", $command),
                    most: u32::from(most),
                    found: u32::from(code),
                })
            }

            pub(super) fn write(self, protocol: Protocol, writer: &mut Writer) -> Result<(), WireError> {
                let absent = WireError::Absent {
                    what: concat!("this status of ", $command),
                    version: protocol.number(),
                };
                writer.u8(self.code(protocol).ok_or(absent)?)
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                out.write_str(match self {
                    $($name::$variant => $text,)+
                })
            }
        }
    )+};
}

statuses! {
    /// Answer to Connect, the same in every version.
    ConnectStatus "Connect" {
        Success 0 0 "connected",
        IncompatibleVersion 1 1 "the arm speaks another version of the protocol",
    }

    /// Answers to Move: one when the motion starts, one when it ends.
    MoveStatus "Move" {
        Success 0 0 "the motion ended as commanded",
        MotionStarted 1 1 "the motion has started",
        Preempted 2 2 "the motion was preempted",
        PreemptedSafetyFunction _ 3 "the motion was preempted by a safety function",
        RejectedSafetyFunction _ 4 "the motion was rejected because a safety function is active",
        NotPossible 3 5 "the motion is not possible in the current mode of the arm",
        StartAtSingularPose 4 6 "the motion can't start at a singular pose",
        InvalidArgument 5 7 "an argument of the motion is invalid",
        ReflexAborted 6 8 "the motion was aborted by a reflex",
        EmergencyAborted 7 9 "the motion was aborted by the user stop",
        InputErrorAborted 8 10 "the motion was aborted by an error in its input",
        Aborted 9 11 "the motion was aborted",
    }

    /// Answer to StopMove.
    StopStatus "StopMove" {
        Success 0 0 "stopped",
        NotPossible 1 1 "stopping is not possible in the current mode of the arm",
        RejectedSafetyFunction _ 2 "stopping was rejected because a safety function is active",
        EmergencyAborted 2 3 "stopping was aborted by the user stop",
        ReflexAborted 3 4 "stopping was aborted by a reflex",
        Aborted 4 5 "stopping was aborted",
    }

    /// Answer to AutomaticErrorRecovery.
    RecoveryStatus "AutomaticErrorRecovery" {
        Success 0 0 "recovered",
        NotPossible 1 1 "recovery is not possible in the current mode of the arm",
        RejectedSafetyFunction _ 2 "recovery was rejected because a safety function is active",
        ManualRequired 2 3 "the arm has to be recovered by hand",
        ReflexAborted 3 4 "recovery was aborted by a reflex",
        EmergencyAborted 4 5 "recovery was aborted by the user stop",
        Aborted 5 6 "recovery was aborted",
    }

    /// Answer to a command that sets something, and to GetCartesianLimit.
    SetterStatus "a setter" {
        Success 0 0 "set",
        NotPossible 1 1 "the command is not possible in the current mode of the arm",
        InvalidArgument 2 2 "an argument of the command is invalid",
        RejectedSafetyFunction _ 3 "the command was rejected because a safety function is active",
    }

    /// Answer to LoadModelLibrary, until version 9.
    LoadModelStatus "LoadModelLibrary" {
        Success 0 0 "loaded",
        Error 1 1 "the arm reports an error when loading the model library",
    }

    /// Answer to GetRobotModel, from version 8 on.
    RobotModelStatus "GetRobotModel" {
        Success _ 0 "read",
        NotPossible _ 1 "the robot model can't be read in the current mode of the arm",
        RejectedSafetyFunction _ 2 "reading the robot model was rejected because a safety function is active",
    }
}
