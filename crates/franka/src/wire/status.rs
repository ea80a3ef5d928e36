//! How the arm answers a command. Version 6 inserted the answers about safety functions, which moved the numbers behind them.

use super::cursor::{Reader, Writer};
use super::error::WireError;
use super::protocol::Protocol;

/// An enumeration with its numbers up to version 5 and from version 6 on (`_` where there is none), and its words.
macro_rules! statuses {
    (@code _) => { None };
    (@code $code:literal) => { Some($code) };
    ($($(#[doc = $doc:literal])+ $name:ident $command:literal {
        $($(#[doc = $note:literal])+ $variant:ident $old:tt $new:tt $text:literal,)+
    })+) => {$(
        $(#[doc = $doc])+
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum $name {
            $($(#[doc = $note])+ $variant,)+
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
        /// The session is open.
        Success 0 0 "connected",
        /// The arm speaks another version, which the response names.
        IncompatibleVersion 1 1 "the arm speaks another version of the protocol",
    }

    /// Answers to Move: one when the motion starts, one when it ends.
    MoveStatus "Move" {
        /// The motion ended as commanded.
        Success 0 0 "the motion ended as commanded",
        /// The motion has started.
        MotionStarted 1 1 "the motion has started",
        /// Ended by StopMove or by another motion.
        Preempted 2 2 "the motion was preempted",
        /// Ended by a safety function.
        PreemptedSafetyFunction _ 3 "the motion was preempted by a safety function",
        /// Rejected because of a safety function.
        RejectedSafetyFunction _ 4 "the motion was rejected because a safety function is active",
        /// Rejected: the arm is not idle.
        NotPossible 3 5 "the motion is not possible in the current mode of the arm",
        /// Rejected: singular pose.
        StartAtSingularPose 4 6 "the motion can't start at a singular pose",
        /// Rejected: an argument is out of range.
        InvalidArgument 5 7 "an argument of the motion is invalid",
        /// Ended by a reflex.
        ReflexAborted 6 8 "the motion was aborted by a reflex",
        /// Ended by the user stop.
        EmergencyAborted 7 9 "the motion was aborted by the user stop",
        /// Ended by a bad command.
        InputErrorAborted 8 10 "the motion was aborted by an error in its input",
        /// Ended for another reason.
        Aborted 9 11 "the motion was aborted",
    }

    /// Answer to StopMove.
    StopStatus "StopMove" {
        /// The motion has ended.
        Success 0 0 "stopped",
        /// There is nothing to stop.
        NotPossible 1 1 "stopping is not possible in the current mode of the arm",
        /// Rejected because of a safety function.
        RejectedSafetyFunction _ 2 "stopping was rejected because a safety function is active",
        /// The user stop came first.
        EmergencyAborted 2 3 "stopping was aborted by the user stop",
        /// A reflex came first.
        ReflexAborted 3 4 "stopping was aborted by a reflex",
        /// Ended for another reason.
        Aborted 4 5 "stopping was aborted",
    }

    /// Answer to AutomaticErrorRecovery.
    RecoveryStatus "AutomaticErrorRecovery" {
        /// The arm is ready again.
        Success 0 0 "recovered",
        /// There is nothing to recover from.
        NotPossible 1 1 "recovery is not possible in the current mode of the arm",
        /// Rejected because of a safety function.
        RejectedSafetyFunction _ 2 "recovery was rejected because a safety function is active",
        /// The arm has to be moved by hand.
        ManualRequired 2 3 "the arm has to be recovered by hand",
        /// Ended by a reflex.
        ReflexAborted 3 4 "recovery was aborted by a reflex",
        /// Ended by the user stop.
        EmergencyAborted 4 5 "recovery was aborted by the user stop",
        /// Ended for another reason.
        Aborted 5 6 "recovery was aborted",
    }

    /// Answer to a command that sets something, and to GetCartesianLimit.
    SetterStatus "a setter" {
        /// Done.
        Success 0 0 "set",
        /// Rejected in the arm's mode.
        NotPossible 1 1 "the command is not possible in the current mode of the arm",
        /// Rejected: an argument is out of range.
        InvalidArgument 2 2 "an argument of the command is invalid",
        /// Rejected because of a safety function.
        RejectedSafetyFunction _ 3 "the command was rejected because a safety function is active",
    }

    /// Answer to LoadModelLibrary, until version 9.
    LoadModelStatus "LoadModelLibrary" {
        /// The library follows.
        Success 0 0 "loaded",
        /// There is no library for this system.
        Error 1 1 "the arm reports an error when loading the model library",
    }

    /// Answer to GetRobotModel, from version 8 on.
    RobotModelStatus "GetRobotModel" {
        /// The description follows.
        Success _ 0 "read",
        /// Rejected in the arm's mode.
        NotPossible _ 1 "the robot model can't be read in the current mode of the arm",
        /// Rejected because of a safety function.
        RejectedSafetyFunction _ 2 "reading the robot model was rejected because a safety function is active",
    }
}
