//! Enumerations of states and requests. Those of a request number the same things differently from those of a state.

use super::error::WireError;
use super::protocol::Protocol;

/// An enumeration whose numbers on the wire count from 0 in the order written, and its names.
macro_rules! codes {
    ($($(#[$attribute:meta])+ $name:ident { $($(#[$note:meta])+ $variant:ident $text:literal,)+ })+) => {$(
        $(#[$attribute])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        #[repr(u8)]
        pub enum $name {
            $($(#[$note])+ $variant,)+
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
        /// Joint positions.
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
        /// Joint impedance.
        JointImpedance "joint impedance",
        /// Cartesian impedance.
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
        /// Joint impedance.
        JointImpedance "joint impedance",
        /// Cartesian impedance.
        CartesianImpedance "cartesian impedance",
        /// The torques that the client commands.
        External "external",
    }

    /// The motion generator that a request asks for.
    MoveGenerator {
        /// Joint positions.
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
        /// Linux.
        Linux "Linux",
        /// Windows.
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
    /// The mode of a number in a state.
    pub(super) fn decode(code: u8) -> Result<ControllerMode, WireError> {
        let unknown = WireError::Value { what: "controller_mode", most: 3, found: u32::from(code) };
        ControllerMode::from_code(code).ok_or(unknown)
    }
}

impl RobotMode {
    /// The mode of a number in a state.
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
