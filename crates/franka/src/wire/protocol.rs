//! The protocol versions that this codec speaks, and what each of them is found on.

use super::layout::Slot;
use super::robot_command::RobotCommand;
use super::state::RobotState;
use super::{header, layout};

/// A version of the protocol ("robot server version"). Client and arm must agree exactly.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Protocol {
    /// Version 5, the last one of Panda and FER.
    V5,
    /// Version 9, FR3 from image 5.7.2 on.
    V9,
    /// Version 10, FR3 from image 5.9.0 on: states in single precision.
    V10,
}

impl Protocol {
    /// All versions spoken, in rising order.
    pub const ALL: [Protocol; 3] = [Protocol::V5, Protocol::V9, Protocol::V10];

    /// The number that [`super::Connect`] carries.
    pub const fn number(self) -> u16 {
        match self {
            Protocol::V5 => 5,
            Protocol::V9 => 9,
            Protocol::V10 => 10,
        }
    }

    /// The version of a number; `None` for those that are not spoken.
    pub fn from_number(number: u16) -> Option<Protocol> {
        Protocol::ALL.into_iter().find(|protocol| protocol.number() == number)
    }

    /// Length of a state datagram \[bytes\].
    pub const fn state_bytes(self) -> usize {
        match self {
            Protocol::V5 | Protocol::V9 => 2373,
            Protocol::V10 => 1377,
        }
    }

    /// Length of a command datagram \[bytes\].
    pub const fn command_bytes(self) -> usize {
        match self {
            Protocol::V5 => 370,
            Protocol::V9 | Protocol::V10 => 371,
        }
    }

    /// Length of a request to move, header included \[bytes\].
    pub const fn move_bytes(self) -> usize {
        header::HEADER_BYTES
            + match self {
                Protocol::V5 | Protocol::V9 => 56,
                Protocol::V10 => 113,
            }
    }

    /// Robots, system images and libfranka versions of this protocol version, in words.
    pub fn images(self) -> &'static str {
        match self {
            Protocol::V5 => IMAGES_5,
            Protocol::V9 => IMAGES_9,
            Protocol::V10 => IMAGES_10,
        }
    }

    /// Whether a motion without motion generator exists (from version 7 on). Before, a motion of torques alone is asked for as a
    /// joint velocity motion with zero velocities, and shown as one.
    pub const fn has_torque_only(self) -> bool {
        !matches!(self, Protocol::V5)
    }

    /// The fields of a state in the order of their offsets, without gaps.
    pub fn state_layout(self) -> &'static [Slot<RobotState>] {
        layout::state(self)
    }

    /// The fields of a command in the order of their offsets, without gaps.
    pub fn command_layout(self) -> &'static [Slot<RobotCommand>] {
        layout::command(self)
    }
}

impl std::fmt::Display for Protocol {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "version {}", self.number())
    }
}

const IMAGES_5: &str = "Panda or FER with system image 4.2.1 or later (libfranka 0.9.0 to 0.9.2)";
const IMAGES_9: &str = "FR3 with system image 5.7.2 or later (libfranka 0.15.0 to 0.17.0)";
const IMAGES_10: &str = "FR3 with system image 5.9.0 or later (libfranka 0.18 and later)";

/// The same as [`Protocol::images`] for versions 3 to 10, spoken or not: for messages about an arm that speaks another one.
///
/// Source: the compatibility table of Franka's documentation (github.com/frankarobotics/docs) and libfranka's changelog.
pub fn images_of(version: u16) -> Option<&'static str> {
    Some(match version {
        3 => "Panda with system image 1.3 to 3 (libfranka 0.5.0 to 0.7.1)",
        4 => "Panda with system image 4.0 to 4.2.0 (libfranka 0.8.0)",
        5 => IMAGES_5,
        6 => "FR3 with system image 5.2.0 or later (libfranka 0.10.0 to 0.13.2)",
        7 => "FR3 with system image 5.5.0 or later (libfranka 0.13.3 to 0.13.6)",
        8 => "FR3 with system image 5.7.0 or later (libfranka 0.14)",
        9 => IMAGES_9,
        10 => IMAGES_10,
        _ => return None,
    })
}
