//! A program that dies at any of its writes leaves old results or new ones, never half of one; a disk that is full or read-only is said, and
//! what was there stays. Faults are put into the system calls by strace.

use plumbline::dataset::{Dataset, Role};
use plumbline::report::Report;
use plumbline_testkit::job::*;
use plumbline_testkit::scene::Scene;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// System calls that change files, and that a cut of the power may come in.
const CALLS: [&str; 6] = ["openat", "write", "fsync", "rename", "renameat2", "unlink"];

/// Whether strace is there and may trace; says so loudly where it is not.
fn traceable() -> bool {
    let there = Command::new("strace").args(["-qq", "-o", "/dev/null", "true"]).stderr(Stdio::null()).status();
    let there = there.is_ok_and(|status| status.success());
    if !there {
        assert!(std::env::var_os("PLUMBLINE_REQUIRE_PEERS").is_none(), "strace is missing: apt-get install strace");
        println!("SKIPPED: strace is missing or may not trace; nothing was tried");
    }
    there
}

/// `command` under strace, with a fault at the `nth` of the `call`s of each of its threads.
fn with_fault(command: &Command, call: &str, fault: &str, nth: usize) -> Command {
    let mut traced = Command::new("strace");
    traced.args(["-f", "-qq", "-o", "/dev/null"]);
    traced.args(["-e", &format!("trace={call}"), "-e", &format!("inject={call}:{fault}:when={nth}")]);
    traced.arg("--").arg(command.get_program()).args(command.get_args());
    if let Some(folder) = command.get_current_dir() {
        traced.current_dir(folder);
    }
    traced
}

/// The lines of a trace of `call` by `command` that speak of `folder`, as the numbers that they have among the calls of their thread.
fn calls_in(command: &Command, call: &str, folder: &Path, trace: &Path) -> Vec<usize> {
    let mut traced = Command::new("strace");
    traced.args(["-f", "-y", "-qq", "-e", &format!("trace={call}"), "-o"]).arg(trace);
    traced.arg("--").arg(command.get_program()).args(command.get_args());
    if let Some(cwd) = command.get_current_dir() {
        traced.current_dir(cwd);
    }
    Done::of(traced).expect_code(0);
    let text = String::from_utf8_lossy(&std::fs::read(trace).unwrap()).into_owned();
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    let mut found = Vec::new();
    // Descriptors are shown with their paths; what is printed about the folder is no call that concerns it.
    let folder = folder.display().to_string();
    let concerns = if matches!(call, "write" | "fsync") { format!("<{folder}") } else { folder };
    for line in text.lines().filter(|line| line.contains(&format!("{call}("))) {
        let thread = line.split_whitespace().next().unwrap_or_default();
        let count = counts.entry(thread).or_default();
        *count += 1;
        if line.contains(&concerns) && !line.contains("O_RDONLY") {
            found.push(*count);
        }
    }
    found.sort_unstable();
    found.dedup();
    found
}

type Files = BTreeMap<PathBuf, Vec<u8>>;

/// Every file below a folder that has no hidden name on its way.
fn results(folder: &Path) -> Files {
    let mut found = Files::new();
    let mut folders = vec![folder.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let path = entry.path();
            if entry.file_name().to_string_lossy().starts_with('.') {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else {
                found.insert(path.clone(), std::fs::read(path).unwrap());
            }
        }
    }
    found
}

/// Whether a result is whole: its reader takes it, its end is there.
fn is_whole(path: &Path, bytes: &[u8]) -> bool {
    let text = String::from_utf8_lossy(bytes);
    match path.extension().and_then(|extension| extension.to_str()) {
        Some("json") => serde_json::from_str::<Report>(&text).is_ok(),
        Some("html") => text.trim_end().ends_with("</html>"),
        Some("toml") => text.ends_with('\n') && text.parse::<toml::Table>().is_ok(),
        Some("csv") => text.ends_with('\n'),
        other => panic!("{}: a result of kind {other:?}", path.display()),
    }
}

/// A command that leaves results in a folder.
struct Subject {
    name: &'static str,
    /// Makes what was there before, and what comes new.
    commands: [Command; 2],
    out: PathBuf,
}

/// Cuts `subject` at every `stride`-th of its calls of every kind; lines of a table.
fn cut(subject: &Subject, place: &Path, stride: usize) -> String {
    let [before, after] = &subject.commands;
    let mut lines = String::new();
    let run = |command: &Command| {
        let mut again = Command::new(command.get_program());
        again.args(command.get_args());
        if let Some(folder) = command.get_current_dir() {
            again.current_dir(folder);
        }
        Done::of(again).expect_code(0)
    };
    run(before);
    let trace = place.join("trace.txt");
    for call in CALLS {
        let numbers = calls_in(after, call, &subject.out, &trace);
        let (mut cuts, mut old_files, mut new_files) = (0, 0, 0);
        for &nth in numbers.iter().step_by(stride) {
            run(before);
            let old = results(&subject.out);
            let ended = with_fault(after, call, "signal=KILL", nth)
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .status()
                .unwrap();
            assert!(!ended.success(), "{}: {call} {nth} was not reached", subject.name);
            let left = results(&subject.out);
            for (path, bytes) in &left {
                let same = old.get(path) == Some(bytes);
                assert!(
                    same || is_whole(path, bytes),
                    "{}: after a cut at {call} {nth} half of {}",
                    subject.name,
                    path.display()
                );
                if same { old_files += 1 } else { new_files += 1 }
            }
            for path in old.keys() {
                assert!(
                    left.contains_key(path),
                    "{}: after a cut at {call} {nth} {} is gone",
                    subject.name,
                    path.display()
                );
            }
            cuts += 1;
        }
        // The next run clears away what the cuts left aside.
        run(after);
        let asides = std::fs::read_dir(&subject.out).unwrap().flatten();
        let asides: Vec<_> =
            asides.map(|entry| entry.file_name()).filter(|name| name.to_string_lossy().starts_with('.')).collect();
        assert!(asides.is_empty(), "{}: {asides:?}", subject.name);
        writeln!(lines, "| {} | {call} | {} | {cuts} | {old_files} | {new_files} | 0 |", subject.name, numbers.len())
            .unwrap();
    }
    lines
}

