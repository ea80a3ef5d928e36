//! CANopen services of CiA 301 as values: requests of a master to one node, and the node's messages.
//!
//! The part that an inclinometer needs: expedited SDO transfers (at most 4 bytes), NMT, heartbeat, emergency, one transmit PDO.

use super::frame::Frame;

/// CiA 301: device type.
pub const DEVICE_TYPE: Entry = Entry(0x1000, 0);
/// CiA 301: error register, unsigned8; 0 without an error.
pub const ERROR_REGISTER: Entry = Entry(0x1001, 0);
/// CiA 301: time between two heartbeats of the device \[ms\], unsigned16.
pub const HEARTBEAT_TIME: Entry = Entry(0x1017, 0);
/// CiA 301: identity object: vendor, unsigned32.
pub const VENDOR: Entry = Entry(0x1018, 1);
/// CiA 301: identity object: product code, unsigned32.
pub const PRODUCT: Entry = Entry(0x1018, 2);
/// CiA 301: identity object: serial number, unsigned32.
pub const SERIAL: Entry = Entry(0x1018, 4);
/// CiA 301: identifier of the first transmit PDO; bit 31 disables it, [`NO_REMOTE`] disables remote requests for it.
pub const TPDO_ID: Entry = Entry(0x1800, 1);
/// Bit of [`TPDO_ID`] that disables remote requests.
pub const NO_REMOTE: u32 = 1 << 30;
/// CiA 301: transmission type of the first transmit PDO, unsigned8.
pub const TPDO_TYPE: Entry = Entry(0x1800, 2);
/// CiA 301: event timer of the first transmit PDO \[ms\], unsigned16.
pub const TPDO_TIMER: Entry = Entry(0x1800, 5);
/// CiA 301: number of objects in the first transmit PDO, unsigned8.
pub const MAP_COUNT: Entry = Entry(0x1a00, 0);
/// CiA 301: first object in the first transmit PDO: index, subindex, bits.
pub const MAP_FIRST: Entry = Entry(0x1a00, 1);
/// CiA 301: second object in the first transmit PDO.
pub const MAP_SECOND: Entry = Entry(0x1a00, 2);
/// CiA 410: unit of the slopes in 0.001 deg: 1, 10, 100 or 1000, unsigned16.
pub const RESOLUTION: Entry = Entry(0x6000, 0);

/// Number of the device profile in the low half of [`DEVICE_TYPE`].
pub const PROFILE: u16 = 410;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry(pub u16, pub u8);

impl std::fmt::Display for Entry {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:04X}h:{:02X}h", self.0, self.1)
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Width {
    /// 6010h and 6020h, integer16.
    #[default]
    Bits16,
    /// 6110h and 6120h, integer32.
    Bits32,
}

impl Width {
    /// Longitudinal and lateral slope (CiA 410).
    pub fn slopes(self) -> [Entry; 2] {
        match self {
            Width::Bits16 => [Entry(0x6010, 0), Entry(0x6020, 0)],
            Width::Bits32 => [Entry(0x6110, 0), Entry(0x6120, 0)],
        }
    }

    /// Operating parameters of the slopes: bit 0 inverts the sign, bit 1 adds an offset stored in the device.
    pub fn operating(self) -> [Entry; 2] {
        self.slopes().map(|Entry(index, sub)| Entry(index + 1, sub))
    }

    /// Values of [`MAP_FIRST`] and [`MAP_SECOND`] for a PDO that carries exactly the two slopes.
    pub fn mapping(self) -> [u32; 2] {
        let bits: u32 = if self == Width::Bits16 { 16 } else { 32 };
        self.slopes().map(|Entry(index, sub)| u32::from(index) << 16 | u32::from(sub) << 8 | bits)
    }

