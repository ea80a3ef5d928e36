//! Protocol versions, commands with their numbers in each, the head of every message, and the error of every decoder.

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
    /// All versions of this program, in rising order.
    pub const ALL: [Protocol; 3] = [Protocol::V5, Protocol::V9, Protocol::V10];

    /// The number that [`super::Connect`] carries.
    pub const fn number(self) -> u16 {
        match self {
            Protocol::V5 => 5,
            Protocol::V9 => 9,
            Protocol::V10 => 10,
        }
    }

    /// The version of a number; `None` for those that this program does not have.
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
        HEADER_BYTES
            + match self {
                Protocol::V5 | Protocol::V9 => 56,
                Protocol::V10 => 113,
            }
    }

    /// Robots, system images and libfranka versions of this protocol version.
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
}

impl std::fmt::Display for Protocol {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "version {}", self.number())
    }
}

const IMAGES_5: &str = "Panda or FER with system image 4.2.1 or later (libfranka 0.9.0 to 0.9.2)";
const IMAGES_9: &str = "FR3 with system image 5.7.2 or later (libfranka 0.15.0 to 0.17.0)";
const IMAGES_10: &str = "FR3 with system image 5.9.0 or later (libfranka 0.18 and later)";

/// The same as [`Protocol::images`] for versions 3 to 10: for messages about an arm of another version.
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

/// The commands: meaning, name in libfranka's headers, number in versions 3 to 5, 6 to 9, and 10 (`_` where there is none), length of the request
/// without its header \[bytes\], and whether the arm answers with a [`super::SetterStatus`] and nothing else.
macro_rules! commands {
    (@number _) => { None };
    (@number $number:literal) => { Some($number) };
    ($(#[doc = $doc:literal] $kind:ident $name:literal [$v5:tt $v9:tt $v10:tt] $bytes:literal $setter:literal,)+) => {
        /// A command over TCP.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum CommandKind {
            $(#[doc = $doc] $kind,)+
        }

        impl CommandKind {
            /// All commands, in the order of version 5.
            pub const ALL: [CommandKind; 15] = [$(CommandKind::$kind,)+];

            /// The number in a header; `None` when `protocol` does not have the command.
            pub const fn number(self, protocol: Protocol) -> Option<u32> {
                let (a, b, c) = match self {
                    $(CommandKind::$kind => (commands!(@number $v5), commands!(@number $v9), commands!(@number $v10)),)+
                };
                match protocol {
                    Protocol::V5 => a,
                    Protocol::V9 => b,
                    Protocol::V10 => c,
                }
            }

            /// Length of the request without its header \[bytes\].
            pub const fn request_bytes(self, protocol: Protocol) -> usize {
                match self {
                    // The one request whose length depends on the version.
                    CommandKind::Move => protocol.move_bytes() - HEADER_BYTES,
                    other => other.fixed_bytes(),
                }
            }

            const fn fixed_bytes(self) -> usize {
                match self {
                    $(CommandKind::$kind => $bytes,)+
                }
            }

            /// Whether the arm answers with a [`super::SetterStatus`] and nothing else.
            pub const fn is_setter(self) -> bool {
                match self {
                    $(CommandKind::$kind => $setter,)+
                }
            }

            /// The name in libfranka's headers.
            pub const fn name(self) -> &'static str {
                match self {
                    $(CommandKind::$kind => $name,)+
                }
            }
        }
    };
}

commands! {
    /// Opens a session; the same number and layout in every version.
    Connect "Connect" [0 0 0] 4 false,
    /// Starts a motion; answered when it starts and again when it ends.
    Move "Move" [1 1 1] 0 false,
    /// Ends the running motion.
    StopMove "StopMove" [2 2 2] 0 false,
    /// Reads a virtual wall; version 5 alone.
    GetCartesianLimit "GetCartesianLimit" [3 _ _] 4 false,
    /// Sets the thresholds of contact and collision.
    SetCollisionBehavior "SetCollisionBehavior" [4 3 3] 416 true,
    /// Sets the stiffness of the joint impedance controller.
    SetJointImpedance "SetJointImpedance" [5 4 4] 56 true,
    /// Sets the stiffness of the Cartesian impedance controller.
    SetCartesianImpedance "SetCartesianImpedance" [6 5 5] 48 true,
    /// Sets which directions can be guided by hand.
    SetGuidingMode "SetGuidingMode" [7 6 6] 7 true,
    /// Sets the stiffness frame in the end effector.
    SetEeToK "SetEEToK" [8 7 7] 128 true,
    /// Sets the end effector in the nominal one.
    SetNeToEe "SetNEToEE" [9 8 8] 128 true,
    /// Sets the load.
    SetLoad "SetLoad" [10 9 9] 104 true,
    /// Sets cut-off frequencies of the arm's filters; version 5 alone.
    SetFilters "SetFilters" [11 _ _] 40 true,
    /// Recovers from a reflex.
    AutomaticErrorRecovery "AutomaticErrorRecovery" [12 10 10] 0 false,
    /// Loads the arm's model as a shared library; until version 9.
    LoadModelLibrary "LoadModelLibrary" [13 11 _] 2 false,
    /// Reads the arm's model as URDF; from version 8 on.
    GetRobotModel "GetRobotModel" [_ 12 11] 0 false,
}

impl CommandKind {
    /// Number of [`CommandKind::Connect`], which is read before the version is known.
    pub const CONNECT: u32 = 0;

    /// The command of a number in a header.
    ///
    /// # Errors
    ///
    /// [`WireError::Command`] when `protocol` has no such number.
    pub fn from_number(protocol: Protocol, number: u32) -> Result<CommandKind, WireError> {
        let found = CommandKind::ALL.into_iter().find(|kind| kind.number(protocol) == Some(number));
        found.ok_or(WireError::Command { found: number, version: protocol.number() })
    }

    pub(super) fn number_or_absent(self, protocol: Protocol) -> Result<u32, WireError> {
        self.number(protocol).ok_or(WireError::Absent { what: self.name(), version: protocol.number() })
    }
}

impl std::fmt::Display for CommandKind {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(self.name())
    }
}

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

/// What was expected and what was found. `Copy` and without text of its own, so that it can leave the real-time loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum WireError {
    /// A packet or payload of fixed length has another one.
    #[error("{what} has {found} bytes instead of {expected}")]
    Length { what: &'static str, expected: usize, found: usize },
    /// A message ends before its last field.
    #[error("{what} has {found} bytes, but needs at least {least}")]
    Short { what: &'static str, least: usize, found: usize },
    /// The size field of a header is out of bounds.
    #[error("a header says {found} bytes, expected {least} to {most}")]
    Size { least: u32, most: u32, found: u32 },
    /// An enumeration holds a number that this version does not know.
    #[error("{what} is {found}, expected 0 to {most}")]
    Value { what: &'static str, most: u32, found: u32 },
    /// A byte that is a flag holds neither 0 nor 1.
    #[error("{what}[{index}] is {found}, expected 0 or 1")]
    Flag { what: &'static str, index: usize, found: u8 },
    #[error("command number {found} does not exist in protocol version {version}")]
    Command { found: u32, version: u16 },
    #[error("{what} does not exist in protocol version {version}")]
    Absent { what: &'static str, version: u16 },
    /// A response that does not belong to the command that it names.
    #[error("{kind} does not answer with the status of a setter")]
    NotASetter { kind: CommandKind },
    #[error("the robot description is not UTF-8 from byte {valid} on")]
    NotText { valid: usize },
    #[error("a buffer of {found} bytes is too small for the message")]
    Buffer { found: usize },
}
