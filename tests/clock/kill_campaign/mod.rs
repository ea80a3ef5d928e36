//! SIGKILL, and SIGSTOP with SIGCONT, at random moments of a motion: estimator, torque client, daemon, and the robot itself (the emulator of
//! Franka's control unit). The motion continues or stops by its rule, the restarted process is up in time and finds nothing stale, no delivered
//! sample is lost, and every old torque is marked as stale.
//!
//! One of each runs with the tests, two robots at a time; `hil/kill-campaign/run.sh` injects a hundred of each and writes the tables of docs/results/campaigns.md.

mod franka;
mod simulated;
mod table;

use plumbline_core::Phase;
use plumbline_ipc::{Progress, Request, Response};
use plumbline_testkit::kill::*;
use plumbline_testkit::turns::Turns;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
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
/// Each robot of the campaign is some processes that mostly wait.
static ROBOTS: Turns = Turns::new(2);

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

/// What is killed: estimator, torque client, daemon, robot.
const KINDS: [fn(u32, u64, bool) -> Row; 4] =
    [simulated::estimators, simulated::clients, franka::daemons, franka::emulators];

/// `rounds` of both faults with the process `number` of [`KINDS`].
fn rounds_of(number: u8, rounds: u32, seed: u64) -> [Row; 2] {
    [true, false].map(|kill| {
        let _turn = ROBOTS.take();
        let row = KINDS[usize::from(number)](rounds, seed + 2 * u64::from(number) + u64::from(kill), kill);
        eprintln!("{}", row.line());
        row.violations.iter().for_each(|violation| eprintln!("    {violation}"));
        row
    })
}

/// Most times that both are driven until each counts: a machine with other work stalls, and ends a motion by itself.
const MAX_ATTEMPTS: u64 = 4;

#[track_caller]
fn assert_one_of_each(number: u8) {
    let mut counted = [false; 2];
    for seed in 1..=MAX_ATTEMPTS {
        for (row, counted) in rounds_of(number, 1, seed).iter().zip(&mut counted) {
            assert!(row.violations.is_empty(), "{}: {:#?}", row.name, row.violations);
            *counted |= row.continued + row.stopped > 0;
        }
        if counted == [true; 2] {
            return;
        }
    }
    panic!("number {number}: in {MAX_ATTEMPTS} attempts this machine let no round count: {counted:?}");
}

#[test]
fn an_estimator_that_is_killed_or_suspended_loses_no_sample() {
    assert_one_of_each(0);
}

#[test]
fn a_torque_client_that_is_killed_or_suspended_reads_no_unmarked_old_torque() {
    assert_one_of_each(1);
}

#[test]
fn a_daemon_that_is_killed_or_suspended_leaves_the_arm_at_rest_or_moving_by_its_rule() {
    assert_one_of_each(2);
}

#[test]
fn a_robot_that_is_killed_or_suspended_ends_the_motion_by_its_rule() {
    assert_one_of_each(3);
}

/// Writes the tables of docs/results/campaigns.md; hil/kill-campaign/run.sh runs it.
#[test]
#[ignore = "takes half an hour"]
fn the_whole_campaign() {
    let number = |variable, default| std::env::var(variable).ok().and_then(|text| text.parse().ok()).unwrap_or(default);
    let (rounds, seed) = (number("ROUNDS", 50) as u32, number("SEED", 1));
    let before = load();
    // `ONLY=3` kills the robot alone.
    let only: Option<u8> = std::env::var("ONLY").ok().and_then(|text| text.parse().ok());
    let kinds = (0..4).filter(|number| only.is_none_or(|only| only == *number));
    let mut rows: Vec<Row> = kinds.flat_map(|number| rounds_of(number, rounds, seed)).collect();
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
