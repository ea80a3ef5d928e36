//! The JSON schemas that `plumbline manual` writes take exactly the keys, types, choices and units that the program's types take.

use plumbline::config::job::Job;
use plumbline_model::RobotFile;
use plumbline_sim::TruthFile;
use plumbline_testkit::job::*;
use plumbline_testkit::{page, path, peers};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;

/// Prints what a schema takes of a list of documents.
const PEER: &str = "import json, sys, jsonschema\n\
                    schema, documents = json.load(open(sys.argv[1])), json.load(open(sys.argv[2]))\n\
                    jsonschema.Draft202012Validator.check_schema(schema)\n\
                    validator = jsonschema.Draft202012Validator(schema)\n\
                    print(json.dumps([validator.is_valid(one) for one in documents]))\n";

fn toml_files(folder: &str) -> Vec<(String, String)> {
    let files = std::fs::read_dir(path(folder)).unwrap().map(|entry| entry.unwrap().path());
    let files = files.filter(|file| file.extension().is_some_and(|extension| extension == "toml"));
    files.map(|file| (file.display().to_string(), std::fs::read_to_string(&file).unwrap())).collect()
}

/// A document with its name.
type Document = (String, toml::Value);

/// Other values in the place of one: of another type or length, with another unit, with an unknown key, without a key.
fn others(value: &toml::Value) -> Vec<toml::Value> {
    match value {
        toml::Value::Table(table) => {
            let mut more = table.clone();
            more.insert("zzz".into(), 1.into());
            let without = table.keys().map(|key| {
                let mut less = table.clone();
                less.remove(key);
                less
            });
            std::iter::once(more).chain(without).map(toml::Value::Table).chain([1.into()]).collect()
        }
        toml::Value::Array(values) => {
            let (mut more, less) = (values.clone(), values.iter().skip(1).cloned().collect::<Vec<_>>());
            more.extend(values.last().cloned());
            vec![toml::Value::Array(more), toml::Value::Array(less), "x".into()]
        }
        toml::Value::String(text) => {
            let number = text.split(' ').next().unwrap_or_default();
            let texts = [number.to_string(), format!("{number} parsec"), format!(" {text} "), "x".into()];
            texts.map(toml::Value::from).into_iter().chain([1.into(), true.into()]).collect()
        }
        toml::Value::Integer(_) | toml::Value::Float(_) => {
            vec![(-1).into(), 1.5.into(), 7.into(), 1_000_000.into(), "1".into(), true.into()]
        }
        _ => vec!["true".into(), 1.into()],
    }
}

/// Calls `take` with the tree for every value that is changed, one at a time, and with what was changed.
fn each(whole: &toml::Value, place: &str, take: &mut dyn FnMut(toml::Value, String)) {
    for other in others(whole) {
        let what = format!("{place} = {}", other.to_string().chars().take(60).collect::<String>());
        take(other, what);
    }
    match whole {
        toml::Value::Table(table) => {
            for (key, value) in table {
                each(value, &format!("{place}.{key}"), &mut |inner, what| {
                    let mut own = table.clone();
                    own.insert(key.clone(), inner);
                    take(toml::Value::Table(own), what);
                });
            }
        }
        toml::Value::Array(values) => {
            // The first entry stands for the others.
            if let Some(value) = values.first() {
                each(value, &format!("{place}[0]"), &mut |inner, what| {
                    let mut own = values.clone();
                    own[0] = inner;
                    take(toml::Value::Array(own), what);
                });
            }
        }
        _ => {}
    }
}

