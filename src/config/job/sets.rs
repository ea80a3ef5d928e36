//! Command-line overrides: `--set key.path=value` replaces keys of the file before it is deserialized.

use plumbline_core::{BadInput, expectation, from_toml};
use serde::de::DeserializeOwned;
use toml::{Table, Value};

/// Deserializes the file's text with the overrides. Errors name the override with the bad value, else the file.
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
        // An error of the file: parsing the file alone gives the line.
        if ours.file == file { from_toml::<T>(file, text).err().unwrap_or(ours) } else { ours }
    })
}

/// Attributes an error to the override that set the key.
pub(super) fn attribute(mut bad: BadInput, file: &str, sets: &[String]) -> BadInput {
    let key = bad.place.trim_start_matches("key `").trim_end_matches('`').to_string();
    let touches = |set: &&String| {
        let path = set.split('=').next().unwrap_or("").trim();
        let under = |deep: &str, shallow: &str| {
            deep == shallow || deep.strip_prefix(shallow).is_some_and(|rest| rest.starts_with(['.', '[']))
        };
        under(&key, path) || under(path, &key)
    };
    // The last override of a key is in effect.
    if let Some(set) = sets.iter().rev().find(touches) {
        bad.file = format!("--set {set}");
        bad.place = format!("key `{key}` (over {file})");
    }
    bad
}

/// Sets one `key.path=value` in the table.
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
        // `mounting.rho=...` over `mounting = "wall"` replaces the string by a table.
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

/// Value as TOML if it parses, else as a string.
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
