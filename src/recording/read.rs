//! Reads recordings. All lengths are checked against the file's length; every error names the byte or the record.

use super::messages::{self, COMMANDS, CYCLES, EVENTS, STATES};
use super::{Recording, about::About, about::FORMAT};
use mcap::parse_record;
use mcap::records::{Record as Raw, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use plumbline_core::{BadInput, MAX_JOINTS, Record, expectation};
use plumbline_rt::TimedEvent;
use std::collections::{BTreeMap, HashMap};
use std::io::Read;
use std::path::Path;

/// Maximum file size \[bytes\]: half an hour of recording.
const MAX_FILE_BYTES: u64 = 2 << 30;
/// Maximum size of a record or chunk \[bytes\].
const MAX_RECORD_BYTES: usize = 64 << 20;
/// Text of a truncation at the end of the file.
const END_OF_FILE: &str = "the file ends here";

impl Recording {
    /// Reads a file. A truncated file is read up to the cut, and `cut` is set.
    /// Errors: an unreadable file, another kind of file, or invalid content; with byte or record, found and expected value.
    pub fn read(path: &Path) -> Result<Recording, BadInput> {
        let file = path.display().to_string();
        let unreadable = |error: std::io::Error| BadInput::new(&file, "file", error, "a readable recording (MCAP)");
        let mut bytes = Vec::new();
        let opened = std::fs::File::open(path).map_err(unreadable)?;
        opened.take(MAX_FILE_BYTES + 1).read_to_end(&mut bytes).map_err(unreadable)?;
        if bytes.len() as u64 > MAX_FILE_BYTES {
            let found = format!("more than {MAX_FILE_BYTES} bytes");
            return Err(BadInput::new(&file, "file", found, format!("a recording of at most {MAX_FILE_BYTES} bytes")));
        }
        Recording::parse(&file, &bytes)
    }

    /// [`Recording::read`] from bytes; `file` is the name in errors.
    pub fn parse(file: &str, bytes: &[u8]) -> Result<Recording, BadInput> {
        let mut parts = PartialRecording::default();
        let valid = valid_prefix(bytes);
        let mut cut = read_records(file, &bytes[..valid], &mut parts)?;
        if valid < bytes.len() && cut.as_ref().is_none_or(|words| words.ends_with(END_OF_FILE)) {
            cut = Some(format!("byte {valid}, record {}: a record goes beyond the end of its chunk", parts.count));
        }
        parts.finish(file, cut)
    }
}

#[derive(Default)]
struct PartialRecording {
    topics: HashMap<u16, String>,
    texts: Vec<(String, String)>,
    /// Cycles by number, with a flag for each of the three messages: state, command, other values.
    cycles: BTreeMap<u64, (Record, [bool; 3])>,
    /// States and commands without the cycle's third message, by the low 32 bits of the cycle's number.
    pending: HashMap<u32, (Record, [bool; 3])>,
    events: Vec<TimedEvent>,
    count: u64,
}

/// Reads records up to the end (`None`) or the first unreadable one (`Some` with its position and cause).
fn read_records(file: &str, bytes: &[u8], parts: &mut PartialRecording) -> Result<Option<String>, BadInput> {
    if !bytes.starts_with(mcap::MAGIC) {
        let shown: String = bytes.iter().take(8).map(|byte| format!("{byte:02x} ")).collect();
        let found = if bytes.is_empty() { "an empty file".to_string() } else { shown.trim_end().to_string() };
        return Err(BadInput::new(file, "byte 0", found, "an MCAP file, which begins with 89 4d 43 41 50 30 0d 0a"));
    }
    let options = LinearReaderOptions::default()
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(bytes.len().min(MAX_RECORD_BYTES));
    let mut reader = LinearReader::new_with_options(options);
    let mut left = bytes;
    // A closure would borrow what the loop changes.
    macro_rules! place {
        () => {
            format!("byte {}, record {}", bytes.len() - left.len(), parts.count)
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
                return Ok(Some(format!("{}: an attachment of {} bytes has no end", place!(), data.len())));
            }
            Ok(LinearReadEvent::Record { opcode, data }) => {
                let record = match parse_record(opcode, data) {
                    Ok(record) => record,
                    Err(error) => return Ok(Some(format!("{}: {error}", place!()))),
                };
                parts.add_record(record).map_err(|(found, expected)| BadInput::new(file, place!(), found, expected))?;
                parts.count += 1;
            }
            Err(mcap::McapError::UnexpectedEof) => {
                return Ok(Some(format!("{}: {END_OF_FILE}", place!())));
            }
            Err(error) => return Ok(Some(format!("{}: {error}", place!()))),
        }
    }
    Ok(None)
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

type Mismatch = (String, String);

impl PartialRecording {
    fn add_record(&mut self, record: Raw<'_>) -> Result<(), Mismatch> {
        match record {
            Raw::Header(header) if header.profile != "ros2" => Err((
                format!("profile `{}`, written by `{}`", header.profile, header.library),
                "profile `ros2`: a recording of plumbline".to_string(),
            )),
            Raw::Attachment { header, data, .. } => {
                let name = header.name;
                let text = String::from_utf8(data.into_owned())
                    .map_err(|error| (format!("attachment `{name}`: {error}"), "text in UTF-8".to_string()))?;
                self.texts.push((name, text));
                Ok(())
            }
            Raw::Channel(channel) => {
                if channel.message_encoding != "cdr" {
                    let found = format!("messages on `{}` in `{}`", channel.topic, channel.message_encoding);
                    return Err((found, "messages in `cdr`".to_string()));
                }
                self.topics.insert(channel.id, channel.topic);
                Ok(())
            }
            Raw::Message { header, data } => self.add_message(header.channel_id, header.sequence, &data),
            _ => Ok(()),
        }
    }

    fn add_message(&mut self, channel: u16, sequence: u32, data: &[u8]) -> Result<(), Mismatch> {
        let Some(topic) = self.topics.get(&channel) else {
            return Err((format!("a message on channel {channel}"), "a channel that was declared before".to_string()));
        };
        let wrong = |error: messages::MessageError| (format!("on `{topic}`: {error}"), "a message as declared".into());
        match topic.as_str() {
            STATES | COMMANDS | CYCLES => {
                let (record, present) = self.pending.entry(sequence).or_default();
                messages::read_cycle(topic, data, record).map_err(wrong)?;
                let which = [STATES, COMMANDS, CYCLES].iter().position(|one| one == topic).unwrap_or_default();
                present[which] = true;
                if which == 2
                    && let Some((record, present)) = self.pending.remove(&sequence)
                {
                    self.cycles.insert(record.cycle, (record, present));
                }
                Ok(())
            }
            EVENTS => {
                self.events.push(messages::read_event(data).map_err(wrong)?);
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn finish(mut self, file: &str, cut: Option<String>) -> Result<Recording, BadInput> {
        let Some(place) = self.texts.iter().position(|(name, _)| name == "about.json") else {
            let found = cut.unwrap_or_else(|| "an MCAP file without it".to_string());
            let expected = "the attachment `about.json`, which a recording of plumbline begins with";
            return Err(BadInput::new(file, format!("record {}", self.count), found, expected));
        };
        let (_, text) = self.texts.remove(place);
        let about: About = {
            let mut json = serde_json::Deserializer::from_str(&text);
            serde_path_to_error::deserialize(&mut json).map_err(|error| {
                let place = format!("attachment `about.json`, key `{}`", error.path());
                let message = error.into_inner().to_string();
                BadInput::new(file, place, &message, expectation(&message))
            })?
        };
        let bad = |key: &str, found: String, expected: String| {
            Err(BadInput::new(file, format!("attachment `about.json`, key `{key}`"), found, expected))
        };
        if about.format != FORMAT {
            return bad("format", about.format.to_string(), format!("{FORMAT}"));
        }
        if !(1..=MAX_JOINTS).contains(&about.joints) {
            return bad("joints", about.joints.to_string(), format!("1 to {MAX_JOINTS}"));
        }
        let unanswered =
            self.cycles.values().rfind(|(_, present)| *present == [true, false, true]).map(|(one, _)| *one);
        let records: Vec<Record> = self
            .cycles
            .into_values()
            .filter(|(_, present)| present.iter().all(|present| *present))
            .map(|(one, _)| one)
            .collect();
        let (events, texts) = (self.events, self.texts);
        Ok(Recording { about, records, unanswered, events, texts, cut })
    }
}
