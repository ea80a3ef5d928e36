//! Daemon and robot, killed with the emulator of Franka's control unit between them: the arm outlives the daemon.

use super::table::{Outcome, Row};
use super::{Fault, LONG, check_successor, draw, signals, start_motion};
use plumbline_franka::wire::Protocol;
use plumbline_ipc::{Progress, Status};
use plumbline_testkit::emulator;
use plumbline_testkit::kill::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::net::IpAddr;
use std::process::Command;
use std::time::{Duration, Instant};

const ADDRESS: &str = "PLUMBLINE_TEST_EMULATOR";
/// Measured speed of an arm at rest, noise included \[rad/s\].
const AT_REST: f64 = 0.02;

/// Not a test of its own: the emulator's process, which the campaign kills. Without an address there is nothing to do.
#[test]
fn emulator_child() {
    let Ok(address) = std::env::var(ADDRESS) else { return };
    let address: IpAddr = address.parse().unwrap();
    let settings = emulator::Settings::new(address, Protocol::V5);
    let command_wait = Duration::from_millis(10);
    let _emulator = emulator::Emulator::start(emulator::Settings { command_wait, ..settings }).unwrap();
    loop {
        std::thread::sleep(Duration::from_secs(60));
    }
}

/// A robot that the emulator stands for, and its address.
fn emulated(name: &str) -> (Robot, IpAddr) {
    let address = emulator::address();
    let at = format!("backend.franka.address={address}");
    let mut sets = LONG.to_vec();
    sets.push(&at);
    (Robot::new(name, "config/panda-emulator-wall.toml", &sets), address)
}

/// Whether the emulator's arm is at rest: what it was told and what it does.
fn at_rest(arm: &emulator::Emulator) -> bool {
    let state = arm.snapshot().state;
    state.dq_d.iter().all(|&dq| dq == 0.0) && state.dq.iter().all(|dq| dq.abs() < AT_REST)
}

/// When the arm came to rest after `injected` and stayed there: longer than a robot without commands extrapolates, 20 of them here by 10 ms.
fn comes_to_rest(injected: Instant, rests: impl Fn() -> bool) -> Option<Duration> {
    let mut moved = injected.elapsed();
    while injected.elapsed() < moved + Duration::from_millis(400) {
        if !rests() {
            moved = injected.elapsed();
        }
        if moved > Duration::from_secs(2) {
            return None;
        }
        std::thread::sleep(Duration::from_millis(2));
    }
    Some(moved)
}

/// Waits until the robot is served; a daemon that finds the robot busy ends, and is started again as a service would be.
fn wait_until_served(robot: &Robot, daemon: &mut Process) -> bool {
    let served = within(LIMIT, || {
        if daemon.ended().is_some() {
            *daemon = robot.process("daemon");
        }
        robot.status().is_some()
    });
    served.is_some()
}

/// A robot and a daemon for the next round. The old ones have to go before the new ones can have their address.
fn restart(
    robot: &Robot,
    arm: &mut Option<emulator::Emulator>,
    daemon: &mut Process,
    emulator: &impl Fn() -> emulator::Emulator,
) {
    if daemon.ended().is_none() {
        daemon.signal("KILL");
        within(LIMIT, || daemon.ended().is_some());
    }
    drop(arm.take());
    *arm = Some(emulator());
    *daemon = robot.process("daemon");
    wait_until_served(robot, daemon);
}

/// The torque is known to be stale; the monitor thread may be late by a slice of this machine's time.
fn check_stale(monitors: &Monitors, injected: Instant) -> Result<(), String> {
    within(Duration::from_millis(50), || monitors.stale.load(std::sync::atomic::Ordering::Relaxed))
        .map(drop)
        .ok_or_else(|| format!("{:?} after the fault the torque is not stale", injected.elapsed()))
}

