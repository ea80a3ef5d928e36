//! What lies where in a state and in a command: one list of fields, laid out once per version.
//!
//! The fields follow each other without padding; versions differ in which fields there are and in how wide a real number is. So the
//! offsets are sums, taken when this is compiled, and the tests hold them against the numbers that the C++ headers give.

use super::codes::{ControllerMode, MotionGeneratorMode, RobotMode};
use super::errors::{ERROR_BITS, Errors};
use super::protocol::{Protocol, WireError};
use super::state::{MAX_COMMAND, MAX_STATE, RobotCommand, RobotState};

/// A number on the wire, little-endian.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// Unsigned, 8 bytes.
    U64,
    /// Double precision, 8 bytes.
    F64,
    /// Single precision, 4 bytes.
    F32,
    /// One byte: a flag, or the number of an enumeration.
    U8,
}

impl Scalar {
    /// Width \[bytes\].
    pub const fn bytes(self) -> usize {
        match self {
            Scalar::U64 | Scalar::F64 => 8,
            Scalar::F32 => 4,
            Scalar::U8 => 1,
        }
    }
}

/// A field of a packet `T`, in its place.
#[derive(Clone, Copy, Debug)]
pub struct Slot<T> {
    /// The name in libfranka's headers.
    pub name: &'static str,
    /// First byte in the packet.
    pub offset: usize,
    /// How many numbers.
    pub count: usize,
    /// What each of them is.
    pub scalar: Scalar,
    /// Where they lie in `T`.
    pub(super) part: Part<T>,
}

impl<T> Slot<T> {
    /// Length of the field \[bytes\].
    pub const fn bytes(&self) -> usize {
        self.count * self.scalar.bytes()
    }

    /// The byte behind its last one.
    pub const fn end(&self) -> usize {
        self.offset + self.bytes()
    }
}

/// Route to a field of `T`.
#[derive(Clone, Copy, Debug)]
pub(super) enum Part<T> {
    /// A counter.
    Id { get: fn(&T) -> u64, set: fn(&mut T, u64) },
    /// Real numbers.
    Reals { get: fn(&T) -> &[f64], get_mut: fn(&mut T) -> &mut [f64] },
    /// A set of errors.
    Bits { get: fn(&T) -> Errors, set: fn(&mut T, Errors) },
    /// A flag.
    Flag { get: fn(&T) -> bool, set: fn(&mut T, bool) },
    /// A number of an enumeration, checked when it is set.
    Code { get: fn(&T, Protocol) -> u8, set: fn(&mut T, Protocol, u8) -> Result<(), WireError> },
}

#[derive(Clone, Copy)]
struct Field<T> {
    name: &'static str,
    count: usize,
    /// The first version that has it.
    since: u16,
    part: Part<T>,
}

impl<T: Copy> Field<T> {
    const fn new(name: &'static str, count: usize, part: Part<T>) -> Field<T> {
        Field { name, count, since: 0, part }
    }

    const fn since(version: u16, field: Field<T>) -> Field<T> {
        Field { since: version, ..field }
    }

    const fn place(&self, offset: usize, real: Scalar) -> Slot<T> {
        let scalar = match self.part {
            Part::Id { .. } => Scalar::U64,
            Part::Reals { .. } => real,
            Part::Bits { .. } | Part::Flag { .. } | Part::Code { .. } => Scalar::U8,
        };
        Slot { name: self.name, offset, count: self.count, scalar, part: self.part }
    }
}

/// A field of `count` real numbers, whose member is an array.
macro_rules! reals {
    ($name:literal, $count:literal, $member:ident) => {
        Field::new($name, $count, Part::Reals { get: |t| &t.$member, get_mut: |t| &mut t.$member })
    };
}

/// A field that is one real number.
macro_rules! real {
    ($name:literal, $member:ident) => {
        Field::new(
            $name,
            1,
            Part::Reals {
                get: |t| std::slice::from_ref(&t.$member),
                get_mut: |t| std::slice::from_mut(&mut t.$member),
            },
        )
    };
}

/// A field of 18 real numbers, one vector per link.
macro_rules! links {
    ($name:literal, $member:ident) => {
        Field::new(
            $name,
            18,
            Part::Reals { get: |t| t.$member.as_flattened(), get_mut: |t| t.$member.as_flattened_mut() },
        )
    };
}

