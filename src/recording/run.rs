//! A run of a dataset: a `sensor_msgs/JointState` per sample, which viewers plot and other programs read, and beside it the exact time and
//! the further columns.

use super::messages::{self, SAMPLES, STATES, joint_state, read_joint_state};
use super::records::{Mismatch, expect_profile, for_each_record};
use super::write::{add_channel, failed, put_message, writer};
use crate::recording::cdr::{Decoder, Encoder};
use mcap::Compression;
use mcap::records::Record as Raw;
use plumbline_core::{BadInput, MAX_JOINTS};
use std::collections::{BTreeMap, HashMap};
use std::io::{self, Seek, Write};

/// Size of a chunk before compression \[bytes\]: about a second of seven joints.
pub(super) const CHUNK_BYTES: u64 = 512 << 10;
/// Key of the channel's metadata with the names of the further columns, a JSON list.
const COLUMNS: &str = "columns";
/// Most further columns in a file.
const MAX_FURTHER: usize = 1024;

/// The columns of a run, as long as each other; a quantity that was not recorded has none.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunTable<C> {
    /// Time \[s\].
    pub t: C,
    /// `q1..qn` \[rad\].
    pub position: Vec<C>,
    /// `dq1..dqn` \[rad/s\].
    pub velocity: Vec<C>,
    /// `tau1..taun` \[Nm\].
    pub effort: Vec<C>,
    pub further: Vec<(String, C)>,
}

impl<C> RunTable<C> {
    /// The columns with their names in a dataset: time, positions, velocities, torques, then the further ones.
    pub fn named(self) -> (Vec<String>, Vec<C>) {
        let (mut names, mut columns) = (vec!["t".to_string()], vec![self.t]);
        for (stem, block) in [("q", self.position), ("dq", self.velocity), ("tau", self.effort)] {
            names.extend((1..=block.len()).map(|joint| format!("{stem}{joint}")));
            columns.extend(block);
        }
        let (further, values): (Vec<String>, Vec<C>) = self.further.into_iter().unzip();
        names.extend(further);
        columns.extend(values);
        (names, columns)
    }
}

impl RunTable<&[f64]> {
    /// Writes the run as an MCAP file, compressed with zstd.
    ///
    /// # Errors
    /// Those of `to`.
    pub fn write(&self, to: impl Write + Seek) -> io::Result<()> {
        let mut writer = writer(to, Some(Compression::Zstd), CHUNK_BYTES)?;
        let further: Vec<&str> = self.further.iter().map(|(name, _)| name.as_str()).collect();
        let columns = serde_json::to_string(&further).map_err(io::Error::other)?;
        let metadata = BTreeMap::from([(COLUMNS.to_string(), columns)]);
        let states = add_channel(&mut writer, STATES, &BTreeMap::new())?;
        let samples = add_channel(&mut writer, SAMPLES, &metadata)?;
        let names: Vec<String> = (1..=self.position.len()).map(|joint| format!("joint{joint}")).collect();
        for (k, &t) in self.t.iter().enumerate() {
            // For viewers; a time before 0 is 0 to them.
            let log_ns = (t * 1e9).round() as u64;
            let row = |block: &[&[f64]]| block.iter().map(|column| column[k]).collect::<Vec<f64>>();
            let [position, velocity, effort] = [&self.position, &self.velocity, &self.effort].map(|block| row(block));
            let state = joint_state(&names, [&position, &velocity, &effort], log_ns);
            put_message(&mut writer, states, k as u32, log_ns, &state)?;
            let values: Vec<f64> = self.further.iter().map(|(_, column)| column[k]).collect();
            let mut sample = Encoder::default();
            sample.f64(t).f64s(&values);
            put_message(&mut writer, samples, k as u32, log_ns, &sample.finish())?;
        }
        writer.finish().map_err(failed)?;
        Ok(())
    }
}

