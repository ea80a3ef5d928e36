//! Command-line overrides: `--set key.path=value` laid over the file before it is read as a typed job.

use plumbline_core::{BadInput, expectation, from_toml};
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// The file's text with every override on top, as a typed value. Errors name the override that brought the bad value, else the file.
pub(super) fn typed<T: DeserializeOwned>(file: &str, text: &str, sets: &[String]) -> Result<T, BadInput> {
    if sets.is_empty() {
        return from_toml(file, text);
    }
    let mut table: Table = from_toml(file, text)?;
    for set in sets {
        apply(&mut table, set)?;
    }
    let whole = Value::Table(table);
    serde_path_to_error::deserialize(whole.clone()).map_err(|error| {
        let path = error.path().to_string();
        let value = find(&whole, &path).map_or_else(|| "nothing".to_string(), |value| format!("`{value}`"));
        let message = expectation(error.into_inner().message());
        let ours = attribute(BadInput::new(file, format!("key `{path}`"), value, message), file, sets);
        // What the command line didn't bring, the file did, and reading it alone knows the line.
        if ours.file == file { from_toml::<T>(file, text).err().unwrap_or(ours) } else { ours }
    })
}

/// Names the override as the origin of an error about a key that it set.
pub(super) fn attribute(mut bad: BadInput, file: &str, sets: &[String]) -> BadInput {
    let key = bad.place.trim_start_matches("key `").trim_end_matches('`').to_string();
    let touches = |set: &&String| {
        let path = set.split('=').next().unwrap_or("").trim();
        let under = |deep: &str, shallow: &str| {
            deep == shallow || deep.strip_prefix(shallow).is_some_and(|rest| rest.starts_with(['.', '[']))
        };
        under(&key, path) || under(path, &key)
    };
    // The last one wins, so the last one is to blame.
    if let Some(set) = sets.iter().rev().find(touches) {
        bad.file = format!("--set {set}");
        bad.place = format!("key `{key}` (over {file})");
    }
    bad
}

/// Puts one `key.path=value` into the table.
fn apply(table: &mut Table, set: &str) -> Result<(), BadInput> {
    let option = format!("--set {set}");
    let form = || BadInput::new(&option, "option", format!("`{set}`"), "key.path=value, such as backend.seed=7");
    let (path, text) = set.split_once('=').ok_or_else(form)?;
    let mut keys: Vec<&str> = path.trim().split('.').collect();
    if keys.iter().any(|key| key.is_empty()) {
        return Err(form());
    }
    let last = keys.pop().ok_or_else(form)?;
    let mut at = table;
    for key in keys {
        let inner = at.entry(key).or_insert_with(|| Value::Table(Table::new()));
        // `mounting.rho=...` over `mounting = "wall"`: the text gives way to the table that is being set.
        if inner.is_str() {
            *inner = Value::Table(Table::new());
        }
        let kind = inner.type_str();
        at = inner.as_table_mut().ok_or_else(|| {
            BadInput::new(&option, format!("key `{path}`"), format!("`{key}`, which is of type {kind}"), "a table")
        })?;
    }
    at.insert(last.to_string(), value(text.trim()));
    Ok(())
}

/// TOML where it is TOML, else a string.
fn value(text: &str) -> Value {
    let parsed = format!("value = {text}\n").parse::<Table>().ok().filter(|table| table.len() == 1);
    parsed.and_then(|mut table| table.remove("value")).unwrap_or_else(|| Value::String(text.to_string()))
}

/// The value at a path such as `excitation.q0[2]`.
fn find<'v>(whole: &'v Value, path: &str) -> Option<&'v Value> {
    path.split(['.', '[']).try_fold(whole, |at, key| match key.strip_suffix(']') {
        Some(index) => at.get(index.parse::<usize>().ok()?),
        None => at.get(key),
    })
}