/// A field that is one member, of `Part::$kind`.
macro_rules! plain {
    ($kind:ident, $name:literal, $count:expr, $member:ident) => {
        Field::new($name, $count, Part::$kind { get: |t| t.$member, set: |t, value| t.$member = value })
    };
}

const STATE: &[Field<RobotState>] = &[
    plain!(Id, "message_id", 1, message_id),
    reals!("O_T_EE", 16, o_t_ee),
    reals!("O_T_EE_d", 16, o_t_ee_d),
    reals!("F_T_EE", 16, f_t_ee),
    reals!("EE_T_K", 16, ee_t_k),
    reals!("F_T_NE", 16, f_t_ne),
    reals!("NE_T_EE", 16, ne_t_ee),
    real!("m_ee", m_ee),
    reals!("I_ee", 9, i_ee),
    reals!("F_x_Cee", 3, f_x_cee),
    real!("m_load", m_load),
    reals!("I_load", 9, i_load),
    reals!("F_x_Cload", 3, f_x_cload),
    reals!("elbow", 2, elbow),
    reals!("elbow_d", 2, elbow_d),
    reals!("tau_J", 7, tau_j),
    reals!("tau_J_d", 7, tau_j_d),
    reals!("dtau_J", 7, dtau_j),
    reals!("q", 7, q),
    reals!("q_d", 7, q_d),
    reals!("dq", 7, dq),
    reals!("dq_d", 7, dq_d),
    reals!("ddq_d", 7, ddq_d),
    reals!("joint_contact", 7, joint_contact),
    reals!("cartesian_contact", 6, cartesian_contact),
    reals!("joint_collision", 7, joint_collision),
    reals!("cartesian_collision", 6, cartesian_collision),
    reals!("tau_ext_hat_filtered", 7, tau_ext_hat_filtered),
    reals!("O_F_ext_hat_K", 6, o_f_ext_hat_k),
    reals!("K_F_ext_hat_K", 6, k_f_ext_hat_k),
    reals!("O_dP_EE_d", 6, o_dp_ee_d),
    reals!("O_ddP_O", 3, o_ddp_o),
    reals!("elbow_c", 2, elbow_c),
    reals!("delbow_c", 2, delbow_c),
    reals!("ddelbow_c", 2, ddelbow_c),
    reals!("O_T_EE_c", 16, o_t_ee_c),
    reals!("O_dP_EE_c", 6, o_dp_ee_c),
    reals!("O_ddP_EE_c", 6, o_ddp_ee_c),
    reals!("theta", 7, theta),
    reals!("dtheta", 7, dtheta),
    Field::since(10, links!("accelerometer_top", accelerometer_top)),
    Field::since(10, links!("accelerometer_bottom", accelerometer_bottom)),
    Field::new(
        "motion_generator_mode",
        1,
        Part::Code {
            get: |t, protocol| t.motion_generator_mode.shown_at(protocol).code(),
            set: |t, protocol, code| {
                t.motion_generator_mode = MotionGeneratorMode::decode(protocol, code)?;
                Ok(())
            },
        },
    ),
    Field::new(
        "controller_mode",
        1,
        Part::Code {
            get: |t, _| t.controller_mode.code(),
            set: |t, _, code| {
                t.controller_mode = ControllerMode::decode(code)?;
                Ok(())
            },
        },
    ),
    plain!(Bits, "errors", ERROR_BITS, errors),
    plain!(Bits, "reflex_reason", ERROR_BITS, reflex_reason),
    Field::new(
        "robot_mode",
        1,
        Part::Code {
            get: |t, _| t.robot_mode.code(),
            set: |t, _, code| {
                t.robot_mode = RobotMode::decode(code)?;
                Ok(())
            },
        },
    ),
    real!("control_command_success_rate", control_command_success_rate),
];

const COMMAND: &[Field<RobotCommand>] = &[
    plain!(Id, "message_id", 1, message_id),
    reals!("q_c", 7, q_c),
    reals!("dq_c", 7, dq_c),
    reals!("O_T_EE_c", 16, o_t_ee_c),
    reals!("O_dP_EE_c", 6, o_dp_ee_c),
    reals!("elbow_c", 2, elbow_c),
    plain!(Flag, "valid_elbow", 1, valid_elbow),
    plain!(Flag, "motion_generation_finished", 1, motion_generation_finished),
    reals!("tau_J_d", 7, tau_j_d),
    Field::since(7, plain!(Flag, "torque_command_finished", 1, torque_command_finished)),
];

