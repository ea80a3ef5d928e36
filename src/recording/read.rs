//! Reads recordings.

use super::messages::{self, COMMANDS, CYCLES, EVENTS, STATES};
use super::records::{End, Mismatch, bytes_of, expect_profile, for_each_record};
use super::{Recording, about::About, about::FORMAT};
use mcap::records::Record as Raw;
use plumbline_core::{BadInput, MAX_JOINTS, Record, expectation};
use plumbline_rt::TimedEvent;
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

impl Recording {
    /// Reads a file. A truncated file is read up to the cut, and `cut` is set.
    /// Errors: an unreadable file, another kind of file, or invalid content; with byte or record, found and expected value.
    pub fn read(path: &Path) -> Result<Recording, BadInput> {
        let bytes = bytes_of(path)?;
        Recording::parse(&path.display().to_string(), &bytes)
    }

    /// [`Recording::read`] from bytes; `file` is the name in errors.
    pub fn parse(file: &str, bytes: &[u8]) -> Result<Recording, BadInput> {
        let mut parts = PartialRecording::default();
        let end = for_each_record(file, bytes, |record| parts.add_record(record))?;
        parts.finish(file, end)
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
}

impl PartialRecording {
    fn add_record(&mut self, record: Raw<'_>) -> Result<(), Mismatch> {
        match record {
            Raw::Header(header) => expect_profile(&header),
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

    fn finish(mut self, file: &str, End { cut, count }: End) -> Result<Recording, BadInput> {
        let Some(place) = self.texts.iter().position(|(name, _)| name == "about.json") else {
            let found = cut.unwrap_or_else(|| "an MCAP file without it".to_string());
            let expected = "the attachment `about.json` of a recording of plumbline; `plumbline import` reads joint states of others";
            return Err(BadInput::new(file, format!("record {count}"), found, expected));
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
