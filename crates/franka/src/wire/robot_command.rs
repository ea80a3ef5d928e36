//! The command that answers a state.

use super::error::WireError;
use super::protocol::Protocol;
use super::{layout, packet};

/// Length of the longest command of any version \[bytes\]. Receive into one byte more, or a longer datagram looks like a good one.
pub const MAX_COMMAND: usize = 371;

/// What the client commands for one cycle; what the running motion has no use for is zero. Always in double precision.
///
/// Numbers are decoded as they come, finite or not: to judge them is the arm's business.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotCommand {
    /// [`super::RobotState::message_id`] of the newest state seen.
    pub message_id: u64,
    /// Joint position \[rad\].
    pub q_c: [f64; 7],
    /// Joint velocity \[rad/s\].
    pub dq_c: [f64; 7],
    /// Pose of the end effector in the base, column-major.
    pub o_t_ee_c: [f64; 16],
    /// Twist of the end effector in the base \[m/s, rad/s\].
    pub o_dp_ee_c: [f64; 6],
    /// Position of joint 3 \[rad\], and sign of joint 4.
    pub elbow_c: [f64; 2],
    /// Whether the elbow counts.
    pub valid_elbow: bool,
    /// Asks for the end of the motion; repeated until states show that it has ended.
    pub motion_generation_finished: bool,
    /// Joint torque, without gravity \[Nm\].
    pub tau_j_d: [f64; 7],
    /// Asks for the end of a motion of torques alone; from version 7 on, not on the wire before.
    pub torque_command_finished: bool,
}

impl RobotCommand {
    /// The command that a datagram holds.
    ///
    /// # Errors
    ///
    /// [`WireError::Length`], and [`WireError::Flag`] for a flag that is neither 0 nor 1.
    pub fn decode(protocol: Protocol, bytes: &[u8]) -> Result<RobotCommand, WireError> {
        packet::decode("a robot command", layout::command(protocol), protocol, bytes)
    }

    /// Writes the datagram to the front of `out` and returns its length, [`Protocol::command_bytes`].
    pub fn encode(&self, protocol: Protocol, out: &mut [u8; MAX_COMMAND]) -> usize {
        packet::encode(layout::command(protocol), protocol, self, out)
    }
}