impl RunTable<Vec<f64>> {
    /// Reads the run in the bytes of an MCAP file; `None` where the file has no such messages. `file` is the name in errors.
    ///
    /// # Errors
    /// Another kind of file, a truncated or damaged one, missing samples; with byte and record, found and expected value.
    pub fn parse(file: &str, bytes: &[u8]) -> Result<Option<RunTable<Vec<f64>>>, BadInput> {
        let mut parts = PartialRun::default();
        let end = for_each_record(file, bytes, |record| parts.add_record(record))?;
        if !parts.is_run {
            return Ok(None);
        }
        if let Some(cut) = end.cut {
            return Err(BadInput::new(file, "end of the file", cut, "a complete file"));
        }
        if parts.state.is_some() {
            let (found, expected) = ("no time of it".to_string(), format!("a message on `{SAMPLES}`"));
            return Err(BadInput::new(file, format!("sample {}", parts.table.t.len() + 1), found, expected));
        }
        Ok(Some(parts.table))
    }
}

/// Position, velocity and effort of a joint state, and how many there are of each.
type State = ([[f64; MAX_JOINTS]; 3], [usize; 3]);

#[derive(Default)]
struct PartialRun {
    topics: HashMap<u16, String>,
    /// Whether the channel of the samples has come.
    is_run: bool,
    table: RunTable<Vec<f64>>,
    /// The joint state whose time is still to come.
    state: Option<State>,
    /// Room for the further values of a sample.
    values: Vec<f64>,
}

impl PartialRun {
    fn add_record(&mut self, record: Raw<'_>) -> Result<(), Mismatch> {
        match record {
            Raw::Header(header) => expect_profile(&header),
            Raw::Channel(channel) => {
                if channel.topic == SAMPLES && !self.is_run {
                    let names = further(channel.metadata.get(COLUMNS).map_or("", String::as_str))?;
                    self.values = vec![0.0; names.len()];
                    self.table.further = names.into_iter().map(|name| (name, Vec::new())).collect();
                    self.is_run = true;
                }
                self.topics.insert(channel.id, channel.topic);
                Ok(())
            }
            Raw::Message { header, data } => match self.topics.get(&header.channel_id).map(String::as_str) {
                Some(STATES) if self.is_run => self.add_state(header.sequence, &data),
                Some(SAMPLES) => self.add_sample(header.sequence, &data),
                _ => Ok(()),
            },
            _ => Ok(()),
        }
    }

    /// Refuses a message that is not of the sample that comes next.
    fn expect_next(&self, topic: &str, sequence: u32, state: bool) -> Result<(), Mismatch> {
        let next = self.table.t.len() as u32;
        if sequence == next && self.state.is_some() == state {
            return Ok(());
        }
        let before = if state { format!("after one on `{STATES}`") } else { format!("before one on `{SAMPLES}`") };
        Err((format!("sample {sequence} on `{topic}`"), format!("sample {next} {before}")))
    }

    fn add_state(&mut self, sequence: u32, data: &[u8]) -> Result<(), Mismatch> {
        self.expect_next(STATES, sequence, false)?;
        let mut values = [[0.0; MAX_JOINTS]; 3];
        let [position, velocity, effort] = &mut values;
        let counts = read_joint_state(data, [position, velocity, effort]).map_err(|error| wrong(STATES, error))?;
        self.state = Some((values, counts));
        Ok(())
    }

    fn add_sample(&mut self, sequence: u32, data: &[u8]) -> Result<(), Mismatch> {
        self.expect_next(SAMPLES, sequence, true)?;
        let mut sample = Decoder::new(data).map_err(|error| wrong(SAMPLES, error))?;
        let t = sample.f64().map_err(|error| wrong(SAMPLES, error))?;
        let count = sample.f64s(&mut self.values).map_err(|error| wrong(SAMPLES, error))?;
        let Some((state, counts)) = self.state.take() else { return Ok(()) };
        let table = &mut self.table;
        if table.t.is_empty() {
            let blocks = [&mut table.position, &mut table.velocity, &mut table.effort];
            blocks.into_iter().zip(counts).for_each(|(block, count)| block.resize(count, Vec::new()));
        }
        let found = [counts[0], counts[1], counts[2], count];
        let expected = [table.position.len(), table.velocity.len(), table.effort.len(), table.further.len()];
        if found != expected {
            let words = |[q, dq, tau, further]: [usize; 4]| {
                format!("{q} positions, {dq} velocities, {tau} torques and {further} further values")
            };
            return Err((format!("{} in sample {sequence}", words(found)), words(expected)));
        }
        table.t.push(t);
        for (block, values) in [&mut table.position, &mut table.velocity, &mut table.effort].into_iter().zip(&state) {
            block.iter_mut().zip(values).for_each(|(column, &value)| column.push(value));
        }
        table.further.iter_mut().zip(&self.values).for_each(|((_, column), &value)| column.push(value));
        Ok(())
    }
}

