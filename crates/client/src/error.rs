//! Errors of the library.

use plumbline_core::BadInput;
use plumbline_ipc::{IpcError, RobotId};

/// Error of a call outside the control loop.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Error {
    /// A model file or a name that can't be used.
    #[error(transparent)]
    Input(#[from] BadInput),
    /// No daemon, another layout of its messages, or shared memory that failed.
    #[error(transparent)]
    Ipc(#[from] IpcError),
    /// The daemon that was followed has ended, or has sent nothing for 5 s (it sends every second): the link to another machine is down. The
    /// model stays, and the daemon is followed again when it sends, or the next one.
    #[error("the daemon of robot `{robot}` has ended, or sends nothing; the last model is kept")]
    DaemonGone {
        /// Its robot.
        robot: String,
    },
    /// The daemon serves a model of another robot than expected.
    #[error("the daemon serves a model of robot `{found}`, expected `{expected}`; the last model is kept")]
    OtherRobot {
        /// Robot that the caller expects.
        expected: String,
        /// Robot of the served model.
        found: String,
    },
    /// Gravity that acts is not the expected one, or the model is not valid under it.
    #[error("another mounting: {0}; the last model is kept")]
    OtherMounting(String),
    /// The text is not that of the model that its header names.
    #[error("the served model {model:016x} is damaged: its text has the identity {found:016x}")]
    Damaged {
        /// Identity by the header.
        model: u64,
        /// Identity of the text.
        found: u64,
    },
    /// Another process publishes states of this arm.
    #[error("another process publishes the states of robot `{robot}`: one publisher per arm")]
    SecondPublisher {
        /// The robot.
        robot: String,
    },
    /// A thread of the library could not be started, or has ended.
    #[error("a thread of the library failed: {0}")]
    Thread(String),
}

impl Error {
    /// Whether a message of the daemon is refused: the error stays until another model is served.
    pub(crate) fn refuses_model(&self) -> bool {
        use IpcError::{Incompatible, Malformed};
        match self {
            Error::Input(_) | Error::OtherRobot { .. } | Error::OtherMounting(_) | Error::Damaged { .. } => true,
            Error::Ipc(error) => matches!(error, Incompatible { .. } | Malformed { .. }),
            Error::DaemonGone { .. } | Error::SecondPublisher { .. } | Error::Thread(_) => false,
        }
    }
}

/// Error of a call in the control loop. No torque was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Fault {
    /// No model has arrived yet.
    #[error("no model has been received yet")]
    NoModel,
    /// An array has another length than it needs.
    #[error("an array has {found} entries, expected {expected}")]
    Length {
        /// Length needed.
        expected: usize,
        /// Length given.
        found: usize,
    },
    /// A number of the input is infinite or NaN.
    #[error("a number of the input is not finite")]
    NotFinite,
    /// The model has terms that are computed for one gravity in advance: it can be evaluated under that one only.
    #[error(
        "the model can't be evaluated under another gravity than its own: it has effects that are computed for one in advance"
    )]
    FixedGravity,
    /// The model lacks parameters for this direction of gravity (a VBS with gravity not along axis 1).
    #[error("the model is not valid under this gravity: it was identified with gravity along axis 1")]
    Mounting,
    /// The model file has no `[uncertainty]`, or, for the external torque, none with a spectrum of the residual.
    #[error("the model file has no [uncertainty], or one without residual-spectrum")]
    NoUncertainty,
    /// A setting of the external torque is out of range.
    #[error(
        "a setting of the external torque is out of range: expected a bandwidth below half the rate, false alarms above 0"
    )]
    Setting,
    /// The queue to the sending thread is full: the sample is lost, and counted.
    #[error("the queue of samples is full: the sample is lost")]
    QueueFull,
}

/// `robot` as an identity.
pub(crate) fn robot_id(robot: &str) -> Result<RobotId, Error> {
    Ok(RobotId::parse("the call", "robot", robot)?)
}