/// Fails a system call instead; the command says so, exits with 1 or 2, and what was there stays.
fn refuse(subject: &Subject, place: &Path, call: &str, error: &str, says: &str) {
    let [before, after] = &subject.commands;
    let numbers = calls_in(after, call, &subject.out, &place.join("trace.txt"));
    assert!(!numbers.is_empty(), "{}: no {call} in {}", subject.name, subject.out.display());
    for &nth in &numbers {
        let mut again = Command::new(before.get_program());
        again.args(before.get_args());
        Done::of(again).expect_code(0);
        let old = results(&subject.out);
        let done = Done::of(with_fault(after, call, &format!("error={error}"), nth));
        assert!(done.code == Some(1) || done.code == Some(2), "{}: {call} {nth}: {}", subject.name, done.output());
        assert!(done.err.contains(says) && done.err.contains(&subject.out.display().to_string()), "{}", done.output());
        let left = results(&subject.out);
        for (path, bytes) in &old {
            let now = left.get(path).unwrap_or_else(|| panic!("{call} {nth}: {} is gone", path.display()));
            assert!(now == bytes || is_whole(path, now), "{call} {nth}: {} is half", path.display());
        }
    }
}

/// A second of a recording: enough to identify from, quick to read.
fn dataset(folder: &Path) -> PathBuf {
    let scene = Scene::panda_on_the_wall();
    let run = |file: &str, role: Role, seed: u64| scene.dataset_run(file, role, (1, seed), 10, false);
    let runs = vec![run("identify.csv", Role::Identify, 1), run("validate.csv", Role::Validate, 2)];
    let dataset = Dataset {
        name: "short".into(),
        robot: "panda".into(),
        mounting: scene.mounting,
        source: toml::Table::new(),
        runs,
    };
    dataset.write(folder).unwrap();
    folder.to_path_buf()
}

fn command(words: &[&str], paths: [&Path; 2]) -> Command {
    let mut command = plumbline();
    command.arg(words[0]).arg(paths[0]).arg("--out").arg(paths[1]).args(&words[1..]);
    command
}

/// `identify` and `export`: several files, and one.
fn subjects(place: &Place) -> Vec<Subject> {
    let data = dataset(&place.path().join("data"));
    let model = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/models/panda-paper-table3.toml");
    let (out, file) = (place.path().join("out"), place.path().join("exported"));
    std::fs::create_dir_all(&file).unwrap();
    let exported = file.join("torques.csv");
    let run = data.join("validate.csv");
    let predict = |mounting: &str| {
        let mut command = plumbline();
        command.arg("predict").arg(&model).arg(&run).arg("--out").arg(&exported).args(["--mounting", mounting]);
        command
    };
    let identify = |terms: &str| command(&["identify", "--terms", terms], [&data, &out]);
    vec![
        Subject { name: "identify", commands: [identify("friction,torque-offset"), identify("friction")], out },
        Subject { name: "predict", commands: [predict("upright"), predict("wall")], out: file },
    ]
}

#[test]
fn an_interrupted_write_leaves_the_old_or_the_new_file() {
    if !traceable() {
        return;
    }
    let place = Place::new("power-cut");
    let subjects = subjects(&place);
    println!("{}", cut(&subjects[1], place.path(), 1));
    println!("{}", cut(&subjects[0], place.path(), 3));
}

#[test]
fn a_full_or_read_only_disk_is_reported_without_effect_on_the_loop() {
    if !traceable() {
        return;
    }
    let place = Place::new("full-disk");
    let subjects = subjects(&place);
    refuse(&subjects[1], place.path(), "write", "ENOSPC", "No space left on device");
    refuse(&subjects[1], place.path(), "openat", "EROFS", "Read-only file system");
    refuse(&subjects[1], place.path(), "rename", "EIO", "Input/output error");
    refuse(&subjects[0], place.path(), "fsync", "ENOSPC", "No space left on device");
}

#[test]
#[ignore = "minutes; hil/power-cut/run.sh runs it and writes its table into docs/results/campaigns.md"]
fn every_result_survives_an_interruption_at_every_write() {
    assert!(traceable(), "strace is needed");
    let place = Place::new("power-cut-all");
    let mut table = String::new();
    for subject in subjects(&place) {
        table += &cut(&subject, place.path(), 1);
    }
    plumbline_testkit::page::write_block("docs/results/campaigns.md", "power-cut", &format!("{HEAD}{table}"));
}

const HEAD: &str = "\
| command | system call | of them in the output | cuts | files as before | files new | half |
|---|---|---|---|---|---|---|
";
