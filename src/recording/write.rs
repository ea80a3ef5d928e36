//! Writes recordings.

use super::messages::{self, CYCLES, DESCRIPTION, EVENTS, LOG, TRANSFORMS};
use super::scene::{CYCLES_PER_MESSAGE, Scene};
use super::{PROFILE, Recording, about::About};
use mcap::records::{MessageHeader, Metadata};
use mcap::{Attachment, Compression, McapError, WriteOptions, Writer};
use plumbline_rt::{Event, StopReason};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Cursor, Seek, Write};
use std::path::Path;

/// Size of a chunk \[bytes\]: about 50 cycles, the maximum loss of a truncation.
const CHUNK_BYTES: u64 = 48 << 10;

/// Levels of `rcl_interfaces/Log`.
const INFO: u8 = 20;
const WARN: u8 = 30;
const ERROR: u8 = 40;

impl Recording {
    /// Writes the recording atomically to `path` and returns the number of bytes.
    pub fn write(&self, path: &Path) -> io::Result<usize> {
        let bytes = self.to_bytes()?;
        crate::atomic::write_file(path, &bytes)?;
        Ok(bytes.len())
    }

    /// The file's bytes.
    pub fn to_bytes(&self) -> io::Result<Vec<u8>> {
        let mut bytes = Cursor::new(Vec::new());
        let mut writer = writer(&mut bytes, None, CHUNK_BYTES)?;
        // Metadata first: a truncation removes the end.
        self.write_texts(&mut writer)?;
        self.write_messages(&mut writer)?;
        writer.finish().map_err(failed)?;
        drop(writer);
        Ok(bytes.into_inner())
    }

    fn write_texts(&self, writer: &mut Writer<&mut Cursor<Vec<u8>>>) -> io::Result<()> {
        writer
            .write_metadata(&Metadata { name: "plumbline".into(), metadata: summary(&self.about) })
            .map_err(failed)?;
        let about = serde_json::to_string_pretty(&self.about).map_err(io::Error::other)?;
        let start = self.records.first().map_or(0, |first| self.about.clock.at(first.state.seq, first.stamp_ns));
        let texts = self.texts.iter().map(|(name, text)| (name.as_str(), text.as_str()));
        for (name, text) in std::iter::once(("about.json", about.as_str())).chain(texts) {
            let media = if name.ends_with(".json") { "application/json" } else { "application/toml" };
            let data = Cow::Borrowed(text.as_bytes());
            let (name, media_type) = (name.to_string(), media.to_string());
            writer
                .attach(&Attachment { log_time: start, create_time: start, name, media_type, data })
                .map_err(failed)?;
        }
        Ok(())
    }