/// Number of fields that `protocol` has. Evaluated by the compiler alone, like the next ones.
#[allow(clippy::indexing_slicing)]
const fn fields<T: Copy>(list: &[Field<T>], protocol: Protocol) -> usize {
    let (mut count, mut index) = (0, 0);
    while index < list.len() {
        if list[index].since <= protocol.number() {
            count += 1;
        }
        index += 1;
    }
    count
}

#[allow(clippy::indexing_slicing)]
const fn place<T: Copy, const N: usize>(list: &[Field<T>], protocol: Protocol, real: Scalar) -> [Slot<T>; N] {
    let mut slots = [list[0].place(0, real); N];
    let (mut placed, mut index, mut offset) = (0, 0, 0);
    while index < list.len() {
        if list[index].since <= protocol.number() {
            slots[placed] = list[index].place(offset, real);
            offset = slots[placed].end();
            placed += 1;
        }
        index += 1;
    }
    slots
}

#[allow(clippy::indexing_slicing)]
const fn length<T>(slots: &[Slot<T>]) -> usize {
    slots[slots.len() - 1].end()
}

/// Defines the table of a packet at a version, and has the compiler hold it against the packet's length.
macro_rules! table {
    ($table:ident: $packet:ident of $list:ident at $version:ident in $real:ident, $bytes:ident up to $most:ident) => {
        static $table: [Slot<$packet>; fields($list, Protocol::$version)] = const {
            let slots = place($list, Protocol::$version, Scalar::$real);
            assert!(length(&slots) == Protocol::$version.$bytes() && length(&slots) <= $most);
            slots
        };
    };
}

table!(STATE_5: RobotState of STATE at V5 in F64, state_bytes up to MAX_STATE);
table!(STATE_9: RobotState of STATE at V9 in F64, state_bytes up to MAX_STATE);
table!(STATE_10: RobotState of STATE at V10 in F32, state_bytes up to MAX_STATE);
table!(COMMAND_5: RobotCommand of COMMAND at V5 in F64, command_bytes up to MAX_COMMAND);
table!(COMMAND_9: RobotCommand of COMMAND at V9 in F64, command_bytes up to MAX_COMMAND);
table!(COMMAND_10: RobotCommand of COMMAND at V10 in F64, command_bytes up to MAX_COMMAND);

pub(super) fn state(protocol: Protocol) -> &'static [Slot<RobotState>] {
    match protocol {
        Protocol::V5 => &STATE_5,
        Protocol::V9 => &STATE_9,
        Protocol::V10 => &STATE_10,
    }
}

pub(super) fn command(protocol: Protocol) -> &'static [Slot<RobotCommand>] {
    match protocol {
        Protocol::V5 => &COMMAND_5,
        Protocol::V9 => &COMMAND_9,
        Protocol::V10 => &COMMAND_10,
    }
}

impl RobotState {
    /// The state that a datagram holds.
    ///
    /// # Errors
    ///
    /// [`WireError::Length`], [`WireError::Value`] for an unknown mode, [`WireError::Flag`] for an error that is neither 0 nor 1.
    pub fn decode(protocol: Protocol, bytes: &[u8]) -> Result<RobotState, WireError> {
        decode("a robot state", state(protocol), protocol, bytes)
    }

    /// Writes the datagram to the front of `out` and returns its length, [`Protocol::state_bytes`].
    ///
    /// Version 10 rounds to single precision; before it the accelerometers are left out.
    pub fn encode(&self, protocol: Protocol, out: &mut [u8; MAX_STATE]) -> usize {
        encode(state(protocol), protocol, self, out)
    }
}

impl RobotCommand {
    /// The command that a datagram holds.
    ///
    /// # Errors
    ///
    /// [`WireError::Length`], and [`WireError::Flag`] for a flag that is neither 0 nor 1.
    pub fn decode(protocol: Protocol, bytes: &[u8]) -> Result<RobotCommand, WireError> {
        decode("a robot command", command(protocol), protocol, bytes)
    }

