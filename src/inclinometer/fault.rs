//! Faults of the inclinometer: the reasons why there is no reading.

use super::canopen::{Entry, NmtState};
use super::frame::BusState;

/// Reason why there is no reading.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    #[error("the inclinometer is being brought up")]
    Starting,
    #[error("node {node} does not answer a request for {entry}")]
    Unanswered { node: u8, entry: Entry },
    /// The device aborted an SDO transfer.
    #[error("the inclinometer refuses access to {entry} (abort code {code:08X}h)")]
    Refused { entry: Entry, code: u32 },
    #[error("the node's device type is {found:08X}h, expected profile 410 (inclinometer)")]
    NoInclinometer { found: u32 },
    #[error("the inclinometer's serial number is {found}, expected {expected}")]
    WrongSerial { found: u32, expected: u32 },
    #[error("the inclinometer's resolution is {found}, expected 1, 10, 100 or 1000 (in 0.001 deg)")]
    Resolution { found: u32 },
    /// The slope objects can't represent the whole range: larger slopes would be clipped or wrap around.
    #[error(
        "the inclinometer's slopes of 16 bits end at {:.3} deg, the range is {:.1} deg: set `bits = 32`, or a `range` of at most \
         {:.1} deg", max_slope(*.resolution).to_degrees(), .range.to_degrees(), (10.0 * max_slope(*.resolution).to_degrees()).floor() / 10.0
    )]
    RangeTooWide { resolution: u32, range: f64 },
    /// An object reads back with another value than the written one.
    #[error("{entry} holds {found:08X}h, expected {expected:08X}h")]
    ReadbackMismatch { entry: Entry, found: u32, expected: u32 },
    #[error("no heartbeat of the inclinometer for {elapsed_ms} ms")]
    NoHeartbeat { elapsed_ms: u64 },
    #[error("no slopes from the inclinometer for {elapsed_ms} ms")]
    NoSlopes { elapsed_ms: u64 },
    /// The device has sent a boot-up message.
    #[error("the inclinometer has restarted")]
    Restarted,
    #[error("the inclinometer is {state}, expected operational")]
    State { state: NmtState },
    #[error("emergency {code:04X}h of the inclinometer, error register {register:02X}h")]
    Emergency { code: u16, register: u8 },
    /// More heartbeats than one device sends.
    #[error("{count} heartbeats in {passed_ms} ms, expected {expected}: does another node have the same id?")]
    DuplicateNodeId { count: u32, passed_ms: u64, expected: u64 },
    #[error("frame of {length} bytes under the inclinometer's identifier {id:03X}h")]
    Malformed { id: u16, length: usize },
    #[error("{}", bus_text(*.0))]
    Bus(BusState),
    #[error("slopes of {:.2} and {:.2} deg, expected at most {:.0} deg", .slopes[0].to_degrees(), .slopes[1].to_degrees(), .range.to_degrees())]
    OutOfRange { slopes: [f64; 2], range: f64 },
    /// A slope has changed by more than `jump` between two frames.
    #[error("a slope has jumped by {:.2} deg from one frame to the next", .by.to_degrees())]
    Jump { by: f64 },
    #[error("no report from the inclinometer's thread for {elapsed_ms} ms")]
    ListenerTimeout { elapsed_ms: u64 },
}

/// Largest slope in 16 bits with a unit of `resolution` \[0.001 deg\]; in rad.
pub(super) fn max_slope(resolution: u32) -> f64 {
    f64::from(i16::MAX) * unit(resolution)
}

/// Unit of the slopes for a resolution \[0.001 deg\]; in rad.
pub(super) fn unit(resolution: u32) -> f64 {
    f64::from(resolution) * 1e-3_f64.to_radians()
}

fn bus_text(state: BusState) -> &'static str {
    match state {
        BusState::Active => "the CAN controller is error-active",
        BusState::Passive => "the CAN controller is error-passive: check wiring, termination and bit rate",
        BusState::Off => "the CAN controller is bus-off: check wiring, termination and bit rate",
        BusState::Down => "the CAN interface is down or gone",
        BusState::Blocked => "the transmit queue of the CAN interface is full (ENOBUFS): no node acknowledges",
    }
}
