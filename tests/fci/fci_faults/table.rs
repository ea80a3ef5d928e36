//! Every fault at every phase, and the table that says what came of it.

use super::case::{Case, Disturbance, Ending, When};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::sync::{Mutex, MutexGuard, PoisonError};

struct Row {
    name: &'static str,
    disturbance: Disturbance,
    /// Whether the protocol allows for it, so that a job has to get over it wherever it comes.
    tolerated: bool,
}

impl Row {
    /// Whether the job goes on: an arm that is only watched does not care whether commands arrive, and states may be late.
    fn must_continue(&self, when: When) -> bool {
        let at_rest = ["loss: all commands", "delay", "jitter", "protocol version", "user stop", "reflex"];
        self.tolerated || (when == When::Serve && at_rest.iter().any(|name| self.name.starts_with(name)))
    }
}

const fn network(name: &'static str, faults: &'static [&'static str], tolerated: bool) -> Row {
    Row { name, disturbance: Disturbance::Faults(faults), tolerated }
}

const ROWS: &[Row] = &[
    Row { name: "nothing", disturbance: Disturbance::None, tolerated: true },
    network("loss: 2 % for 1 s", &["loss=0.02,for=1"], true),
    network("loss: all for 0.3 s", &["loss=1,for=0.3"], false),
    network("loss: all commands for 0.3 s", &["loss=1,of=commands,for=0.3"], false),
    network("delay: 0.2 ms for 1 s", &["delay=0.0002,for=1"], true),
    network("delay: 5 ms for 0.3 s", &["delay=0.005,for=0.3"], false),
    network("jitter: up to 0.4 ms for 1 s", &["jitter=0.0004,for=1"], true),
    network("jitter: up to 10 ms for 0.3 s", &["jitter=0.01,for=0.3"], false),
    network("duplicates: 20 % for 1 s", &["duplicate=0.2,for=1"], true),
    network("reordering: 2 % for 1 s", &["reorder=0.02,for=1"], true),
    network("truncated: 2 % for 1 s", &["truncate=0.02,for=1"], true),
    network("truncated: all for 0.3 s", &["truncate=1,for=0.3"], false),
    network("garbage: 2 % for 1 s", &["garbage=0.02,for=1"], true),
    network("garbage: all for 0.3 s", &["garbage=1,for=0.3"], false),
    network("TCP reset", &["tcp-reset"], false),
    network("the robot is silent for 0.3 s", &["silence,for=0.3"], false),
    network("protocol version 4 for 1 s", &["wrong-version=4,for=1"], false),
    Row { name: "user stop", disturbance: Disturbance::UserStop, tolerated: false },
    Row { name: "reflex (somebody pushes)", disturbance: Disturbance::Reflex, tolerated: false },
];

/// Cases that are played at once: each has threads of its own that sleep most of the time.
const AT_A_TIME: usize = 2;

fn held<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

/// What the daemon may have named, as the table has it.
const NAMES: [(&str, &str); 15] = [
    ("of the arm were no states", "damaged states"),
    ("communication_constraints_violation", "`communication_constraints_violation`"),
    ("joint_motion_generator", "`joint_motion_generator_…`"),
    ("cartesian_reflex", "`cartesian_reflex`"),
    ("joint_reflex", "`joint_reflex`"),
    ("user stopped", "`user stopped`"),
    ("protocol version", "the robot's version"),
    ("none of its states arrived", "no states over UDP"),
    ("no state came", "silence of the robot"),
    ("closed the command connection", "connection closed"),
    ("closed the connection", "connection closed"),
    ("no connection to the arm", "no connection"),
    ("did not answer", "no answer"),
    ("automatic error recovery", "recovery failed"),
    ("states were lost", "states lost"),
];

fn named(words: &str) -> &'static str {
    NAMES.iter().find(|(part, _)| words.contains(part)).map_or("?", |(_, name)| name)
}

/// What a robot that sends no states says over its command connection.
fn tcp_status(words: &str) -> String {
    let silent = words.split_once("over its command connection it says that ");
    let status = silent.and_then(|(_, rest)| rest.split([':', '.']).next());
    status.map_or(String::new(), |status| format!(", over TCP \"{status}\""))
}

fn cell(case: &Case, ending: &Ending, tries: u32) -> String {
    let rest = match (ending.rest_after, ending.code) {
        (Some(ms), Some(1)) => format!("; at rest after {:.2} s", ms as f64 * 1e-3),
        _ => String::new(),
    };
    let mut words = match (ending.code, case.when) {
        (Some(0), When::Serve) if ending.output.contains("no motion can start") => {
            format!("goes on, names {}", named(&ending.output))
        }
        (Some(0), When::Serve) => "goes on".into(),
        (Some(0), When::Stop) => "stops as asked".into(),
        (Some(0), _) if ending.done => format!("driven to the end{}", counts(ending)),
        (Some(0), _) => "ends, not everything driven".into(),
        (Some(1), _) => format!("exit 1: {}{}{rest}", named(ending.last_line()), tcp_status(ending.last_line())),
        (other, _) => format!("exit {other:?}"),
    };
    match ending.recoveries() {
        0 => {}
        1 => words = format!("recovers, {words}"),
        more => words = format!("recovers {more} times, {words}"),
    }
    if tries > 1 {
        let _ = write!(words, " (try {tries})");
    }
    if let Some(objection) = ending.objection() {
        words = format!("**{objection}**; {words}");
    }
    words
}

