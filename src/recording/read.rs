//! A recording from bytes. Nothing is trusted: lengths are held against the file's own, every error names the byte or the record.

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

/// Longest file that is read \[bytes\]: half an hour of recording.
const LONGEST: u64 = 2 << 30;
/// Longest single record, or chunk \[bytes\].
const LONGEST_RECORD: usize = 64 << 20;
/// How a cut reads that is the file's end.
const ENDS: &str = "the file ends here";

impl Recording {
    /// Reads a file. One that was cut short is read up to the cut, which `cut` tells.
    ///
    /// # Errors
    /// A file that can't be read, is no recording of this program, or holds something that it never wrote; with byte or record, what
    /// was found, and what was expected.
    pub fn read(path: &Path) -> Result<Recording, BadInput> {
        let file = path.display().to_string();
        let unreadable = |error: std::io::Error| BadInput::new(&file, "file", error, "a readable recording (MCAP)");
        let mut bytes = Vec::new();
        let opened = std::fs::File::open(path).map_err(unreadable)?;
        opened.take(LONGEST + 1).read_to_end(&mut bytes).map_err(unreadable)?;
        if bytes.len() as u64 > LONGEST {
            let found = format!("more than {LONGEST} bytes");
            return Err(BadInput::new(&file, "file", found, format!("a recording of at most {LONGEST} bytes")));
        }
        Recording::parse(&file, &bytes)
    }

    /// The same from bytes; `file` is only named in errors.
    pub fn parse(file: &str, bytes: &[u8]) -> Result<Recording, BadInput> {
        let mut parts = Parts::default();
        let sound = sound(bytes);
        let mut cut = walk(file, &bytes[..sound], &mut parts)?;
        if sound < bytes.len() && cut.as_ref().is_none_or(|words| words.ends_with(ENDS)) {
            cut = Some(format!("byte {sound}, record {}: a record goes beyond the end of its chunk", parts.count));
        }
        parts.finish(file, cut)
    }
}

/// What has been read so far.
#[derive(Default)]
struct Parts {
    topics: HashMap<u16, String>,
    texts: Vec<(String, String)>,
    /// Cycles by number, and which of the three messages were there: state, command, rest.
    cycles: BTreeMap<u64, (Record, [bool; 3])>,
    /// States and commands whose cycle's own message has not come yet, by the low half of its number.
    waiting: HashMap<u32, (Record, [bool; 3])>,
    events: Vec<TimedEvent>,
    /// Records of the file so far.
    count: u64,
}

/// Reads records to the end or to the first that can't be read; the second is told in words.
fn walk(file: &str, bytes: &[u8], parts: &mut Parts) -> Result<Option<String>, BadInput> {
    if !bytes.starts_with(mcap::MAGIC) {
        let shown: String = bytes.iter().take(8).map(|byte| format!("{byte:02x} ")).collect();
        let found = if bytes.is_empty() { "an empty file".to_string() } else { shown.trim_end().to_string() };
        return Err(BadInput::new(file, "byte 0", found, "an MCAP file, which begins with 89 4d 43 41 50 30 0d 0a"));
    }
    let options = LinearReaderOptions::default()
        .with_prevalidate_chunk_crcs(true)
        .with_record_length_limit(bytes.len().min(LONGEST_RECORD));
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
                // No more room than there is content: a length that lies costs nothing.
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
                parts.take(record).map_err(|(found, expected)| BadInput::new(file, place!(), found, expected))?;
                parts.count += 1;
            }
            Err(mcap::McapError::UnexpectedEof) => {
                return Ok(Some(format!("{}: {ENDS}", place!())));
            }
            Err(error) => return Ok(Some(format!("{}: {error}", place!()))),
        }
    }
    Ok(None)
}

/// How many bytes are to be read: up to the first chunk that holds more than it has room for. Without checksums, which a chunk may lack, nobody else
/// notices: mcap 0.26 reckons on with a length below zero.
fn sound(bytes: &[u8]) -> usize {
    let mut at = mcap::MAGIC.len();
    while let Some((opcode, data)) = bytes.get(at..).and_then(first_record) {
        if opcode == op::CHUNK
            && let Ok(Raw::Chunk { header, data }) = parse_record(opcode, data)
            && header.compression.is_empty()
        {
            let mut left = &data[..];
            while let Some((_, record)) = first_record(left) {
                left = &left[PREFIX + record.len()..];
            }
            if !left.is_empty() {
                return at;
            }
        }
        at += PREFIX + data.len();
    }
    bytes.len()
}

/// Whether an attachment's parts leave room for its checksum, of which mcap 0.26 is sure: two times, name, type, length.
fn attachment_fits(data: &[u8]) -> bool {
    let text = |rest: Option<&[u8]>| {
        let (length, rest) = rest?.split_first_chunk()?;
        rest.get(u32::from_le_bytes(*length) as usize..).map(<[u8]>::len).map(|left| data.len() - left)
    };
    let name = text(data.get(16..));
    let media = name.and_then(|at| text(data.get(at..)));
    media.is_some_and(|at| at + 8 + 4 <= data.len())
}

/// Opcode and length of a record.
const PREFIX: usize = 9;

/// Opcode and content of the record that `bytes` begin with, if all of it is there.
fn first_record(bytes: &[u8]) -> Option<(u8, &[u8])> {
    let (&opcode, rest) = bytes.split_first()?;
    let (length, rest) = rest.split_first_chunk()?;
    let length = usize::try_from(u64::from_le_bytes(*length)).ok()?;
    Some((opcode, rest.get(..length)?))
}

/// What was found and what was expected.
type Wrong = (String, String);

impl Parts {
    fn take(&mut self, record: Raw<'_>) -> Result<(), Wrong> {
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
            Raw::Message { header, data } => self.message(header.channel_id, header.sequence, &data),
            _ => Ok(()),
        }
    }

    fn message(&mut self, channel: u16, sequence: u32, data: &[u8]) -> Result<(), Wrong> {
        let Some(topic) = self.topics.get(&channel) else {
            return Err((format!("a message on channel {channel}"), "a channel that was declared before".to_string()));
        };
        let wrong = |error: messages::MessageError| (format!("on `{topic}`: {error}"), "a message as declared".into());
        match topic.as_str() {
            STATES | COMMANDS | CYCLES => {
                let (record, there) = self.waiting.entry(sequence).or_default();
                messages::read_cycle(topic, data, record).map_err(wrong)?;
                let which = [STATES, COMMANDS, CYCLES].iter().position(|one| one == topic).unwrap_or_default();
                there[which] = true;
                if which == 2
                    && let Some((record, there)) = self.waiting.remove(&sequence)
                {
                    self.cycles.insert(record.cycle, (record, there));
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
        let unanswered = self.cycles.values().rfind(|(_, there)| *there == [true, false, true]).map(|(one, _)| *one);
        let records: Vec<Record> = self
            .cycles
            .into_values()
            .filter(|(_, there)| there.iter().all(|there| *there))
            .map(|(one, _)| one)
            .collect();
        let (events, texts) = (self.events, self.texts);
        Ok(Recording { about, records, unanswered, events, texts, cut })
    }
}
