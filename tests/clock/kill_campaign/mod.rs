//! SIGKILL, and SIGSTOP with SIGCONT, at random moments of a motion: estimator, torque client, daemon, and the robot itself (the emulator of
//! Franka's control unit). The motion continues or stops by its rule, the restarted process is up in time and finds nothing stale, no delivered
//! sample is lost, and every old torque is marked as stale.
//!
//! One of each runs with the tests; `hil/kill-campaign/run.sh` injects a hundred of each and writes the tables of docs/results/campaigns.md.

mod franka;
mod simulated;
mod table;

use plumbline_core::Phase;
use plumbline_ipc::{Progress, Request, Response};
use plumbline_testkit::kill::*;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use table::{Row, load, page};

/// A programme that outlasts a campaign.
const LONG: [&str; 9] = [
    "excitation.period=4 s",
    "excitation.periods=400",
    "excitation.trajectories=1",
    "excitation.starts=1",
    "excitation.rounds=0",
    "validation.trajectories=1",
    "validation.mountings=[\"wall\"]",
    "output.dataset=false",
    "diagnosis.enabled=false",
];
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// What is done to a process.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    Kill,
    /// SIGSTOP, and SIGCONT after this many milliseconds.
    Suspend(u64),
}

fn draw(random: &mut ChaCha8Rng, kill: bool) -> Fault {
    if kill { Fault::Kill } else { Fault::Suspend(random.random_range(1..1500)) }
}

/// Starts the programme where it does not run; `false` when this machine would not let it.
fn start_motion(robot: &Robot) -> Result<bool, String> {
    let answered = within(LIMIT, || robot.status().is_some());
    answered.ok_or("the daemon does not answer")?;
    if robot.status().is_some_and(|now| now.progress == Progress::Idle) {
        match robot.ask(&Request::Start {}) {
            Some(Response::Accepted {}) | None => {}
            other => return Err(format!("start was answered with {other:?}")),
        }
    }
    Ok(within(Duration::from_secs(10), || robot.status().is_some_and(|now| driving(&now))).is_some())
}

/// Waits until the daemon that was started at `since` answers, and looks that it holds.
fn check_successor(robot: &Robot, since: Instant) -> Result<f64, String> {
    within(LIMIT, || robot.status().is_some()).ok_or("no successor answers")?;
    let up = since.elapsed();
    let now = robot.status().ok_or("the successor went silent")?;
    let still = now.progress == Progress::Idle && now.motion == 0 && now.phase == Phase::Hold;
    if !still || now.served.trouble.is_some() {
        return Err(format!(
            "the successor does not just hold: {:?} {:?} {:?}",
            now.progress, now.phase, now.served.trouble
        ));
    }
    Ok(up.as_secs_f64() * 1e3)
}

fn signals(kill: bool) -> &'static str {
    if kill { "SIGKILL" } else { "SIGSTOP, SIGCONT" }
}

/// All processes and faults, `rounds` each.
fn campaign(rounds: u32, seed: u64) -> Vec<Row> {
    let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let kinds: [fn(u32, u64, bool) -> Row; 4] =
        [simulated::estimators, simulated::clients, franka::daemons, franka::emulators];
    // `ONLY=3` runs the robot's alone.
    let only = std::env::var("ONLY").ok();
    let mut rows = Vec::new();
    for (kind, number) in kinds.into_iter().zip(0u64..) {
        if only.as_ref().is_some_and(|only| *only != number.to_string()) {
            continue;
        }
        for kill in [true, false] {
            let row = kind(rounds, seed + 2 * number + u64::from(kill), kill);
            eprintln!("{}", row.line());
            row.violations.iter().for_each(|violation| eprintln!("    {violation}"));
            rows.push(row);
        }
    }
    rows
}

#[test]
fn one_of_each() {
    for row in campaign(1, 1) {
        assert!(row.violations.is_empty(), "{}: {:#?}", row.name, row.violations);
        assert!(row.continued + row.stopped > 0, "{}: this machine let no round count", row.name);
    }
}

/// Writes the tables of docs/results/campaigns.md; hil/kill-campaign/run.sh runs it.
#[test]
#[ignore = "takes half an hour"]
fn the_whole_campaign() {
    let number = |variable, default| std::env::var(variable).ok().and_then(|text| text.parse().ok()).unwrap_or(default);
    let (rounds, seed) = (number("ROUNDS", 50) as u32, number("SEED", 1));
    let before = load();
    let mut rows = campaign(rounds, seed);
    // Here alone: the tests that run everywhere set no limit to a time.
    for row in &mut rows {
        let slow = row.up.iter().filter(|&&up| up > RESTART.as_secs_f64() * 1e3).count();
        if slow > 0 {
            row.violations.push(format!("{slow} of {} successors took longer than {RESTART:?}", row.up.len()));
        }
    }
    let text = page(rounds, seed, &before, &rows);
    let block = std::env::var("ONLY").map_or("kills".to_string(), |only| format!("kills-{only}"));
    plumbline_testkit::page::write_block("docs/results/campaigns.md", &block, &text);
    assert!(rows.iter().all(|row| row.violations.is_empty()));
}
