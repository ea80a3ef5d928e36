//! Why there is no session with an arm, and what to do about it.

use super::limits::UrdfError;
use super::settings::BadSetting;
use super::wire::{
    CommandKind, Errors, HEADER_BYTES, Protocol, RecoveryStatus, RobotMode, SetterStatus, WireError, images_of,
};
use std::io;
use std::net::IpAddr;
use std::time::Duration;

/// Why there is no session. Each message ends with what to do.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum ConnectError {
    /// A setting can't be used.
    #[error("the settings of the Franka arm: {0}")]
    Setting(#[from] BadSetting),
    #[error("no connection to the arm at {address}: {cause}. {hint}")]
    Unreachable { address: IpAddr, cause: io::Error, hint: String },
    /// A socket could not be made or set.
    #[error("a socket for the arm at {address}, {what}: {cause}")]
    Socket { address: IpAddr, what: &'static str, cause: io::Error },
    /// The arm's protocol version is not one of this program.
    #[error("{}", version_words(*.robot, *.tried))]
    Version { robot: u16, tried: u16 },
    #[error(
        "the arm did not answer {command} within {waited:?}. Is another program connected to it? It serves one at a time."
    )]
    NoAnswer { command: CommandKind, waited: Duration },
    #[error(
        "the arm closed the connection during {command}. In Desk, see that FCI is activated, that this program's user holds \
         control (single point of control), and that no other program is connected"
    )]
    Closed { command: CommandKind },
    #[error(
        "what came instead of an answer to {command} is no message of the control interface: it begins with {}. Another program answers at this \
         address and port, or something on the way changes the data: see that the address is that of the control unit and that nothing forwards or \
         filters its TCP port 1337",
        first_bytes(.bytes)
    )]
    NoMessage { command: CommandKind, bytes: [u8; HEADER_BYTES] },
    /// No state came over UDP though the TCP connection is open.
    #[error(
        "the arm accepted the connection, but none of its states arrived at UDP port {port} whole within {waited:?}. {hint}"
    )]
    NoStates { port: u16, waited: Duration, hint: String },
    /// The arm is in a mode that no motion can start from.
    #[error("the arm is not ready: its mode is `{mode}`{}. {next}", because(.reasons))]
    Mode { mode: RobotMode, reasons: Errors, next: &'static str },
    #[error("the arm refused {command}: {status}")]
    Refused { command: CommandKind, status: SetterStatus },
    #[error("the arm did not serve its description: {what}")]
    NoDescription { what: String },
    #[error(
        "the settings say that the arm compensates gravity along {declared:?} m/s2, but its state says {shown:?} (`O_ddP_O`). The arm goes by its \
         own value: leave `backend.franka.compensates` out, or see in Desk what the arm was told of its mounting"
    )]
    Compensation { declared: [f64; 3], shown: [f64; 3] },
    #[error(
        "the arm's state shows no gravity (`O_ddP_O` is {shown:?} m/s2), so the torque that it adds by itself is not known. Declare it with \
         `backend.franka.compensates`, or command positions"
    )]
    NoCompensation { shown: [f64; 3] },
    /// The description can't be used.
    #[error(transparent)]
    Urdf(#[from] UrdfError),
    #[error("the settings expect a {expected}, but the arm speaks {protocol}, which is {}", .protocol.images())]
    Robot { expected: &'static str, protocol: Protocol },
    #[error("a message of the arm can't be read: {0}")]
    Wire(#[from] WireError),
    #[error("automatic error recovery: {status}. {next}")]
    Recovery { status: RecoveryStatus, next: &'static str },
    #[error(
        "the arm is in a reflex because of {}: after anything but lost communication alone a person has to judge. Look at what \
         happened, clear the workspace, unlock the arm in Desk, then start again.",
        or_unknown(.reasons)
    )]
    NotByItself { reasons: Errors },
    /// Recovery was granted, but the arm did not become idle.
    #[error("the arm says that it has recovered, but after {waited:?} its mode is still `{mode}`")]
    StillNotIdle { mode: RobotMode, waited: Duration },
}

/// Bytes as numbers and as text: `48 69 (`Hi`)`.
pub(super) fn first_bytes(bytes: &[u8]) -> String {
    let hex: Vec<String> = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
    let text: String =
        bytes.iter().map(|&byte| if matches!(byte, b' '..=b'~') { char::from(byte) } else { '.' }).collect();
    format!("{} (`{text}`)", hex.join(" "))
}

fn because(errors: &Errors) -> String {
    if errors.is_empty() { String::new() } else { format!(" because of {errors}") }
}

fn or_unknown(errors: &Errors) -> String {
    if errors.is_empty() { "errors that it no longer names".into() } else { errors.to_string() }
}

fn version_words(robot: u16, tried: u16) -> String {
    let what = match images_of(robot) {
        Some(images) => format!("protocol version {robot}: {images}"),
        None => format!("protocol version {robot}, which is newer than any that this program knows of"),
    };
    let ours: Vec<String> =
        Protocol::ALL.iter().map(|protocol| format!("{} ({})", protocol.number(), protocol.images())).collect();
    let mut words = format!("the arm speaks {what}. This program speaks {}. ", ours.join(", "));
    words += match robot {
        0..5 => "Update the robot's system image to 4.2.1 or later",
        6..=8 => "Update the robot's system image to 5.9.0 or later",
        5 | 9 | 10 => "It refuses its own version, though",
        _ => "A newer version of this program is needed",
    };
    words + &format!(" (offered last: {tried}).")
}

/// What the operator does when the arm is in `mode`; `None` where a motion can start.
pub fn next_step(mode: RobotMode) -> Option<&'static str> {
    Some(match mode {
        RobotMode::Idle => return None,
        RobotMode::Move => "Another motion is running: end the program that drives the arm, then try again.",
        RobotMode::Guiding => "It is being guided by hand: let go of the guiding buttons, then try again.",
        RobotMode::UserStopped => {
            "The user stop is pressed or the enabling device is released: clear the workspace, release the external \
             activation device (the lights turn blue on a Panda, green on an FR3 with FCI active), then try again."
        }
        RobotMode::Reflex => {
            "It was stopped by a reflex: look at what happened, clear the workspace, then allow the recovery \
             (automatic error recovery), or unlock it in Desk."
        }
        RobotMode::ErrorRecovery => "It is recovering from an error: wait until it is idle, then try again.",
        RobotMode::Other => {
            "Its brakes are probably locked, or FCI is not active: open Desk, unlock the joints, activate FCI, then try again."
        }
    })
}
