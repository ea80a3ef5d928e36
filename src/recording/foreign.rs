//! Messages of MCAP files that other programs wrote.

use super::read::valid_prefix;
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
