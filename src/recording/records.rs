//! Records of an MCAP file. All lengths are checked against the file's length; every error names the byte and the record.

use super::PROFILE;
use mcap::parse_record;
use mcap::records::{Header, Record as Raw, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use plumbline_core::BadInput;
use std::io::Read;
use std::path::Path;

/// Maximum file size \[bytes\]: half an hour of recording.
const MAX_FILE_BYTES: u64 = 2 << 30;
/// Maximum size of a record or chunk \[bytes\].
const MAX_RECORD_BYTES: usize = 64 << 20;
/// Text of a truncation at the end of the file.
const END_OF_FILE: &str = "the file ends here";

/// Found and expected content.
pub(super) type Mismatch = (String, String);

/// End of a file's records.
pub(super) struct End {
    /// Position and cause of a truncation or damage; `None` for a complete file.
    pub cut: Option<String>,
    /// Records before it.
    pub count: u64,
}

/// The bytes of a file.
///
/// # Errors
/// An unreadable or too large file.
pub(crate) fn bytes_of(path: &Path) -> Result<Vec<u8>, BadInput> {
    let file = path.display().to_string();
    let unreadable = |error: std::io::Error| BadInput::new(&file, "file", error, "a readable recording (MCAP)");
    let mut bytes = Vec::new();
    let opened = std::fs::File::open(path).map_err(unreadable)?;
    opened.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
    if bytes.len() as u64 > MAX_FILE_BYTES {
        let found = format!("more than {MAX_FILE_BYTES} bytes");
        return Err(BadInput::new(&file, "file", found, format!("a recording of at most {MAX_FILE_BYTES} bytes")));
    }
    Ok(bytes)
}

/// Hands records to `each` up to the end or the first unreadable one; `file` is the name in errors.
///
/// # Errors
/// Another kind of file, and what `each` refuses.
pub(super) fn for_each_record(
    file: &str,
    bytes: &[u8],
    each: impl FnMut(Raw<'_>) -> Result<(), Mismatch>,
) -> Result<End, BadInput> {
    let valid = valid_prefix(bytes);
    let mut end = read(file, &bytes[..valid], each)?;
    if valid < bytes.len() && end.cut.as_ref().is_none_or(|words| words.ends_with(END_OF_FILE)) {
        end.cut = Some(format!("byte {valid}, record {}: a record goes beyond the end of its chunk", end.count));
    }
    Ok(end)
}

fn read(file: &str, bytes: &[u8], mut each: impl FnMut(Raw<'_>) -> Result<(), Mismatch>) -> Result<End, BadInput> {
    if !bytes.starts_with(mcap::MAGIC) {
        let shown: String = bytes.iter().take(8).map(|byte| format!("{byte:02x} ")).collect();
        let found = if bytes.is_empty() { "an empty file".to_string() } else { shown.trim_end().to_string() };
        return Err(BadInput::new(file, "byte 0", found, "an MCAP file, which begins with 89 4d 43 41 50 30 0d 0a"));
    }
    // A compressed chunk may be larger than its file.
    let longest = bytes.len().clamp(2 * super::run::CHUNK_BYTES as usize, MAX_RECORD_BYTES);
    let options = LinearReaderOptions::default().with_prevalidate_chunk_crcs(true).with_record_length_limit(longest);
    let mut reader = LinearReader::new_with_options(options);
    let mut left = bytes;
    let mut count = 0;
    // A closure would borrow what the loop changes.
    macro_rules! end_here {
        ($why:expr) => {
            return Ok(End { cut: Some(format!("byte {}, record {count}: {}", bytes.len() - left.len(), $why)), count })
        };
    }
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let count = wanted.min(left.len());
                let (now, later) = left.split_at(count);
                // Allocates no more than the remaining content, whatever the stated length.
                reader.insert(count)[..count].copy_from_slice(now);
                reader.notify_read(count);
                left = later;
            }
            Ok(LinearReadEvent::Record { opcode: op::ATTACHMENT, data }) if !attachment_fits(data) => {
                end_here!(format!("an attachment of {} bytes has no end", data.len()));
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                let record = match parse_record(opcode, data) {
                    Ok(record) => record,
                    Err(error) => end_here!(error),
                };
                each(record).map_err(|(found, expected)| {
                    let place = format!("byte {}, record {count}", bytes.len() - left.len());
                    BadInput::new(file, place, found, expected)
                })?;
                count += 1;
            }
            Err(mcap::McapError::UnexpectedEof) => end_here!(END_OF_FILE),
            Err(error) => end_here!(error),
        }
    }
    Ok(End { cut: None, count })
}

/// Refuses files of programs that do not write messages of ROS 2.
pub(super) fn expect_profile(header: &Header) -> Result<(), Mismatch> {
    if header.profile == PROFILE {
        return Ok(());
    }
    let found = format!("profile `{}`, written by `{}`", header.profile, header.library);
    Err((found, format!("profile `{PROFILE}`: a recording of plumbline")))
}

/// Number of bytes before the first chunk with a record beyond its end. mcap 0.26 does not detect this in chunks without a checksum: its
/// remaining length becomes negative.
pub(super) fn valid_prefix(bytes: &[u8]) -> usize {
    let mut at = mcap::MAGIC.len();
    while let Some((opcode, data)) = bytes.get(at..).and_then(first_record) {
        if opcode == op::CHUNK
            && let Ok(Raw::Chunk { header, data }) = parse_record(opcode, data)
            && header.compression.is_empty()
        {
            let mut left = &data[..];
            while let Some((_, record)) = first_record(left) {
                left = &left[RECORD_HEADER_BYTES + record.len()..];
            }
            if !left.is_empty() {
                return at;
            }
        }
        at += RECORD_HEADER_BYTES + data.len();
    }
    bytes.len()
}

/// Whether an attachment has room for its checksum after times, name, type and length. mcap 0.26 does not check this.
fn attachment_fits(data: &[u8]) -> bool {
    let text = |rest: Option<&[u8]>| {
        let (length, rest) = rest?.split_first_chunk()?;
        rest.get(u32::from_le_bytes(*length) as usize..).map(<[u8]>::len).map(|left| data.len() - left)
    };
    let name = text(data.get(16..));
    let media = name.and_then(|at| text(data.get(at..)));
    media.is_some_and(|at| at + 8 + 4 <= data.len())
}

/// Size of opcode and length of a record \[bytes\].
const RECORD_HEADER_BYTES: usize = 9;

/// Opcode and content of the first record of `bytes`, if it is complete.
fn first_record(bytes: &[u8]) -> Option<(u8, &[u8])> {
    let (&opcode, rest) = bytes.split_first()?;
    let (length, rest) = rest.split_first_chunk()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    Some((opcode, rest.get(..length)?))
}
