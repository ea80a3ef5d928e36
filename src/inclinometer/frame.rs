//! CAN frames and states of the CAN bus.

/// A classic CAN data frame with an 11-bit identifier, the only kind that CANopen's predefined connection set uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    id: u16,
    len: u8,
    data: [u8; 8],
}

impl Frame {
    /// A frame; `None` for an identifier past 7FFh or more than 8 bytes.
    pub fn new(id: u16, payload: &[u8]) -> Option<Frame> {
        let mut data = [0; 8];
        data.get_mut(..payload.len())?.copy_from_slice(payload);
        (id <= 0x7ff).then_some(Frame { id, len: payload.len() as u8, data })
    }

    /// A frame of 8 bytes; the identifier is cut to 11 bits.
    pub const fn full(id: u16, data: [u8; 8]) -> Frame {
        Frame { id: id & 0x7ff, len: 8, data }
    }

    pub fn id(&self) -> u16 {
        self.id
    }

    /// Payload, at most 8 bytes.
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.len).min(8)]
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusState {
    /// Error-active: normal operation.
    Active,
    /// Error-passive: an error counter is above 127.
    Passive,
    /// Bus-off: an error counter is above 255, and the controller is disconnected.
    Off,
    Down,
    /// The transmit queue is full (ENOBUFS), as it is when no node acknowledges.
    Blocked,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusEvent {
    Frame(Frame),
    Bus(BusState),
    /// The receive queue was empty: later frames were sent after this time. Needed to detect a second sender.
    Idle,
}