fn wrong(topic: &str, error: impl std::fmt::Display) -> Mismatch {
    (format!("on `{topic}`: {error}"), format!("a message of {}", messages::schema(topic).0))
}

/// The names of the further columns.
fn further(text: &str) -> Result<Vec<String>, Mismatch> {
    let expected = || format!("metadata `{COLUMNS}` of `{SAMPLES}`: a JSON list of at most {MAX_FURTHER} names");
    let names: Vec<String> = serde_json::from_str(text).map_err(|_| (format!("`{text}`"), expected()))?;
    if names.len() > MAX_FURTHER {
        return Err((format!("{} names", names.len()), expected()));
    }
    Ok(names)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Cursor;

    /// Of a message: whether it is a joint state, its number, and the count of its values.
    type Outline = (bool, u32, usize);

    /// A file of such messages.
    fn file(columns: &str, messages: &[Outline]) -> Vec<u8> {
        let mut to = Cursor::new(Vec::new());
        let mut writer = writer(&mut to, None, CHUNK_BYTES).unwrap();
        let states = add_channel(&mut writer, STATES, &BTreeMap::new()).unwrap();
        let metadata = BTreeMap::from([(COLUMNS.to_string(), columns.to_string())]);
        let samples = add_channel(&mut writer, SAMPLES, &metadata).unwrap();
        for &(is_state, sequence, count) in messages {
            let values = vec![0.5; count];
            let mut sample = Encoder::default();
            sample.f64(f64::from(sequence)).f64s(&values);
            let state = joint_state(&[], [&values, &[], &values], 0);
            let (channel, data) = if is_state { (states, state) } else { (samples, sample.finish()) };
            put_message(&mut writer, channel, sequence, 0, &data).unwrap();
        }
        writer.finish().unwrap();
        drop(writer);
        to.into_inner()
    }

    #[test]
    fn samples_that_are_missing_or_of_another_size_are_refused() {
        let read = |columns: &str, messages: &[Outline]| {
            RunTable::parse("run.mcap", &file(columns, messages)).map_err(|bad| bad.to_string())
        };
        let good = [(true, 0, 2), (false, 0, 1), (true, 1, 2), (false, 1, 1)];
        let table = read("[\"x\"]", &good).unwrap().unwrap();
        assert_eq!(table.named().0, ["t", "q1", "q2", "tau1", "tau2", "x"]);
        let cases: [(&str, &[Outline], &str); 8] = [
            ("[\"x\"]", &good[2..], "got sample 1 on `/joint_states`, expected sample 0"),
            (
                "[\"x\"]",
                &[good[0], good[1], good[3]],
                "got sample 1 on `/plumbline/sample`, expected sample 1 after one on",
            ),
            ("[\"x\"]", &[good[0], good[2]], "got sample 1 on `/joint_states`, expected sample 0 before"),
            ("[\"x\"]", &good[..3], "sample 2: got no time of it, expected a message on `/plumbline/sample`"),
            (
                "[\"x\"]",
                &[good[0], good[1], (true, 1, 3), good[3]],
                "got 3 positions, 0 velocities, 3 torques and 1 further",
            ),
            ("[\"x\"]", &[(true, 0, 9)], "on `/joint_states`: 8 bytes where 9 more were expected"),
            ("[]", &good, "on `/plumbline/sample`: "),
            ("x", &good, "got `x`, expected metadata `columns` of `/plumbline/sample`"),
        ];
        for (columns, messages, expected) in cases {
            let message = read(columns, messages).expect_err(expected);
            assert!(message.starts_with("run.mcap: ") && message.contains(expected), "`{message}`, not `{expected}`");
        }
    }
}
