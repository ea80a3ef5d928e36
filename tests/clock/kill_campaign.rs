//! SIGKILL, and SIGSTOP with SIGCONT, at random moments of a motion: estimator, torque client, daemon, and the robot itself (the emulator of
//! Franka's control unit). The arm goes on or stops by its rule, the successor is up in time and finds nothing stale, no sample that was
//! delivered is lost, and nobody reads an old torque without knowing.
//!
//! A few of each run with the tests; `hil/kill-campaign/run.sh` plays a hundred of each and writes the tables of docs/results/campaigns.md.

use plumbline_testkit::emulator;
use std::fmt::Write as _;
use std::net::IpAddr;
use std::process::Command;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use plumbline_core::Phase;
use plumbline_franka::wire::Protocol;
use plumbline_ipc::{Progress, Request, Response};
use plumbline_testkit::kill::*;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

const ADDRESS: &str = "PLUMBLINE_TEST_EMULATOR";
/// A programme that does not end while things are killed.
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
/// Measured speed of an arm at rest, noise included \[rad/s\].
const AT_REST: f64 = 0.02;
static ONE_AT_A_TIME: Mutex<()> = Mutex::new(());

/// Not a test of its own: the emulator's process, which the campaign kills. Without an address there is nothing to do.
#[test]
fn emulator_child() {
    let Ok(address) = std::env::var(ADDRESS) else { return };
    let address: IpAddr = address.parse().unwrap();
    let settings = emulator::Settings::new(address, Protocol::V5);
    let patience = Duration::from_millis(10);
    let _emulator = emulator::Emulator::start(emulator::Settings { patience, ..settings }).unwrap();
    loop {
        std::thread::sleep(Duration::from_secs(60));
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Blow {
    Kill,
    /// SIGSTOP, and SIGCONT after this many milliseconds.
    Stop(u64),
}

#[derive(Debug, Default)]
struct Outcome {
    /// Whether the motion went on; otherwise it ended, by rule.
    went_on: bool,
    /// How long the successor took \[ms\].
    up: Option<f64>,
    /// When the arm was at rest after the blow, by the arm's own states \[ms\].
    rest: Option<f64>,
}

#[derive(Default)]
struct Row {
    name: String,
    went_on: u32,
    stopped: u32,
    void: u32,
    up: Vec<f64>,
    rest: Vec<f64>,
    samples: u64,
    torques: u64,
    broken: Vec<String>,
}

impl Row {
    fn take(&mut self, round: u32, outcome: Result<Option<Outcome>, String>) {
        match outcome {
            Ok(None) => self.void += 1,
            Ok(Some(Outcome { went_on, up, rest })) => {
                *(if went_on { &mut self.went_on } else { &mut self.stopped }) += 1;
                self.up.extend(up);
                self.rest.extend(rest);
            }
            Err(broken) => self.broken.push(format!("round {round}: {broken}")),
        }
    }

    fn line(&self) -> String {
        let times = |of: &[f64]| {
            let mut of = of.to_vec();
            of.sort_by(f64::total_cmp);
            let at = |share: f64| of.get(((of.len() - 1) as f64 * share) as usize).copied().unwrap_or(f64::NAN);
            if of.is_empty() { "-".into() } else { format!("{:.0} / {:.0}", at(0.5), at(1.0)) }
        };
        let (rest, up) = (times(&self.rest), times(&self.up));
        format!(
            "| {} | {} | {} | {} | {rest} | {up} | {} | {} | {} |",
            self.name,
            self.went_on + self.stopped,
            self.went_on,
            self.stopped,
            self.samples,
            self.torques,
            self.broken.len()
        )
    }
}

fn blow(random: &mut ChaCha8Rng, kill: bool) -> Blow {
    if kill { Blow::Kill } else { Blow::Stop(random.random_range(1..1500)) }
}

/// Starts the programme where it does not run; `false` when this machine would not let it.
fn set_in_motion(robot: &Robot) -> Result<bool, String> {
    let answered = within(PATIENCE, || robot.status().is_some());
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
fn comes_up_holding(robot: &Robot, since: Instant) -> Result<f64, String> {
    within(PATIENCE, || robot.status().is_some()).ok_or("no successor answers")?;
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

/// A simulated arm that keeps wall-clock time, with whatever is killed beside it.
fn simulated(name: &str) -> Robot {
    let mut sets = LONG.to_vec();
    sets.extend(["backend.arm=arms/sim-panda.toml", "backend.pace=wall-clock", "validation.counter-experiment=false"]);
    // A machine that stands still for a moment is not what is tried here.
    sets.push("safety.max-lost=200");
    Robot::new(name, plumbline_testkit::job::WALL, &sets)
}

fn estimators(rounds: u32, seed: u64, kill: bool) -> Row {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let robot = simulated("kill-estimator");
    let mut row = Row { name: format!("estimator, {}", word(kill)), ..Row::default() };
    let mut daemon = robot.process("daemon");
    within(PATIENCE, || robot.status().is_some()).expect("a daemon");
    let witnesses = Witnesses::watch(&robot.id);
    let mut estimator = robot.process("estimator");
    for round in 0..rounds {
        if daemon.ended().is_some() || robot.status().is_some_and(|now| now.progress == Progress::Stopped) {
            daemon.kill();
            daemon = robot.process("daemon");
        }
        let outcome = (|| {
            if !set_in_motion(&robot)? {
                return Ok(None);
            }
            within(PATIENCE, || followed_by(&robot, estimator.pid())).ok_or("the estimator does not follow")?;
            std::thread::sleep(Duration::from_millis(random.random_range(0..600)));
            let mut up = None;
            match blow(&mut random, kill) {
                Blow::Kill => {
                    estimator.signal("KILL");
                    estimator = robot.process("estimator");
                    let took =
                        within(PATIENCE, || followed_by(&robot, estimator.pid())).ok_or("no successor follows")?;
                    up = Some(took.as_secs_f64() * 1e3);
                }
                Blow::Stop(ms) => {
                    estimator.signal("STOP");
                    std::thread::sleep(Duration::from_millis(ms));
                    estimator.signal("CONT");
                }
            }
            // It has, or fetches, everything that was published.
            let published = robot.status().ok_or("the daemon does not answer")?.served.published;
            within(PATIENCE, || acknowledged(&robot, estimator.pid()) >= published).ok_or("samples do not arrive")?;
            let now = robot.status().ok_or("the daemon does not answer")?;
            if now.served.given_up_unacknowledged > 0 {
                return Err(format!("{} samples given up", now.served.given_up_unacknowledged));
            }
            Ok(Some(Outcome { went_on: driving(&now), up, rest: None }))
        })();
        row.take(round, outcome);
        complaints(&mut row, round, &witnesses);
    }
    if row.stopped > 0 {
        row.broken.push(format!("the arm stopped {} times, although the rule is `finish`", row.stopped));
    }
    (row.samples, row.torques) = witnesses.end();
    row
}

fn clients(rounds: u32, seed: u64, kill: bool) -> Row {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let robot = simulated("kill-client");
    let mut row = Row { name: format!("torque client, {}", word(kill)), ..Row::default() };
    let _daemon = robot.process("daemon");
    within(PATIENCE, || robot.status().is_some()).expect("a daemon");
    let witnesses = Witnesses::watch(&robot.id);
    let mut client = robot.torque_client();
    for round in 0..rounds {
        let outcome = (|| {
            if !set_in_motion(&robot)? {
                return Ok(None);
            }
            within(PATIENCE, || client.output().lines().count() > 2).ok_or("the client says nothing")?;
            std::thread::sleep(Duration::from_millis(random.random_range(0..400)));
            let mut up = None;
            match blow(&mut random, kill) {
                Blow::Kill => {
                    client.signal("KILL");
                    let message = client.output();
                    no_unmarked(&message)?;
                    client = robot.torque_client();
                    let took = within(PATIENCE, || client.output().contains("tau_ff")).ok_or("no successor reads")?;
                    up = Some(took.as_secs_f64() * 1e3);
                }
                Blow::Stop(ms) => {
                    client.signal("STOP");
                    std::thread::sleep(Duration::from_millis(ms));
                    let before = client.output().lines().count();
                    client.signal("CONT");
                    within(PATIENCE, || client.output().lines().count() > before + 3)
                        .ok_or("the client does not go on")?;
                    no_unmarked(&client.output())?;
                }
            }
            let now = robot.status().ok_or("the daemon does not answer")?;
            Ok(Some(Outcome { went_on: driving(&now), up, rest: None }))
        })();
        row.take(round, outcome);
        complaints(&mut row, round, &witnesses);
    }
    if row.stopped > 0 {
        row.broken.push(format!("the arm stopped {} times because of a client", row.stopped));
    }
    (row.samples, row.torques) = witnesses.end();
    row
}

/// The arm is the emulator's: it is there after the daemon's death, and says itself whether it moves.
fn daemons(rounds: u32, seed: u64, kill: bool) -> Row {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (robot, address) = behind_fci("kill-daemon");
    let settings =
        emulator::Settings { patience: Duration::from_millis(10), ..emulator::Settings::new(address, Protocol::V5) };
    let emulator = || emulator::Emulator::start(settings.clone()).unwrap();
    let mut row = Row { name: format!("daemon, {}", word(kill)), ..Row::default() };
    let (mut arm, mut daemon) = (Some(emulator()), robot.process("daemon"));
    assert!(serves(&robot, &mut daemon), "no daemon: {}", daemon.output());
    let witnesses = Witnesses::watch(&robot.id);
    for round in 0..rounds {
        let outcome = (|| {
            if !set_in_motion(&robot)? || daemon.ended().is_some() {
                anew(&robot, &mut arm, &mut daemon, &emulator);
                return Ok(None);
            }
            std::thread::sleep(Duration::from_millis(random.random_range(0..600)));
            let moving = arm.as_ref().is_some_and(|arm| !at_rest(arm));
            let blow = blow(&mut random, kill);
            daemon.signal(if blow == Blow::Kill { "KILL" } else { "STOP" });
            let struck = Instant::now();
            let rests = || arm.as_ref().is_some_and(at_rest);
            if blow == Blow::Kill {
                let rested = within(Duration::from_secs(2), rests).ok_or("the arm goes on without a daemon")?;
                std::thread::sleep(Duration::from_millis(60).saturating_sub(struck.elapsed()));
                stale(&witnesses, struck)?;
                if !rests() {
                    return Err("the arm moves again without a daemon".into());
                }
                // A robot that has stopped itself waits for its operator; another one stands for it that has been released.
                drop(arm.take());
                arm = Some(emulator());
                daemon = robot.process("daemon");
                let since = daemon.started;
                serves(&robot, &mut daemon);
                let up = Some(comes_up_holding(&robot, since)?);
                return Ok(Some(Outcome {
                    went_on: false,
                    up,
                    rest: Some(rested.as_secs_f64() * 1e3).filter(|_| moving),
                }));
            }
            let Blow::Stop(ms) = blow else { unreachable!("the other blow") };
            let lasts = Duration::from_millis(ms);
            let rested = within(lasts, rests);
            std::thread::sleep(lasts.saturating_sub(struck.elapsed()));
            if lasts > Duration::from_millis(55) {
                stale(&witnesses, struck)?;
            }
            daemon.signal("CONT");
            let over = within(Duration::from_millis(400), || {
                daemon.ended().is_some() || robot.status().is_some_and(|now| now.progress == Progress::Stopped)
            });
            // A robot whose commands did not come has stopped by itself: the daemon says so and ends.
            if let Some(code) = daemon.ended() {
                let message = daemon.output();
                if code != 1 || !message.contains("the loop ended") {
                    return Err(format!("after {lasts:?} the daemon ended with {code}: {message}"));
                }
                within(Duration::from_secs(2), rests).ok_or("the arm moves although its daemon has ended")?;
                anew(&robot, &mut arm, &mut daemon, &emulator);
                let rest = rested.map(|rested| rested.as_secs_f64() * 1e3).filter(|_| moving);
                return Ok(Some(Outcome { went_on: false, up: None, rest }));
            }
            let now = robot.status().ok_or("the daemon does not answer after SIGCONT")?;
            if over.is_some() {
                // Where the loop counts lost states, it stops and the status says why.
                now.stopped.ok_or(format!("after {lasts:?} the arm is {:?} without a reason", now.progress))?;
                within(Duration::from_secs(2), rests).ok_or("the arm moves although it was stopped")?;
                anew(&robot, &mut arm, &mut daemon, &emulator);
                return Ok(Some(Outcome::default()));
            }
            let more = within(Duration::from_secs(2), || robot.status().is_some_and(|later| later.cycles > now.cycles));
            more.ok_or(format!("after {lasts:?} the loop neither stops nor turns"))?;
            Ok(Some(Outcome { went_on: true, ..Outcome::default() }))
        })();
        row.take(round, outcome);
        complaints(&mut row, round, &witnesses);
    }
    (row.samples, row.torques) = witnesses.end();
    row
}

/// The torque is known to be stale; the witness's own thread may be late by a slice of this machine's time.
fn stale(witnesses: &Witnesses, struck: Instant) -> Result<(), String> {
    within(Duration::from_millis(50), || witnesses.stale.load(std::sync::atomic::Ordering::Relaxed))
        .map(drop)
        .ok_or_else(|| format!("{:?} after the blow the torque is not stale", struck.elapsed()))
}

/// A robot and a daemon for the next round. The old ones have to go before the new ones can have their address.
fn anew(
    robot: &Robot,
    arm: &mut Option<emulator::Emulator>,
    daemon: &mut Process,
    emulator: &impl Fn() -> emulator::Emulator,
) {
    if daemon.ended().is_none() {
        daemon.signal("KILL");
        within(PATIENCE, || daemon.ended().is_some());
    }
    drop(arm.take());
    *arm = Some(emulator());
    *daemon = robot.process("daemon");
    serves(robot, daemon);
}

/// A robot that the emulator stands for, and its address.
fn behind_fci(name: &str) -> (Robot, IpAddr) {
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

fn emulators(rounds: u32, seed: u64, kill: bool) -> Row {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let (robot, address) = behind_fci("kill-robot");
    let emulator = || {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["kill_campaign::emulator_child", "--exact", "--nocapture"]).env(ADDRESS, address.to_string());
        let process = Process::start(command, &robot.place, "emulator");
        within(PATIENCE, || std::net::TcpStream::connect((address, 1337)).is_ok()).expect("an emulator");
        process
    };
    let mut row = Row { name: format!("robot (emulator), {}", word(kill)), ..Row::default() };
    let (mut arm, mut daemon) = (Some(emulator()), robot.process("daemon"));
    assert!(serves(&robot, &mut daemon), "no daemon: {}", daemon.output());
    let witnesses = Witnesses::watch(&robot.id);
    for round in 0..rounds {
        let outcome = (|| {
            if !set_in_motion(&robot)? {
                // The old one has to go before the new one can have its address.
                drop(arm.take());
                arm = Some(emulator());
                daemon = robot.process("daemon");
                serves(&robot, &mut daemon);
                return Ok(None);
            }
            std::thread::sleep(Duration::from_millis(random.random_range(0..600)));
            if daemon.ended().is_some() {
                // The old one has to go before the new one can have its address.
                drop(arm.take());
                arm = Some(emulator());
                daemon = robot.process("daemon");
                serves(&robot, &mut daemon);
                return Ok(None);
            }
            match blow(&mut random, kill) {
                Blow::Kill => arm.iter().for_each(|arm| arm.signal("KILL")),
                Blow::Stop(ms) => {
                    arm.iter().for_each(|arm| arm.signal("STOP"));
                    std::thread::sleep(Duration::from_millis(ms));
                    arm.iter().for_each(|arm| arm.signal("CONT"));
                    if within(Duration::from_millis(300), || daemon.ended().is_some()).is_none() {
                        let now = robot.status().ok_or("the daemon does not answer")?;
                        if now.progress == Progress::Driving {
                            return Ok(Some(Outcome { went_on: true, ..Outcome::default() }));
                        }
                    }
                }
            }
            // The daemon says what happened and ends; as a service it would be started again.
            within(PATIENCE, || daemon.ended().is_some()).ok_or("the daemon does not notice")?;
            let message = daemon.output();
            if daemon.ended() != Some(1) || !message.contains("the loop ended") {
                return Err(format!("the daemon ended with {:?}: {message}", daemon.ended()));
            }
            drop(arm.take());
            arm = Some(emulator());
            daemon = robot.process("daemon");
            let since = daemon.started;
            serves(&robot, &mut daemon);
            Ok(Some(Outcome { up: Some(comes_up_holding(&robot, since)?), ..Outcome::default() }))
        })();
        row.take(round, outcome);
        complaints(&mut row, round, &witnesses);
    }
    (row.samples, row.torques) = witnesses.end();
    row
}

/// Waits until the robot is served; a daemon that finds the robot busy ends, and is started again as a service would be.
fn serves(robot: &Robot, daemon: &mut Process) -> bool {
    let served = within(PATIENCE, || {
        if daemon.ended().is_some() {
            *daemon = robot.process("daemon");
        }
        robot.status().is_some()
    });
    served.is_some()
}

fn word(kill: bool) -> &'static str {
    if kill { "SIGKILL" } else { "SIGSTOP, SIGCONT" }
}

fn followed_by(robot: &Robot, pid: u32) -> bool {
    robot.status().is_some_and(|now| now.served.followers.iter().any(|follower| follower.pid == pid))
}

fn acknowledged(robot: &Robot, pid: u32) -> u64 {
    let of = |status: plumbline_ipc::Status| status.served.followers.into_iter().find(|follower| follower.pid == pid);
    robot.status().and_then(of).map_or(0, |follower| follower.acknowledged)
}

fn no_unmarked(message: &str) -> Result<(), String> {
    match unmarked(message).first() {
        Some(line) => Err(format!("an old torque was printed without a mark: {line}")),
        None => Ok(()),
    }
}

/// What the witnesses have seen since the round before.
fn complaints(row: &mut Row, round: u32, witnesses: &Witnesses) {
    let found = std::mem::take(&mut *witnesses.complaints.lock().unwrap_or_else(PoisonError::into_inner));
    row.broken.extend(found.into_iter().map(|words| format!("round {round}: {words}")));
}

/// The load average over five minutes, as the kernel prints it.
fn load() -> String {
    let text = std::fs::read_to_string("/proc/loadavg").unwrap_or_default();
    text.split_whitespace().nth(1).unwrap_or("unknown").to_string()
}

/// All kinds of blows, `rounds` each.
fn campaign(rounds: u32, seed: u64) -> Vec<Row> {
    let _turn = ONE_AT_A_TIME.lock().unwrap_or_else(PoisonError::into_inner);
    let kinds: [fn(u32, u64, bool) -> Row; 4] = [estimators, clients, daemons, emulators];
    // `ONLY=3` plays the robot alone.
    let only = std::env::var("ONLY").ok();
    let mut rows = Vec::new();
    for (kind, number) in kinds.into_iter().zip(0u64..) {
        if only.as_ref().is_some_and(|only| *only != number.to_string()) {
            continue;
        }
        for kill in [true, false] {
            let row = kind(rounds, seed + 2 * number + u64::from(kill), kill);
            eprintln!("{}", row.line());
            row.broken.iter().for_each(|broken| eprintln!("    {broken}"));
            rows.push(row);
        }
    }
    rows
}

#[test]
fn a_few_of_each() {
    for row in campaign(1, 1) {
        assert!(row.broken.is_empty(), "{}: {:#?}", row.name, row.broken);
        assert!(row.went_on + row.stopped > 0, "{}: this machine let no round count", row.name);
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
            row.broken.push(format!("{slow} of {} successors took longer than {RESTART:?}", row.up.len()));
        }
    }
    let mut text = format!(
        "{rounds} of each kind, seeds {seed} to {}. Load of the machine before and after: {before}, {}; it has {} processors.\n\n\
         | killed | counted | the motion went on | the motion ended, by rule | the arm at rest after, median / worst \\[ms\\] | successor up, median / worst \\[ms\\] | samples witnessed, none \
         lost or twice | torques witnessed | promises broken |\n|---|---|---|---|---|---|---|---|---|\n",
        seed + 7,
        load(),
        std::thread::available_parallelism().map_or(0, usize::from)
    );
    for row in &rows {
        writeln!(text, "{}", row.line()).unwrap();
    }
    if rows.iter().any(|row| row.void > 0 || !row.broken.is_empty()) {
        text.push('\n');
    }
    for row in &rows {
        for broken in &row.broken {
            writeln!(text, "- {}: {broken}", row.name).unwrap();
        }
        if row.void > 0 {
            writeln!(
                text,
                "- {}: {} rounds did not count, for this machine stopped the motion before the blow.",
                row.name, row.void
            )
            .unwrap();
        }
    }
    let block = std::env::var("ONLY").map_or("kills".to_string(), |only| format!("kills-{only}"));
    plumbline_testkit::page::write_block("docs/results/campaigns.md", &block, &text);
    assert!(rows.iter().all(|row| row.broken.is_empty()));
}