/// Compares a schema with the type that reads the documents.
fn compare<T: DeserializeOwned>(python: &str, place: &Place, schema: &Path, valid: Vec<Document>) {
    let takes = |document: &toml::Value| document.clone().try_into::<T>().is_ok();
    for (name, document) in &valid {
        assert!(takes(document), "{name}");
    }
    let mut all: Vec<Document> = Vec::new();
    for (name, document) in &valid {
        each(document, "", &mut |changed, what| all.push((format!("{name}: {what}"), changed)));
    }
    all.extend(valid);
    // A number that is not finite has no JSON.
    let documents: Vec<Value> = all.iter().map(|(_, document)| serde_json::to_value(document).unwrap()).collect();
    let file = place.path().join("documents.json");
    std::fs::write(&file, json!(documents).to_string()).unwrap();
    let done = Done::of(Command::new(python).args(["-c", PEER]).args([schema, &file])).expect_code(0);
    let taken: Vec<bool> = serde_json::from_str(&done.out).unwrap();
    assert_eq!(taken.len(), all.len());
    let mut refused = 0;
    let mut differ = Vec::new();
    for ((name, document), by_schema) in all.iter().zip(taken) {
        let by_program = takes(document);
        refused += usize::from(!by_program);
        if by_program != by_schema {
            differ.push(format!("{name}: program {by_program}, schema {by_schema}"));
        }
    }
    assert!(differ.is_empty(), "{} of {}:\n{}", differ.len(), all.len(), differ[..differ.len().min(40)].join("\n"));
    assert!(refused > all.len() / 4 && refused < all.len(), "{refused} of {} are refused", all.len());
}

#[test]
fn the_schemas_take_what_the_program_takes() {
    let place = Place::new("schemas");
    let out = place.path().join("share");
    Done::of(plumbline().arg("manual").arg("--out").arg(&out)).expect_code(0);
    let schema = |name: &str| out.join("plumbline/schema").join(name);
    let document = |(name, text): (String, String)| (name, toml::Value::Table(text.parse().unwrap()));
    let mut jobs: Vec<Document> = toml_files("config").into_iter().map(document).collect();
    // The keys that no shipped job has, as the reference shows them.
    let page = page::read("docs/reference/job-file.md");
    let blocks: Vec<&str> =
        page.split("```toml\n").skip(1).map(|rest| rest.split("```").next().unwrap()).take(4).collect();
    let head = |kind: &str| {
        format!("robot = \"panda\"\nmounting = {{ rho = \"90 deg\", phi = \"0 deg\" }}\nbackend.kind = \"{kind}\"\n")
    };
    for (k, kind) in [(1, "franka"), (2, "guest"), (3, "sim")] {
        jobs.push(document((format!("job-file.md, block {k}"), head(kind) + blocks[k])));
    }
    jobs.push(document(("job-file.md, block 0".into(), blocks[0].into())));
    let robots: Vec<Document> =
        ["config/robots", "crates/model/tests/golden/robots"].into_iter().flat_map(toml_files).map(document).collect();
    assert!(jobs.len() > 15 && robots.len() > 8, "{} jobs, {} robots", jobs.len(), robots.len());
    let mut arms: Vec<Document> = toml_files("config/arms").into_iter().map(document).collect();
    // One of each effect, and every form of those that have several.
    let effects = std::fs::read_to_string(path("crates/sim/src/effect/tests/examples.txt")).unwrap();
    let with = |effect: &str| (effect.to_string(), format!("effect = [{{ {effect}, from = 1.0, until = 2 }}]"));
    arms.extend(effects.lines().map(with).map(document));
    assert!(arms.len() > 40, "{} arms", arms.len());
    let text = std::fs::read_to_string(schema("job.json")).unwrap();
    // What an editor shows: units of defaults, descriptions without escapes.
    assert!(text.contains("\"default\": \"10 s\"") && !text.contains("\\\\[") && !text.contains("\"null\""), "{text}");
    let Some(python) = peers::interpreter_in("schema", &["jsonschema==4.*"]) else { return };
    compare::<Job>(&python, &place, &schema("job.json"), jobs);
    compare::<RobotFile>(&python, &place, &schema("robot.json"), robots);
    compare::<TruthFile>(&python, &place, &schema("arm.json"), arms);
}
