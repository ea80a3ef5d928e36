//! `sensor_msgs/msg/JointState` of ROS 2 (CDR) from MCAP files and rosbag2 databases.

use super::{Imported, Wanted};
use crate::recording::cdr::{CdrError, Decoder};
use crate::recording::foreign::{Message, for_each_message};
use nalgebra::DMatrix;
use plumbline_core::BadInput;
use rusqlite::{Connection, OpenFlags};
use std::collections::BTreeMap;
use std::path::Path;

/// The type of the messages, as MCAP and rosbag2 name it.
const TYPE: &str = "sensor_msgs/msg/JointState";
/// Largest number of joints in a message.
const MAX_NAMES: usize = 256;
/// Joints of Universal Robots' driver, base first; it publishes them in the order of the alphabet.
const UR_ORDER: [&str; 6] = ["shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3"];

/// One message.
#[derive(Clone, Debug, Default)]
struct State {
    /// Stamp of the message, and time at which it was recorded \[ns\].
    stamp: i64,
    logged: i64,
    names: Vec<String>,
    position: Vec<f64>,
    velocity: Vec<f64>,
    effort: Vec<f64>,
}

impl State {
    fn decode(logged: i64, data: &[u8]) -> Result<State, CdrError> {
        let mut cdr = Decoder::new(data)?;
        let (sec, nanosec) = (i64::from(cdr.i32()?), i64::from(cdr.u32()?));
        cdr.string()?;
        let count = cdr.u32()? as usize;
        if count > MAX_NAMES {
            return Err(CdrError::Short { needed: count, left: MAX_NAMES });
        }
        let names = (0..count).map(|_| cdr.string()).collect::<Result<_, _>>()?;
        let mut list = || -> Result<Vec<f64>, CdrError> {
            let mut values = [0.0; MAX_NAMES];
            let count = cdr.f64s(&mut values)?;
            Ok(values[..count].to_vec())
        };
        let (position, velocity, effort) = (list()?, list()?, list()?);
        Ok(State { stamp: sec * 1_000_000_000 + nanosec, logged, names, position, velocity, effort })
    }
}

/// Messages by topic.
type Topics = BTreeMap<String, Vec<State>>;

/// Reads an MCAP file.
pub(super) fn mcap(file: &str, bytes: &[u8], wanted: &Wanted) -> Result<Imported, BadInput> {
    let broken = |error: String| BadInput::new(file, "file", error, "a complete MCAP file");
    let (mut topics, mut others) = (Topics::new(), Vec::new());
    let mut count = 0;
    for_each_message(bytes, broken, |Message { topic, schema, log_time, data }| {
        count += 1;
        if schema == TYPE {
            let state = State::decode(log_time as i64, &data)
                .map_err(|error| BadInput::new(file, format!("message {count}, topic {topic}"), error, TYPE))?;
            topics.entry(topic).or_default().push(state);
        } else if !others.contains(&topic) {
            others.push(topic);
        }
        Ok(())
    })?;
    understood(file, topics, &others, wanted)
}

/// Reads a rosbag2 database.
pub(super) fn database(path: &Path, wanted: &Wanted) -> Result<Imported, BadInput> {
    let file = path.display().to_string();
    let broken = |error: rusqlite::Error| BadInput::new(&file, "file", error, "a rosbag2 database (SQLite)");
    let base = Connection::open_with_flags(path, OpenFlags::SQLITE_OPEN_READ_ONLY).map_err(broken)?;
    let mut listed = base.prepare("SELECT id, name, type FROM topics").map_err(broken)?;
    let rows =
        listed.query_map([], |row| Ok((row.get::<_, i64>(0)?, row.get::<_, String>(1)?, row.get::<_, String>(2)?)));
    let (mut topics, mut others) = (Topics::new(), Vec::new());
    for row in rows.map_err(broken)? {
        let (id, topic, kind) = row.map_err(broken)?;
        if kind != TYPE {
            others.push(topic);
            continue;
        }
        let mut messages = base
            .prepare("SELECT timestamp, data FROM messages WHERE topic_id = ?1 ORDER BY timestamp")
            .map_err(broken)?;
        let rows = messages.query_map([id], |row| Ok((row.get::<_, i64>(0)?, row.get::<_, Vec<u8>>(1)?)));
        for (index, row) in rows.map_err(broken)?.enumerate() {
            let (logged, data) = row.map_err(broken)?;
            let state = State::decode(logged, &data)
                .map_err(|error| BadInput::new(&file, format!("message {} of {topic}", index + 1), error, TYPE))?;
            topics.entry(topic.clone()).or_default().push(state);
        }
    }
    understood(&file, topics, &others, wanted)
}

