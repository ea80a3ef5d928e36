//! Common Data Representation, little endian: the encoding of ROS 2 messages in recordings (OMG DDSI-RTPS, section 10: `CDR_LE`).
//!
//! Four bytes of encapsulation, then the fields, each aligned to its own size counted from the end of the encapsulation. The decoder
//! checks every length against the remaining bytes before it allocates.

/// `CDR_LE` and no options.
const HEADER: [u8; 4] = [0, 1, 0, 0];

pub struct Encoder {
    bytes: Vec<u8>,
}

impl Default for Encoder {
    fn default() -> Encoder {
        Encoder { bytes: HEADER.to_vec() }
    }
}

impl Encoder {
    fn aligned(&mut self, bytes: &[u8]) -> &mut Encoder {
        while !(self.bytes.len() - HEADER.len()).is_multiple_of(bytes.len()) {
            self.bytes.push(0);
        }
        self.bytes.extend_from_slice(bytes);
        self
    }

    pub fn u8(&mut self, value: u8) -> &mut Encoder {
        self.bytes.push(value);
        self
    }

    pub fn u32(&mut self, value: u32) -> &mut Encoder {
        self.aligned(&value.to_le_bytes())
    }

    pub fn i32(&mut self, value: i32) -> &mut Encoder {
        self.aligned(&value.to_le_bytes())
    }

    pub fn u64(&mut self, value: u64) -> &mut Encoder {
        self.aligned(&value.to_le_bytes())
    }

    /// `float64`, bitwise.
    pub fn f64(&mut self, value: f64) -> &mut Encoder {
        self.aligned(&value.to_le_bytes())
    }

    pub fn string(&mut self, text: &str) -> &mut Encoder {
        // A NUL would end the text early for readers in C.
        let text = text.replace('\0', " ");
        self.u32(text.len() as u32 + 1);
        self.bytes.extend_from_slice(text.as_bytes());
        self.bytes.push(0);
        self
    }

    pub fn strings(&mut self, texts: &[String]) -> &mut Encoder {
        self.u32(texts.len() as u32);
        texts.iter().for_each(|text| {
            self.string(text);
        });
        self
    }

    pub fn f64s(&mut self, values: &[f64]) -> &mut Encoder {
        self.u32(values.len() as u32);
        values.iter().for_each(|&value| {
            self.f64(value);
        });
        self
    }

    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CdrError {
    #[error("{left} bytes where {needed} more were expected")]
    Short { needed: usize, left: usize },
    #[error("the encapsulation {found:02x?}, where [00, 01] (little-endian CDR) was expected")]
    Encapsulation { found: Vec<u8> },
    #[error("a string that is not NUL-terminated UTF-8")]
    Text,
}

pub struct Decoder<'b> {
    body: &'b [u8],
    at: usize,
}

impl<'b> Decoder<'b> {
    pub fn new(bytes: &'b [u8]) -> Result<Decoder<'b>, CdrError> {
        match bytes.split_at_checked(HEADER.len()) {
            Some((head, body)) if head.starts_with(&HEADER[..2]) => Ok(Decoder { body, at: 0 }),
            _ => Err(CdrError::Encapsulation { found: bytes.iter().take(2).copied().collect() }),
        }
    }

    fn take(&mut self, count: usize) -> Result<&'b [u8], CdrError> {
        let left = self.body.get(self.at..).unwrap_or(&[]);
        let taken = left.get(..count).ok_or(CdrError::Short { needed: count, left: left.len() })?;
        self.at += count;
        Ok(taken)
    }

    fn aligned<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        self.at = self.at.next_multiple_of(N);
        let mut out = [0; N];
        out.copy_from_slice(self.take(N)?);
        Ok(out)
    }

    pub fn u8(&mut self) -> Result<u8, CdrError> {
        Ok(self.aligned::<1>()?[0])
    }

    pub fn u32(&mut self) -> Result<u32, CdrError> {
        Ok(u32::from_le_bytes(self.aligned()?))
    }

    pub fn i32(&mut self) -> Result<i32, CdrError> {
        Ok(i32::from_le_bytes(self.aligned()?))
    }

    pub fn u64(&mut self) -> Result<u64, CdrError> {
        Ok(u64::from_le_bytes(self.aligned()?))
    }

    /// `float64`, bitwise.
    pub fn f64(&mut self) -> Result<f64, CdrError> {
        Ok(f64::from_le_bytes(self.aligned()?))
    }

    pub fn string(&mut self) -> Result<String, CdrError> {
        let length = self.u32()? as usize;
        let text = self.take(length)?.strip_suffix(&[0]).ok_or(CdrError::Text)?;
        std::str::from_utf8(text).map(str::to_string).map_err(|_| CdrError::Text)
    }

    pub fn skip_strings(&mut self) -> Result<(), CdrError> {
        // Each string takes four bytes or more, so a wrong count ends at the end of the message.
        (0..self.u32()?).try_for_each(|_| self.string().map(drop))
    }

    /// Reads a `float64[]` into `out` and returns the number of values.
    pub fn f64s(&mut self, out: &mut [f64]) -> Result<usize, CdrError> {
        let count = self.u32()? as usize;
        if count > out.len() {
            return Err(CdrError::Short { needed: count, left: out.len() });
        }
        for slot in out.iter_mut().take(count) {
            *slot = self.f64()?;
        }
        Ok(count)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn encoding_matches_the_standard_and_round_trips() {
        let mut message = Encoder::default();
        message.u8(7).u32(0x0102_0304).string("ab").f64(-0.0).f64s(&[1.5]).strings(&["x".into()]).u64(u64::MAX).i32(-2);
        let bytes = message.finish();
        // Expected bytes from the alignment rules.
        assert_eq!(bytes[..15], [0, 1, 0, 0, 7, 0, 0, 0, 4, 3, 2, 1, 3, 0, 0]);
        assert_eq!(bytes[15..20], [0, b'a', b'b', 0, 0]);
        let mut back = Decoder::new(&bytes).unwrap();
        assert_eq!((back.u8(), back.u32(), back.string()), (Ok(7), Ok(0x0102_0304), Ok("ab".into())));
        assert_eq!(back.f64().unwrap().to_bits(), (-0.0_f64).to_bits());
        let mut values = [0.0; 2];
        assert_eq!((back.f64s(&mut values), values[0]), (Ok(1), 1.5));
        back.skip_strings().unwrap();
        assert_eq!((back.u64(), back.i32()), (Ok(u64::MAX), Ok(-2)));
        assert_eq!(back.u8(), Err(CdrError::Short { needed: 1, left: 0 }));
    }

    #[test]
    fn wrong_lengths_are_refused_before_allocation() {
        let mut message = Encoder::default();
        message.u32(u32::MAX);
        let bytes = message.finish();
        assert!(Decoder::new(&bytes).unwrap().string().is_err());
        assert!(Decoder::new(&bytes).unwrap().skip_strings().is_err());
        assert!(Decoder::new(&bytes).unwrap().f64s(&mut [0.0; 8]).is_err());
        assert!(Decoder::new(&[0, 0, 0, 0]).is_err() && Decoder::new(&[0, 1]).is_err());
    }
}
