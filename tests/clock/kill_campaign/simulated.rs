//! Estimator and torque client, killed beside a simulated arm that follows the wall clock.

use super::table::{Outcome, Row};
use super::{Fault, LONG, draw, signals, start_motion};
use plumbline_ipc::Progress;
use plumbline_testkit::kill::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::time::Duration;

/// A simulated arm that keeps wall-clock time, with whatever is killed beside it.
fn simulated(name: &str) -> Robot {
    let mut sets = LONG.to_vec();
    sets.extend(["backend.arm=arms/sim-panda.toml", "backend.pace=wall-clock", "validation.counter-experiment=false"]);
    // A machine that stands still for a moment is not what is tried here.
    sets.push("safety.max-lost=200");
    Robot::new(name, plumbline_testkit::job::WALL, &sets)
}

pub fn estimators(rounds: u32, seed: u64, kill: bool) -> Row {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let robot = simulated("kill-estimator");
    let mut row = Row { name: format!("estimator, {}", signals(kill)), ..Row::default() };
    let mut daemon = robot.process("daemon");
    within(LIMIT, || robot.status().is_some()).expect("a daemon");
    let monitors = Monitors::watch(&robot.id);
    let mut estimator = robot.process("estimator");
    for round in 0..rounds {
        if daemon.ended().is_some() || robot.status().is_some_and(|now| now.progress == Progress::Stopped) {
            daemon.kill();
            daemon = robot.process("daemon");
        }
        let outcome = (|| {
            if !start_motion(&robot)? {
                return Ok(None);
            }
            within(LIMIT, || followed_by(&robot, estimator.pid())).ok_or("the estimator does not follow")?;
            std::thread::sleep(Duration::from_millis(random.random_range(0..600)));
            let mut up = None;
            match draw(&mut random, kill) {
                Fault::Kill => {
                    estimator.signal("KILL");
                    estimator = robot.process("estimator");
                    let took = within(LIMIT, || followed_by(&robot, estimator.pid())).ok_or("no successor follows")?;
                    up = Some(took.as_secs_f64() * 1e3);
                }
                Fault::Suspend(ms) => {
                    estimator.signal("STOP");
                    std::thread::sleep(Duration::from_millis(ms));
                    estimator.signal("CONT");
                }
            }
            // It has, or fetches, everything that was published.
            let published = robot.status().ok_or("the daemon does not answer")?.served.published;
            within(LIMIT, || acknowledged(&robot, estimator.pid()) >= published).ok_or("samples do not arrive")?;
            let now = robot.status().ok_or("the daemon does not answer")?;
            if now.served.given_up_unacknowledged > 0 {
                return Err(format!("{} samples given up", now.served.given_up_unacknowledged));
            }
            Ok(Some(Outcome { continued: driving(&now), up, rest: None }))
        })();
        row.take(round, outcome);
        row.take_violations(round, &monitors);
    }
    if row.stopped > 0 {
        row.violations.push(format!("the arm stopped {} times, although the rule is `finish`", row.stopped));
    }
    (row.samples, row.torques) = monitors.end();
    row
}

pub fn clients(rounds: u32, seed: u64, kill: bool) -> Row {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let robot = simulated("kill-client");
    let mut row = Row { name: format!("torque client, {}", signals(kill)), ..Row::default() };
    let _daemon = robot.process("daemon");
    within(LIMIT, || robot.status().is_some()).expect("a daemon");
    let monitors = Monitors::watch(&robot.id);
    let mut client = robot.torque_client();
    for round in 0..rounds {
        let outcome = (|| {
            if !start_motion(&robot)? {
                return Ok(None);
            }
            within(LIMIT, || client.output().lines().count() > 2).ok_or("the client says nothing")?;
            std::thread::sleep(Duration::from_millis(random.random_range(0..400)));
            let mut up = None;
            match draw(&mut random, kill) {
                Fault::Kill => {
                    client.signal("KILL");
                    let message = client.output();
                    check_marks(&message)?;
                    client = robot.torque_client();
                    let took = within(LIMIT, || client.output().contains("tau_ff")).ok_or("no successor reads")?;
                    up = Some(took.as_secs_f64() * 1e3);
                }
                Fault::Suspend(ms) => {
                    client.signal("STOP");
                    std::thread::sleep(Duration::from_millis(ms));
                    let before = client.output().lines().count();
                    client.signal("CONT");
                    within(LIMIT, || client.output().lines().count() > before + 3)
                        .ok_or("the client does not go on")?;
                    check_marks(&client.output())?;
                }
            }
            let now = robot.status().ok_or("the daemon does not answer")?;
            Ok(Some(Outcome { continued: driving(&now), up, rest: None }))
        })();
        row.take(round, outcome);
        row.take_violations(round, &monitors);
    }
    if row.stopped > 0 {
        row.violations.push(format!("the arm stopped {} times because of a client", row.stopped));
    }
    (row.samples, row.torques) = monitors.end();
    row
}

fn followed_by(robot: &Robot, pid: u32) -> bool {
    robot.status().is_some_and(|now| now.served.followers.iter().any(|follower| follower.pid == pid))
}

fn acknowledged(robot: &Robot, pid: u32) -> u64 {
    let of = |status: plumbline_ipc::Status| status.served.followers.into_iter().find(|follower| follower.pid == pid);
    robot.status().and_then(of).map_or(0, |follower| follower.acknowledged)
}

fn check_marks(message: &str) -> Result<(), String> {
    match unmarked(message).first() {
        Some(line) => Err(format!("an old torque was printed without a mark: {line}")),
        None => Ok(()),
    }
}