fn counts(ending: &Ending) -> String {
    let sessions = ending.status.iter().flat_map(|status| &status.sessions);
    let links = sessions.filter(|session| session.name != "hold").filter_map(|session| session.link.as_ref());
    let (lost, odd, late) =
        links.fold((0, 0, 0), |(lost, odd, late), link| (lost + link.lost, odd + link.odd, late + link.late));
    if lost + odd + late == 0 { String::new() } else { format!(" ({lost} lost, {odd} odd, {late} late)") }
}

/// Plays a cell; a fault that must be got over is tried up to four times where the machine itself may have stalled.
fn play(row: &Row, case: &Case) -> (String, Option<String>) {
    for tries in 1.. {
        let ending = case.run();
        let over = ending.code == Some(0) || !row.must_continue(case.when);
        if !over && ending.stalled() && tries < 4 && ending.objection().is_none() {
            continue;
        }
        let text = cell(case, &ending, tries);
        eprintln!("{:<32} {:<8} {text}", row.name, format!("{:?}", case.when));
        let unexpected = (!over).then(|| "the fault was not got over".to_string()).or_else(|| ending.objection());
        return (text, unexpected.map(|why| format!("{}, {:?}: {why}\n{}", row.name, case.when, ending.describe())));
    }
    unreachable!("the loop returns")
}

type Cells = BTreeMap<(usize, usize), String>;

/// One table: `sets` are the job's own, on top of the shipped one.
fn table(rows: &[&Row], whens: &[When], sets: &[&str], wrong: &mut Vec<String>) -> String {
    let mut waiting: Vec<(usize, usize)> =
        (0..rows.len()).flat_map(|r| (0..whens.len()).map(move |w| (r, w))).collect();
    waiting.reverse();
    let (waiting, cells, unexpected) = (Mutex::new(waiting), Mutex::new(Cells::new()), Mutex::new(Vec::new()));
    std::thread::scope(|scope| {
        for _ in 0..AT_A_TIME {
            scope.spawn(|| {
                loop {
                    let Some((r, w)) = held(&waiting).pop() else { return };
                    let case = Case::new(rows[r].disturbance, whens[w]).with(sets);
                    let (text, more) = play(rows[r], &case);
                    held(&unexpected).extend(more);
                    held(&cells).insert((r, w), text);
                }
            });
        }
    });
    wrong.append(&mut held(&unexpected));
    let cells = held(&cells);
    let mut text = String::from("| fault |");
    for when in whens {
        let _ = write!(text, " {} |", format!("{when:?}").to_lowercase());
    }
    text += "\n|---|";
    whens.iter().for_each(|_| text += "---|");
    text += "\n";
    for (r, row) in rows.iter().enumerate() {
        let _ = write!(text, "| {} |", row.name);
        for w in 0..whens.len() {
            let _ = write!(text, " {} |", cells[&(r, w)]);
        }
        text += "\n";
    }
    text
}

/// What the machine is, without its name.
fn conditions() -> String {
    let read = |path: &str| std::fs::read_to_string(path).unwrap_or_default();
    let release = read("/proc/sys/kernel/osrelease");
    let kernel = release.split('.').take(2).collect::<Vec<_>>().join(".");
    let processors = std::thread::available_parallelism().map_or(0, usize::from);
    let load: Vec<String> = read("/proc/loadavg").split(' ').take(3).map(str::to_string).collect();
    let real_time = if plumbline_rt::preempt_rt() { "PREEMPT_RT" } else { "no real-time kernel" };
    format!(
        "Linux {} ({real_time}), {processors} processors, load {} at the end; robot and daemon on the same machine over the loopback \
         device, both with SCHED_FIFO where the system grants it, {AT_A_TIME} cases at a time.",
        kernel,
        load.join(" ")
    )
}

/// Plays everything and writes `docs/results/franka-faults.md`.
pub fn campaign() {
    let mut wrong = Vec::new();
    let all: Vec<&Row> = ROWS.iter().collect();
    let severe: Vec<&Row> = ROWS.iter().filter(|row| !row.tolerated).collect();
    let operator = table(&all, &When::ALL, &["backend.franka.recovery=operator"], &mut wrong);
    let moving = [When::Approach, When::Excite, When::Stop, When::Serve];
    let automatic = table(&severe, &moving, &["backend.franka.recovery=automatic"], &mut wrong);
    let text = format!(
        "Played on: {}\n\n## `recovery = \"operator\"`\n\n{operator}\n## `recovery = \"automatic\"`, `max-recoveries = 2`\n\n{automatic}",
        conditions()
    );
    plumbline_testkit::page::write_block("docs/results/franka-faults.md", "faults", &text);
    assert!(wrong.is_empty(), "{} cells are not as they must be:\n{}", wrong.len(), wrong.join("\n\n"));
}
