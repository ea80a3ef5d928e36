//! Messages of MCAP files that other programs wrote.

use super::records::valid_prefix;
use mcap::MessageStream;
use std::borrow::Cow;

/// One message.
pub struct Message<'a> {
    pub topic: String,
    /// Name of its type; empty where the file has no schema.
    pub schema: String,
    /// Time at which it was recorded \[ns\].
    pub log_time: u64,
    pub data: Cow<'a, [u8]>,
}

/// Hands every message of a complete file to `each`, in the order of the file.
///
/// # Errors
/// A file that can't be read to its end, in words (mapped by `broken`), and errors of `each`.
pub fn for_each_message<E>(
    bytes: &[u8],
    broken: impl Fn(String) -> E,
    mut each: impl FnMut(Message<'_>) -> Result<(), E>,
) -> Result<(), E> {
    let at = valid_prefix(bytes);
    if at < bytes.len() {
        return Err(broken(format!("byte {at}: a chunk with a record beyond its end")));
    }
    for message in MessageStream::new(bytes).map_err(|error| broken(error.to_string()))? {
        let mcap::Message { channel, log_time, data, .. } = message.map_err(|error| broken(error.to_string()))?;
        let schema = channel.schema.as_ref().map_or_else(String::new, |schema| schema.name.clone());
        each(Message { topic: channel.topic.clone(), schema, log_time, data })?;
    }
    Ok(())
}

#[cfg(test)]
pub(crate) use written::{Compression, mcap_of};

#[cfg(test)]
mod written {
    pub use mcap::Compression;

    /// An MCAP file with these messages, each with its time \[ns\], as joint states, and as many of another kind.
    pub fn mcap_of(compression: Option<Compression>, messages: &[(u64, Vec<u8>)]) -> Vec<u8> {
        let options = mcap::WriteOptions::new().compression(compression);
        let mut writer = options.create(std::io::Cursor::new(Vec::new())).unwrap();
        let schema = writer.add_schema("sensor_msgs/msg/JointState", "ros2msg", b"").unwrap();
        let other = writer.add_schema("std_msgs/msg/String", "ros2msg", b"").unwrap();
        let channels = [(schema, "/joint_states"), (other, "/chatter")].map(|(schema, topic)| {
            writer.add_channel(schema, topic, "cdr", &std::collections::BTreeMap::new()).unwrap()
        });
        for (k, (log_time, message)) in messages.iter().enumerate() {
            let (sequence, log_time) = (k as u32, *log_time);
            let header =
                |channel_id| mcap::records::MessageHeader { channel_id, sequence, log_time, publish_time: log_time };
            writer.write_to_known_channel(&header(channels[0]), message).unwrap();
            writer.write_to_known_channel(&header(channels[1]), &[0, 1, 0, 0]).unwrap();
        }
        writer.finish().unwrap();
        writer.into_inner().into_inner()
    }
}