    /// The two slopes of a PDO, in units of the resolution; `None` for another length.
    pub fn read(self, data: &[u8]) -> Option<[i32; 2]> {
        match (self, data) {
            (Width::Bits16, &[a, b, c, d]) => {
                Some([i32::from(i16::from_le_bytes([a, b])), i32::from(i16::from_le_bytes([c, d]))])
            }
            (Width::Bits32, &[a, b, c, d, e, f, g, h]) => {
                Some([i32::from_le_bytes([a, b, c, d]), i32::from_le_bytes([e, f, g, h])])
            }
            _ => None,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NmtCommand {
    /// Enter operational: process data and SDO.
    Start = 0x01,
    /// Enter pre-operational: SDO only.
    PreOperational = 0x80,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NmtState {
    /// Neither process data nor SDO.
    Stopped,
    Operational,
    /// SDO only.
    PreOperational,
    /// A state that CiA 301 does not define.
    Other(u8),
}

impl NmtState {
    fn of(code: u8) -> NmtState {
        match code & 0x7f {
            4 => NmtState::Stopped,
            5 => NmtState::Operational,
            127 => NmtState::PreOperational,
            other => NmtState::Other(other),
        }
    }
}

impl std::fmt::Display for NmtState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            NmtState::Stopped => f.write_str("stopped"),
            NmtState::Operational => f.write_str("operational"),
            NmtState::PreOperational => f.write_str("pre-operational"),
            NmtState::Other(code) => write!(f, "in unknown state {code}"),
        }
    }
}

/// A value to write to an object, with its width.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Value {
    U8(u8),
    U16(u16),
    U32(u32),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reply {
    /// Value of an object of up to 4 bytes, little-endian.
    Read {
        entry: Entry,
        value: u32,
    },
    Written {
        entry: Entry,
    },
    Abort {
        entry: Entry,
        /// CiA 301's abort code.
        code: u32,
    },
}

/// Abort code: object does not exist.
pub const ABORT_NO_OBJECT: u32 = 0x0602_0000;
/// Abort code: subindex does not exist.
pub const ABORT_NO_SUBINDEX: u32 = 0x0609_0011;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Message {
    /// Boot-up: the device has lost its configuration.
    BootUp,
    Heartbeat(NmtState),
    /// Emergency; code 0 clears it.
    Emergency {
        /// CiA 301's error code, or the profile's.
        code: u16,
        /// The error register, 1001h.
        register: u8,
    },
    Pdo([u8; 8], usize),
    Reply(Reply),
    /// A frame with one of the node's identifiers and an invalid content.
    Malformed,
}

pub fn nmt(node: u8, command: NmtCommand) -> Frame {
    let mut data = [0; 8];
    data[..2].copy_from_slice(&[command as u8, node]);
    // Two bytes fit, and identifier 0 is one.
    Frame::new(0, &data[..2]).unwrap_or(Frame::full(0, data))
}

pub fn read(node: u8, entry: Entry) -> Frame {
    sdo(node, 0x40, entry, [0; 4])
}

pub fn write(node: u8, entry: Entry, value: Value) -> Frame {
    match value {
        Value::U8(v) => sdo(node, 0x2f, entry, u32::from(v).to_le_bytes()),
        Value::U16(v) => sdo(node, 0x2b, entry, u32::from(v).to_le_bytes()),
        Value::U32(v) => sdo(node, 0x23, entry, v.to_le_bytes()),
    }
}

fn sdo(node: u8, command: u8, Entry(index, sub): Entry, [a, b, c, d]: [u8; 4]) -> Frame {
    let [low, high] = index.to_le_bytes();
    Frame::full(0x600 + u16::from(node), [command, low, high, sub, a, b, c, d])
}

/// Parses a frame of `node`; `None` for frames of other nodes.
pub fn parse(node: u8, frame: &Frame) -> Option<Message> {
    let data = frame.data();
    let base = frame.id().checked_sub(u16::from(node))?;
    let message = match (base, data) {
        (0x700, &[0]) => Message::BootUp,
        (0x700, &[code]) => Message::Heartbeat(NmtState::of(code)),
        (0x080, &[low, high, register, ..]) if data.len() == 8 => {
            Message::Emergency { code: u16::from_le_bytes([low, high]), register }
        }
        (0x180, _) => {
            let mut bytes = [0; 8];
            bytes[..data.len()].copy_from_slice(data);
            Message::Pdo(bytes, data.len())
        }
        (0x580, &[command, low, high, sub, a, b, c, d]) => {
            reply(command, Entry(u16::from_le_bytes([low, high]), sub), [a, b, c, d])
                .map_or(Message::Malformed, Message::Reply)
        }
        (0x700 | 0x080 | 0x580, _) => Message::Malformed,
        _ => return None,
    };
    Some(message)
}

fn reply(command: u8, entry: Entry, bytes: [u8; 4]) -> Option<Reply> {
    let value = u32::from_le_bytes(bytes);
    match command {
        0x60 => Some(Reply::Written { entry }),
        0x80 => Some(Reply::Abort { entry, code: value }),
        // Expedited upload (bit 1). With bit 0 set, bits 2 and 3 are the number of unused bytes.
        _ if command & 0xe2 == 0x42 => {
            let unused = if command & 1 == 1 { u32::from(command >> 2 & 3) } else { 0 };
            Some(Reply::Read { entry, value: value & (u32::MAX >> (8 * unused)) })
        }
        // A segmented transfer: no object that is read here is longer than four bytes.
        _ => None,
    }
}
