//! Clients of other origin, libfranka 0.9 and 0.21 in Python, believe the emulator. More of them: `hil/fci-peers/run.sh`.

use plumbline_franka::wire::Protocol;
use plumbline_testkit::emulator::{Emulator, Fault, OperatorAction, Settings, address};
use plumbline_testkit::peers;
use serde::Deserialize;
use std::io::{BufRead, BufReader, Read};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// How long the emulator waits for a command: a test must not fail because the machine stalls.
const COMMAND_WAIT: Duration = Duration::from_millis(5);
const STALL: &str = "0.4";

/// One exercise, as the program reports it.
#[derive(Deserialize)]
struct Cell {
    cell: String,
    good: bool,
    text: String,
}

fn peers_dir() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("hil/fci-peers")
}

fn settings(protocol: Protocol, library: Option<Vec<u8>>) -> Settings {
    Settings { command_wait: COMMAND_WAIT, model_library: library, ..Settings::new(address(), protocol) }
}

/// The model library for clients before version 8.
fn library() -> Vec<u8> {
    let dir = tempfile::tempdir().expect("a folder");
    let file = dir.path().join("libfcimodels.so");
    let source = peers_dir().join("model_library.c");
    let arguments = ["-shared", "-fPIC", "-O1", "-Wall", "-Wextra", "-Werror", "-o"];
    let made = Command::new("cc").args(arguments).arg(&file).arg(source).arg("-lm").status().expect("a C compiler");
    assert!(made.success());
    std::fs::read(file).expect("a library")
}

/// What a program asks the operator or the network for.
fn obey(emulator: &Emulator, order: &str) {
    match order.split_once(' ').unwrap_or((order, "")) {
        ("user-stop", "") => emulator.operate(OperatorAction::UserStop),
        ("release", "") => emulator.operate(OperatorAction::Release),
        ("fault", text) => emulator.fault(text.parse::<Fault>().unwrap_or_else(|error| panic!("{error}"))),
        _ => panic!("`{order}`"),
    }
}

/// Lets a program drive an emulator, with a second one of another version beside it, and returns the names of its exercises.
fn drive(python: &str, script: &str, served: Settings, other: Settings) -> Vec<String> {
    let addresses = [served.address, other.address].map(|address| address.to_string());
    let start = |settings| Emulator::start(settings).unwrap_or_else(|error| panic!("{error}"));
    let (served, _other) = (start(served), start(other));
    let mut program = Command::new(python)
        .args(["-u", script])
        .args(addresses)
        .current_dir(peers_dir())
        .env("FCI_STALL", STALL)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("python runs");
    let mut stderr = program.stderr.take().expect("a pipe");
    let errors = std::thread::spawn(move || {
        let mut text = String::new();
        stderr.read_to_string(&mut text).map(|_| text)
    });
    let mut names = Vec::new();
    for line in BufReader::new(program.stdout.take().expect("a pipe")).lines() {
        let line = line.expect("text");
        if let Some(order) = line.strip_prefix("DO ") {
            obey(&served, order);
        } else if let Some(cell) = line.strip_prefix("CELL ") {
            let cell: Cell = serde_json::from_str(cell).expect("a cell");
            println!("{script}, {}: {}", cell.cell, cell.text);
            assert!(cell.good, "{script}, {}: {}", cell.cell, cell.text);
            names.push(cell.cell);
        }
    }
    let status = program.wait().expect("an end");
    let errors = errors.join().expect("a reader").expect("text");
    assert!(status.success(), "{script}: {status}\n{errors}");
    names
}

/// What every binding of libfranka goes through.
const EXERCISES: [&str; 20] = [
    "connect",
    "read",
    "joint positions",
    "joint velocities",
    "torques",
    "setters",
    "model",
    "jump",
    "wrong start",
    "too fast",
    "out of range",
    "torque step",
    "torque range",
    "collision",
    "stall",
    "commands lost",
    "recovery",
    "user stop while idle",
    "user stop while moving",
    "another version",
];

#[test]
fn libfranka_0_9_drives_a_panda() {
    let Some(python) = peers::interpreter_in("libfranka-0.9", &["panda-python==1.1.1"]) else { return };
    let served = settings(Protocol::V5, Some(library()));
    let done = drive(&python, "panda_python.py", served, settings(Protocol::V10, None));
    let (shared, own) = done.split_at(EXERCISES.len());
    assert_eq!(shared, EXERCISES);
    assert_eq!(own, ["its own motions"]);
}

#[test]
fn libfranka_0_21_drives_an_fr3() {
    let requirements = ["pylibfranka==0.21.3", "franky-control==2.0.0"];
    let Some(python) = peers::interpreter_in("libfranka-0.21", &requirements) else { return };
    let served = settings(Protocol::V10, None);
    assert_eq!(drive(&python, "pylibfranka_client.py", served, settings(Protocol::V5, None)), EXERCISES);
}