fn understood(file: &str, mut topics: Topics, others: &[String], wanted: &Wanted) -> Result<Imported, BadInput> {
    let listed = topics.keys().map(|topic| format!("`{topic}`")).collect::<Vec<_>>().join(", ");
    let chosen = match (&wanted.topic, topics.len()) {
        (Some(topic), _) => topic.clone(),
        (None, 1) => topics.keys().next().cloned().unwrap_or_default(),
        (None, 0) => {
            let others = others.iter().take(20).map(|topic| format!("`{topic}`")).collect::<Vec<_>>().join(", ");
            let found = if others.is_empty() { "none".into() } else { format!("other topics: {others}") };
            return Err(BadInput::new(file, "topics", found, format!("messages of {TYPE}")));
        }
        (None, _) => return Err(BadInput::new(file, "topics", listed, "--topic NAME: one of them")),
    };
    let Some(mut states) = topics.remove(&chosen) else {
        let expected = if listed.is_empty() { format!("messages of {TYPE}") } else { listed };
        return Err(BadInput::new(file, "--topic", format!("`{chosen}`"), expected));
    };
    let first = states[0].names.clone();
    let names = match &wanted.names {
        Some(names) => names.clone(),
        None => base_first(&first, wanted.joints).ok_or_else(|| {
            let found = first.join(", ");
            let expected = format!("--joint-names: the {} joints of the robot, base first", wanted.joints);
            BadInput::new(file, format!("joints of {chosen}"), found, expected)
        })?,
    };
    let mut notes = vec![format!("topic {chosen}, {} messages, joints {}", states.len(), names.join(" "))];
    let left_out: Vec<&str> = first.iter().filter(|name| !names.contains(name)).map(String::as_str).collect();
    if !left_out.is_empty() {
        notes.push(format!("left out: {}", left_out.join(" ")));
    }
    // A driver without stamps leaves them at zero.
    let stamped = states.iter().all(|state| state.stamp > 0);
    if stamped {
        let mut delays: Vec<f64> = states.iter().map(|state| (state.logged - state.stamp) as f64 * 1e-6).collect();
        delays.sort_by(f64::total_cmp);
        let (median, largest) = (delays[delays.len() / 2], delays[delays.len() - 1]);
        notes.push(format!(
            "time: stamps of the messages; recorded {median:.2} ms later (median), at most {largest:.2} ms"
        ));
        states.sort_by_key(|state| state.stamp);
    } else {
        notes.push("time: that of the recording, with the delays of the network; the messages have no stamps".into());
    }
    let n = names.len();
    let rows = states.len();
    let (mut q, mut dq, mut tau) = (DMatrix::zeros(rows, n), DMatrix::zeros(rows, n), DMatrix::zeros(rows, n));
    let has_velocity = states.iter().all(|state| state.velocity.len() == state.names.len());
    for (k, state) in states.iter().enumerate() {
        for (j, name) in names.iter().enumerate() {
            let place = || format!("message {}, joint `{name}`", k + 1);
            let Some(at) = state.names.iter().position(|own| own == name) else {
                return Err(BadInput::new(file, place(), format!("joints {}", state.names.join(", ")), "this joint"));
            };
            let of = |values: &[f64], what: &str| {
                let expected = format!("one {what} per joint");
                values
                    .get(at)
                    .copied()
                    .ok_or_else(|| BadInput::new(file, place(), format!("{} values", values.len()), expected))
            };
            q[(k, j)] = of(&state.position, "position")?;
            tau[(k, j)] = of(&state.effort, "effort")?;
            if has_velocity {
                dq[(k, j)] = of(&state.velocity, "velocity")?;
            }
        }
    }
    let time = |state: &State| if stamped { state.stamp } else { state.logged };
    let start = time(&states[0]);
    // From the first message on, so that no digit is lost.
    let t = states.iter().map(|state| (time(state) - start) as f64 * 1e-9).collect();
    Ok(Imported { t, q, dq: has_velocity.then_some(dq), tau, notes })
}

/// The `n` joints of an arm, base first, where their names tell: those of Universal Robots, or those that end in 1 to n.
fn base_first(names: &[String], n: usize) -> Option<Vec<String>> {
    let only = |of: &dyn Fn(&str) -> bool| {
        let mut found = names.iter().filter(|name| of(name));
        found.next().filter(|_| found.next().is_none()).cloned()
    };
    let numbered = |j: usize| {
        only(&|name: &str| {
            let stem = name.trim_end_matches(|c: char| c.is_ascii_digit());
            // Fingers are numbered, too.
            name[stem.len()..] == j.to_string() && !stem.contains("finger") && !stem.contains("wrist")
        })
    };
    let ur = || UR_ORDER.iter().map(|own| only(&|name: &str| name.contains(own))).collect::<Option<Vec<_>>>();
    let found = if n == UR_ORDER.len() { ur() } else { None };
    found.or_else(|| (1..=n).map(numbered).collect())
}
