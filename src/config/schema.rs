//! JSON schemas of the configuration files, generated from the types that read them.
//!
//! They hold keys, types, choices and units. Ranges, and keys that go together, are checked by the program alone.

use super::job::Job;
use super::job::sim::TruthFile;
use plumbline_model::RobotFile;
use schemars::generate::SchemaSettings;
use schemars::transform::{Transform, transform_subschemas};
use schemars::{JsonSchema, Schema};
use serde_json::Value;

/// Name and schema of every kind of file.
pub fn schemas() -> [(&'static str, Schema); 3] {
    [("job", of::<Job>()), ("robot", of::<RobotFile>()), ("arm", of::<TruthFile>())]
}

fn of<T: JsonSchema>() -> Schema {
    let settings = SchemaSettings::draft2020_12().for_deserialize().with_transform(Toml);
    settings.into_generator().into_root_schema_for::<T>()
}

/// TOML has no null: a key that may be absent has the schema of its value. Descriptions lose the escapes of rustdoc.
#[derive(Clone)]
struct Toml;

impl Transform for Toml {
    fn transform(&mut self, schema: &mut Schema) {
        if let Some(Value::String(text)) = schema.get_mut("description") {
            *text = text.replace("\\[", "[").replace("\\]", "]");
        }
        if schema.get("default").is_some_and(Value::is_null) {
            schema.remove("default");
        }
        if let Some(Value::Array(types)) = schema.get_mut("type") {
            types.retain(|one| one != "null");
            if let [one] = &types[..] {
                let one = one.clone();
                schema.insert("type".into(), one);
            }
        }
        if let Some(Value::Array(choices)) = schema.get_mut("anyOf") {
            choices.retain(|one| one.get("type").is_none_or(|own| own != "null"));
        }
        transform_subschemas(self, schema);
    }
}