/// The arm is the emulator's: it is there after the daemon's death, and says itself whether it moves.
pub fn daemons(rounds: u32, seed: u64, kill: bool) -> Row {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (robot, address) = emulated("kill-daemon");
    let settings = emulator::Settings {
        command_wait: Duration::from_millis(10),
        ..emulator::Settings::new(address, Protocol::V5)
    };
    let emulator = || emulator::Emulator::start(settings.clone()).unwrap();
    let mut row = Row { name: format!("daemon, {}", signals(kill)), ..Row::default() };
    let (mut arm, mut daemon) = (Some(emulator()), robot.process("daemon"));
    assert!(wait_until_served(&robot, &mut daemon), "no daemon: {}", daemon.output());
    let monitors = Monitors::watch(&robot.id);
    for round in 0..rounds {
        let outcome = (|| {
            if !start_motion(&robot)? || daemon.ended().is_some() {
                restart(&robot, &mut arm, &mut daemon, &emulator);
                return Ok(None);
            }
            std::thread::sleep(Duration::from_millis(random.random_range(0..600)));
            let moving = arm.as_ref().is_some_and(|arm| !at_rest(arm));
            let fault = draw(&mut random, kill);
            daemon.signal(if fault == Fault::Kill { "KILL" } else { "STOP" });
            let injected = Instant::now();
            let rests = || arm.as_ref().is_some_and(at_rest);
            if fault == Fault::Kill {
                std::thread::sleep(Duration::from_millis(60).saturating_sub(injected.elapsed()));
                check_stale(&monitors, injected)?;
                let rested = comes_to_rest(injected, rests).ok_or("the arm moves on without a daemon")?;
                // A robot that has stopped itself waits for its operator; another one stands for it that has been released.
                drop(arm.take());
                arm = Some(emulator());
                daemon = robot.process("daemon");
                let since = daemon.started;
                wait_until_served(&robot, &mut daemon);
                let up = Some(check_successor(&robot, since)?);
                return Ok(Some(Outcome {
                    continued: false,
                    up,
                    rest: Some(rested.as_secs_f64() * 1e3).filter(|_| moving),
                }));
            }
            let Fault::Suspend(ms) = fault else { unreachable!("the other fault") };
            let lasts = Duration::from_millis(ms);
            let rested = within(lasts, rests);
            std::thread::sleep(lasts.saturating_sub(injected.elapsed()));
            if lasts > Duration::from_millis(55) {
                check_stale(&monitors, injected)?;
            }
            daemon.signal("CONT");
            // It ends, stops, or turns for long enough; a loaded machine takes its time to show which.
            let (mut first, mut last) = (None, None);
            let settled = within(LIMIT, || {
                last = robot.status();
                let mut turned = |now: &Status| now.cycles >= *first.get_or_insert(now.cycles) + 400;
                daemon.ended().is_some()
                    || last.as_ref().is_some_and(|now| now.progress == Progress::Stopped || turned(now))
            });
            // A robot whose commands did not come has stopped by itself: the daemon says so and ends.
            if let Some(code) = daemon.ended() {
                let message = daemon.output();
                if code != 1 || !message.contains("the loop ended") {
                    return Err(format!("after {lasts:?} the daemon ended with {code}: {message}"));
                }
                within(Duration::from_secs(2), rests).ok_or("the arm moves although its daemon has ended")?;
                restart(&robot, &mut arm, &mut daemon, &emulator);
                let rest = rested.map(|rested| rested.as_secs_f64() * 1e3).filter(|_| moving);
                return Ok(Some(Outcome { continued: false, up: None, rest }));
            }
            let now = last.filter(|_| settled.is_some());
            let now = now.ok_or(format!("after {lasts:?} the daemon neither ends nor stops nor turns"))?;
            // Where the loop counts lost states, it stops and the status says why.
            if now.progress == Progress::Stopped {
                now.stopped.ok_or(format!("after {lasts:?} the arm is stopped without a reason"))?;
                within(Duration::from_secs(2), rests).ok_or("the arm moves although it was stopped")?;
                restart(&robot, &mut arm, &mut daemon, &emulator);
                return Ok(Some(Outcome::default()));
            }
            Ok(Some(Outcome { continued: true, ..Outcome::default() }))
        })();
        row.take(round, outcome);
        row.take_violations(round, &monitors);
    }
    (row.samples, row.torques) = monitors.end();
    row
}

pub fn emulators(rounds: u32, seed: u64, kill: bool) -> Row {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (robot, address) = emulated("kill-robot");
    let emulator = || {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command
            .args(["kill_campaign::franka::emulator_child", "--exact", "--nocapture"])
            .env(ADDRESS, address.to_string());
        let process = Process::start(command, &robot.place, "emulator");
        within(LIMIT, || std::net::TcpStream::connect((address, 1337)).is_ok()).expect("an emulator");
        process
    };
    let mut row = Row { name: format!("robot (emulator), {}", signals(kill)), ..Row::default() };
    let (mut arm, mut daemon) = (Some(emulator()), robot.process("daemon"));
    assert!(wait_until_served(&robot, &mut daemon), "no daemon: {}", daemon.output());
    let monitors = Monitors::watch(&robot.id);
    for round in 0..rounds {
        let outcome = (|| {
            if !start_motion(&robot)? {
                // The old one has to go before the new one can have its address.
                drop(arm.take());
                arm = Some(emulator());
                daemon = robot.process("daemon");
                wait_until_served(&robot, &mut daemon);
                return Ok(None);
            }
            std::thread::sleep(Duration::from_millis(random.random_range(0..600)));
            if daemon.ended().is_some() {
                // The old one has to go before the new one can have its address.
                drop(arm.take());
                arm = Some(emulator());
                daemon = robot.process("daemon");
                wait_until_served(&robot, &mut daemon);
                return Ok(None);
            }
            match draw(&mut random, kill) {
                Fault::Kill => arm.iter().for_each(|arm| arm.signal("KILL")),
                Fault::Suspend(ms) => {
                    arm.iter().for_each(|arm| arm.signal("STOP"));
                    std::thread::sleep(Duration::from_millis(ms));
                    arm.iter().for_each(|arm| arm.signal("CONT"));
                    let ended = within(Duration::from_millis(300), || daemon.ended().is_some()).is_some();
                    if !ended && robot.status().is_some_and(|now| now.progress == Progress::Driving) {
                        return Ok(Some(Outcome { continued: true, ..Outcome::default() }));
                    }
                }
            }
            // The daemon says what happened and ends; as a service it would be started again.
            within(LIMIT, || daemon.ended().is_some()).ok_or("the daemon does not notice")?;
            let message = daemon.output();
            if daemon.ended() != Some(1) || !message.contains("the loop ended") {
                return Err(format!("the daemon ended with {:?}: {message}", daemon.ended()));
            }
            drop(arm.take());
            arm = Some(emulator());
            daemon = robot.process("daemon");
            let since = daemon.started;
            wait_until_served(&robot, &mut daemon);
            Ok(Some(Outcome { up: Some(check_successor(&robot, since)?), ..Outcome::default() }))
        })();
        row.take(round, outcome);
        row.take_violations(round, &monitors);
    }
    (row.samples, row.torques) = monitors.end();
    row
}