    fn write_messages(&self, writer: &mut Writer<&mut Cursor<Vec<u8>>>) -> io::Result<()> {
        let mut channels = BTreeMap::new();
        for topic in [messages::STATES, messages::COMMANDS, CYCLES, EVENTS, LOG, DESCRIPTION, TRANSFORMS] {
            channels.insert(topic, add_channel(writer, topic, &BTreeMap::new())?);
        }
        let names: Vec<String> = (1..=self.about.joints).map(|j| format!("{}_joint{j}", self.about.robot)).collect();
        let at = |seq, stamp_ns| self.about.clock.at(seq, stamp_ns);
        let mut put = |topic: &str, sequence: u64, log_time: u64, data: &[u8]| {
            let channel_id = channels.get(topic).copied().unwrap_or_default();
            put_message(writer, channel_id, sequence as u32, log_time, data)
        };
        let scene = Scene::of(self);
        if let (Some(scene), Some(first)) = (&scene, self.records.first()) {
            put(DESCRIPTION, first.cycle, at(first.state.seq, first.stamp_ns), &scene.description())?;
        }
        let mut shown: Option<u64> = None;
        // In order of time; events of a cycle precede its record.
        let mut events = self.events.iter().peekable();
        let mut notes = self.about.notes.iter().peekable();
        for record in &self.records {
            let log_ns = at(record.state.seq, record.stamp_ns);
            while let Some(note) = notes.next_if(|note| note.stamp_ns <= record.stamp_ns) {
                put(LOG, 0, at(note.seq, note.stamp_ns), &messages::log(&note.text, WARN, "daemon", log_ns))?;
            }
            while let Some(timed) = events.next_if(|timed| timed.cycle <= record.cycle) {
                let (log_ns, words) = (at(timed.seq, timed.stamp_ns), messages::event_text(&timed.event));
                put(EVENTS, timed.cycle, log_ns, &messages::event(timed))?;
                put(LOG, timed.cycle, log_ns, &messages::log(&words, level(&timed.event), "loop", log_ns))?;
            }
            for (topic, data) in messages::cycle(record, &names, log_ns) {
                put(topic, record.cycle, log_ns, &data)?;
            }
            // A viewer has no place for a position that is not finite.
            if let Some(scene) = scene.as_ref().filter(|_| record.state.q.iter().all(|q| q.is_finite()))
                && shown.is_none_or(|shown| record.state.seq.saturating_sub(shown) >= CYCLES_PER_MESSAGE)
            {
                shown = Some(record.state.seq);
                put(TRANSFORMS, record.cycle, log_ns, &scene.transforms(&record.state.q, log_ns))?;
            }
        }
        for timed in events {
            let (log_ns, words) = (at(timed.seq, timed.stamp_ns), messages::event_text(&timed.event));
            put(EVENTS, timed.cycle, log_ns, &messages::event(timed))?;
            put(LOG, timed.cycle, log_ns, &messages::log(&words, level(&timed.event), "loop", log_ns))?;
        }
        for note in notes {
            let log_ns = at(note.seq, note.stamp_ns);
            put(LOG, 0, log_ns, &messages::log(&note.text, WARN, "daemon", log_ns))?;
        }
        if let Some(record) = &self.unanswered {
            let log_ns = at(record.state.seq, record.stamp_ns);
            for (topic, data) in messages::cycle(record, &names, log_ns) {
                // The missing command marks the cycle as unanswered.
                if topic != messages::COMMANDS {
                    put(topic, record.cycle, log_ns, &data)?;
                }
            }
        }
        if let Some(end) = &self.about.end {
            let last = self.unanswered.as_ref().or(self.records.last());
            let log_ns = last.map_or(0, |last| at(last.state.seq, last.stamp_ns));
            put(LOG, 0, log_ns, &messages::log(&format!("the loop ended: {end}"), ERROR, "loop", log_ns))?;
        }
        Ok(())
    }
}

/// A writer of messages of ROS 2.
pub(super) fn writer<W: Write + Seek>(
    to: W,
    compression: Option<Compression>,
    chunk_bytes: u64,
) -> io::Result<Writer<W>> {
    let options = WriteOptions::new()
        .compression(compression)
        .profile(PROFILE)
        .library(format!("plumbline {}", env!("CARGO_PKG_VERSION")))
        .chunk_size(Some(chunk_bytes));
    Writer::with_options(to, options).map_err(failed)
}

/// Adds the channel of a topic with the type of its messages; returns its number.
pub(super) fn add_channel<W: Write + Seek>(
    writer: &mut Writer<W>,
    topic: &str,
    metadata: &BTreeMap<String, String>,
) -> io::Result<u16> {
    let (name, definition) = messages::schema(topic);
    let schema = writer.add_schema(name, "ros2msg", definition.as_bytes()).map_err(failed)?;
    writer.add_channel(schema, topic, "cdr", metadata).map_err(failed)
}

/// Writes a message that was recorded at `log_time` \[ns\].
pub(super) fn put_message<W: Write + Seek>(
    writer: &mut Writer<W>,
    channel_id: u16,
    sequence: u32,
    log_time: u64,
    data: &[u8],
) -> io::Result<()> {
    let header = MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
    writer.write_to_known_channel(&header, data).map_err(failed)
}

fn level(event: &Event) -> u8 {
    match event {
        Event::Stopping { reason: StopReason::Requested | StopReason::Quit, .. } => WARN,
        Event::Stopping { .. } | Event::Distrusted { .. } => ERROR,
        Event::Stopped | Event::Resumed => WARN,
        _ => INFO,
    }
}

fn summary(about: &About) -> BTreeMap<String, String> {
    let serving = about.models.last().map_or("none".to_string(), |model| format!("{:016x}", model.id));
    let rows = [
        ("robot", about.robot.clone()),
        ("id", about.id.clone()),
        ("mounting", about.mounting.clone()),
        ("job", about.job.clone()),
        ("job-sha256", about.job_sha256.clone()),
        ("plumbline", about.plumbline.clone()),
        ("model", serving),
        ("reason", about.reason.text.clone()),
        ("end", about.end.clone().unwrap_or_default()),
        ("recorded", about.recorded.clone()),
    ];
    rows.into_iter().map(|(key, value)| (key.to_string(), value)).collect()
}

pub(super) fn failed(error: McapError) -> io::Error {
    match error {
        McapError::Io(error) => error,
        other => io::Error::other(other),
    }
}
