//! CAN frames and what a controller says of its bus.

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

    /// A frame of whole 8 bytes; the identifier loses what 11 bits don't hold.
    pub const fn full(id: u16, data: [u8; 8]) -> Frame {
        Frame { id: id & 0x7ff, len: 8, data }
    }

    /// Its identifier.
    pub fn id(&self) -> u16 {
        self.id
    }

    /// Its payload, at most 8 bytes.
    pub fn data(&self) -> &[u8] {
        &self.data[..usize::from(self.len).min(8)]
    }
}

/// What the CAN controller reports of its bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BusState {
    /// Frames come and go.
    Active,
    /// An error counter has passed 127: the controller takes part, but may not say so any more.
    Passive,
    /// An error counter has passed 255: the controller has left the bus.
    Off,
    /// The interface is down, or gone.
    Down,
    /// Nothing could be sent: the queue is full (ENOBUFS), as it is when nobody acknowledges.
    Blocked,
}

/// What comes from the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Heard {
    /// A frame.
    Frame(Frame),
    /// The controller's state has changed.
    Bus(BusState),
    /// Nothing waited to be heard at that time: what is heard later was also sent later. Without it no second sender is noticed.
    Nothing,
}