    /// Writes the datagram to the front of `out` and returns its length, [`Protocol::command_bytes`].
    pub fn encode(&self, protocol: Protocol, out: &mut [u8; MAX_COMMAND]) -> usize {
        encode(command(protocol), protocol, self, out)
    }
}

impl Protocol {
    /// The fields of a state in the order of their offsets, without gaps.
    pub fn state_layout(self) -> &'static [Slot<RobotState>] {
        state(self)
    }

    /// The fields of a command in the order of their offsets, without gaps.
    pub fn command_layout(self) -> &'static [Slot<RobotCommand>] {
        command(self)
    }
}

/// The packet that `bytes` hold; `what` is the name that a [`WireError::Length`] carries.
fn decode<T: Default>(
    what: &'static str,
    layout: &[Slot<T>],
    protocol: Protocol,
    bytes: &[u8],
) -> Result<T, WireError> {
    let length = WireError::Length { what, expected: layout.last().map_or(0, Slot::end), found: bytes.len() };
    let mut packet = T::default();
    let mut rest = bytes;
    for slot in layout {
        let (field, after) = rest.split_at_checked(slot.bytes()).ok_or(length)?;
        read(slot, protocol, field, &mut packet)?;
        rest = after;
    }
    if rest.is_empty() { Ok(packet) } else { Err(length) }
}

/// Writes `packet` to the front of `out`, which the layout's table was checked to fit into, and returns its length.
fn encode<T>(layout: &[Slot<T>], protocol: Protocol, packet: &T, out: &mut [u8]) -> usize {
    let mut rest = out;
    let mut written = 0;
    for slot in layout {
        let Some((field, after)) = rest.split_at_mut_checked(slot.bytes()) else { break };
        write(slot, protocol, packet, field);
        written = slot.end();
        rest = after;
    }
    written
}

fn read<T>(slot: &Slot<T>, protocol: Protocol, field: &[u8], packet: &mut T) -> Result<(), WireError> {
    let byte = field.first().copied().unwrap_or(0);
    match slot.part {
        Part::Id { set, .. } => set(packet, field.first_chunk().map_or(0, |chunk| u64::from_le_bytes(*chunk))),
        Part::Reals { get_mut, .. } => {
            let numbers = get_mut(packet).iter_mut();
            if slot.scalar == Scalar::F32 {
                let (chunks, _) = field.as_chunks();
                numbers.zip(chunks).for_each(|(number, chunk)| *number = f64::from(f32::from_le_bytes(*chunk)));
            } else {
                let (chunks, _) = field.as_chunks();
                numbers.zip(chunks).for_each(|(number, chunk)| *number = f64::from_le_bytes(*chunk));
            }
        }
        Part::Bits { set, .. } => set(packet, Errors::from_flags(slot.name, field)?),
        Part::Flag { set, .. } => match byte {
            0 | 1 => set(packet, byte == 1),
            found => return Err(WireError::Flag { what: slot.name, index: 0, found }),
        },
        Part::Code { set, .. } => set(packet, protocol, byte)?,
    }
    Ok(())
}

fn write<T>(slot: &Slot<T>, protocol: Protocol, packet: &T, field: &mut [u8]) {
    match slot.part {
        Part::Id { get, .. } => fill(field, &get(packet).to_le_bytes()),
        Part::Reals { get, .. } => {
            let numbers = get(packet).iter();
            if slot.scalar == Scalar::F32 {
                let (chunks, _) = field.as_chunks_mut();
                // Single precision is what the version sends; beyond its range a number becomes infinite.
                chunks.iter_mut().zip(numbers).for_each(|(chunk, number)| *chunk = (*number as f32).to_le_bytes());
            } else {
                let (chunks, _) = field.as_chunks_mut();
                chunks.iter_mut().zip(numbers).for_each(|(chunk, number)| *chunk = number.to_le_bytes());
            }
        }
        Part::Bits { get, .. } => get(packet).to_flags(field),
        Part::Flag { get, .. } => fill(field, &[u8::from(get(packet))]),
        Part::Code { get, .. } => fill(field, &[get(packet, protocol)]),
    }
}

fn fill(field: &mut [u8], bytes: &[u8]) {
    field.iter_mut().zip(bytes).for_each(|(to, from)| *to = *from);
}
