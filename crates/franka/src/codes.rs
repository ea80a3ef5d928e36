//! Codes of [`plumbline_core::Fault`] that this arm gives; [`super::explain()`] explains them.

/// `Fault::Refused`: a commanded position, velocity or torque was not a number.
pub const REFUSED_NOT_FINITE: u32 = 1;
/// `Fault::Refused`: the commanded position is too far from where the arm was sent last to be reached inside its limits.
pub const REFUSED_JUMP: u32 = 2;
/// `Fault::Refused`: the arm was stopped; a new session is needed to move it again.
pub const REFUSED_STOPPED: u32 = 3;
/// `Fault::Refused`: the commanded position is outside the arm's range.
pub const REFUSED_POSITION: u32 = 4;
/// `Fault::Refused`: a command before the first state.
pub const REFUSED_BEFORE_START: u32 = 5;
/// `Fault::Refused`: the system did not take 20 commands in a row.
pub const REFUSED_UNSENT: u32 = 6;
/// `Fault::Refused`: the arm did not start the motion within a second.
pub const REFUSED_NO_START: u32 = 7;
/// `Fault::Refused`: the desired position is too far from the measured one for the torque interface.
pub const REFUSED_REACH: u32 = 8;
/// `Fault::Refused`: the arm answered Move with the status of this index, added, in [`super::wire::MoveStatus::ALL`].
pub const REFUSED_MOVE: u32 = 0x100;
/// `Fault::Reflex` below this: number of the arm's error, see [`super::wire::ErrorBit`]. From this on: the arm stopped without naming an
/// error, and the number of its mode is added, see [`super::wire::RobotMode`].
pub const REFLEX_MODE: u32 = 0x100;
