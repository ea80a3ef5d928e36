//! Walks a table of fields: bytes to a packet and back.

use super::bits::Errors;
use super::error::WireError;
use super::layout::{Part, Scalar, Slot};
use super::protocol::Protocol;

/// The packet that `bytes` hold; `what` is the name that a [`WireError::Length`] carries.
pub(super) fn decode<T: Default>(
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
pub(super) fn encode<T>(layout: &[Slot<T>], protocol: Protocol, packet: &T, out: &mut [u8]) -> usize {
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
