//! Takes the payload of a message apart, and puts it together.

use super::protocol::{CommandKind, HEADER_BYTES, Header, Protocol, WireError};

pub(super) struct Reader<'a> {
    what: &'static str,
    whole: usize,
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    /// `what` is the message that an error names.
    pub fn new(what: &'static str, payload: &'a [u8]) -> Reader<'a> {
        Reader { what, whole: payload.len(), rest: payload }
    }

    fn take<const N: usize>(&mut self) -> Result<&'a [u8; N], WireError> {
        let least = (self.whole - self.rest.len()).saturating_add(N);
        let (bytes, rest) =
            self.rest.split_first_chunk().ok_or(WireError::Short { what: self.what, least, found: self.whole })?;
        self.rest = rest;
        Ok(bytes)
    }

    pub fn u8(&mut self) -> Result<u8, WireError> {
        self.take().map(|[byte]| *byte)
    }

    pub fn u16(&mut self) -> Result<u16, WireError> {
        self.take().map(|bytes| u16::from_le_bytes(*bytes))
    }

    pub fn u32(&mut self) -> Result<u32, WireError> {
        self.take().map(|bytes| u32::from_le_bytes(*bytes))
    }

    pub fn i32(&mut self) -> Result<i32, WireError> {
        self.take().map(|bytes| i32::from_le_bytes(*bytes))
    }

    pub fn real(&mut self) -> Result<f64, WireError> {
        self.take().map(|bytes| f64::from_le_bytes(*bytes))
    }

    pub fn reals<const N: usize>(&mut self) -> Result<[f64; N], WireError> {
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = self.real()?;
        }
        Ok(numbers)
    }

    pub fn flag(&mut self, what: &'static str) -> Result<bool, WireError> {
        let [flag] = self.flags(what)?;
        Ok(flag)
    }

    pub fn flags<const N: usize>(&mut self, what: &'static str) -> Result<[bool; N], WireError> {
        let mut flags = [false; N];
        for (index, flag) in flags.iter_mut().enumerate() {
            *flag = match self.u8()? {
                0 => false,
                1 => true,
                found => return Err(WireError::Flag { what, index, found }),
            };
        }
        Ok(flags)
    }

    /// Everything that has not been read.
    pub fn rest(self) -> &'a [u8] {
        self.rest
    }
}

pub(super) struct Writer<'a> {
    whole: usize,
    rest: &'a mut [u8],
}

impl Writer<'_> {
    pub fn bytes(&mut self, bytes: &[u8]) -> Result<(), WireError> {
        let full = WireError::Buffer { found: self.whole };
        let (front, rest) = std::mem::take(&mut self.rest).split_at_mut_checked(bytes.len()).ok_or(full)?;
        front.copy_from_slice(bytes);
        self.rest = rest;
        Ok(())
    }

    pub fn u8(&mut self, value: u8) -> Result<(), WireError> {
        self.bytes(&[value])
    }

    pub fn u16(&mut self, value: u16) -> Result<(), WireError> {
        self.bytes(&value.to_le_bytes())
    }

    pub fn u32(&mut self, value: u32) -> Result<(), WireError> {
        self.bytes(&value.to_le_bytes())
    }

    pub fn i32(&mut self, value: i32) -> Result<(), WireError> {
        self.bytes(&value.to_le_bytes())
    }

    pub fn reals(&mut self, values: &[f64]) -> Result<(), WireError> {
        values.iter().try_for_each(|value| self.bytes(&value.to_le_bytes()))
    }

    pub fn flags(&mut self, values: &[bool]) -> Result<(), WireError> {
        values.iter().try_for_each(|value| self.u8(u8::from(*value)))
    }
}

/// Writes a whole message to the front of `out`: the payload by `fill`, then the header with its length.
pub(super) fn message(
    protocol: Protocol,
    kind: CommandKind,
    command_id: u32,
    out: &mut [u8],
    fill: impl FnOnce(&mut Writer) -> Result<(), WireError>,
) -> Result<usize, WireError> {
    let whole = out.len();
    let full = WireError::Buffer { found: whole };
    let command = kind.number_or_absent(protocol)?;
    let (head, payload) = out.split_first_chunk_mut::<HEADER_BYTES>().ok_or(full)?;
    let mut writer = Writer { whole, rest: payload };
    fill(&mut writer)?;
    let size = whole - writer.rest.len();
    *head = Header { command, command_id, size: u32::try_from(size).map_err(|_| full)? }.encode();
    Ok(size)
}
