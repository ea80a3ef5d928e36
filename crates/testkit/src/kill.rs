//! Kill campaign: processes of a robot, monitors of its data, and times of the kills.

use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use crate::job::{Place, plumbline, signal};
pub use crate::wait::within;
use plumbline_ipc::{
    Client, Delivery, FeedForwardClient, FeedForwardSettings, Progress, Request, Response, RobotId, SampleStream,
    Status, StreamSettings,
};

/// Longest wait for any step of a round.
pub const LIMIT: Duration = Duration::from_secs(30);
pub const RESTART: Duration = Duration::from_secs(2);

/// A child process, killed on drop. Its output is written to a file.
pub struct Process {
    child: Child,
    pub log: std::path::PathBuf,
    pub started: Instant,
}

impl Process {
    pub fn start(mut command: Command, place: &Place, name: &str) -> Process {
        let log = place.path().join(format!("{name}.log"));
        let file = std::fs::File::create(&log).unwrap();
        let child = command.stdin(Stdio::null()).stdout(file.try_clone().unwrap()).stderr(file).spawn().unwrap();
        Process { child, log, started: Instant::now() }
    }

    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    pub fn signal(&self, name: &str) {
        signal(self.pid(), name);
    }

    /// Exit code, if it has ended; -1 for a signal.
    pub fn ended(&mut self) -> Option<i32> {
        self.child.try_wait().unwrap().map(|status| status.code().unwrap_or(-1))
    }

    pub fn output(&self) -> String {
        std::fs::read_to_string(&self.log).unwrap_or_default()
    }

    /// Sends SIGKILL and waits for the end.
    pub fn kill(mut self) {
        self.kill_now();
    }

    fn kill_now(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        self.kill_now();
    }
}

/// One robot under test: its name, its folder, and how its daemon is started.
pub struct Robot {
    pub place: Place,
    pub id: RobotId,
    config: String,
    sets: Vec<String>,
}

impl Robot {
    pub fn new(name: &str, config: &str, sets: &[&str]) -> Robot {
        let place = Place::new(name);
        let id = RobotId::parse("test", "robot", &place.id).unwrap();
        Robot { id, place, config: config.to_string(), sets: sets.iter().map(|set| set.to_string()).collect() }
    }

    pub fn process(&self, subcommand: &str) -> Process {
        let mut command = plumbline();
        command.arg(subcommand).arg(&self.config).arg("--out").arg(self.place.out());
        command.arg("--set").arg(format!("serve.id={}", self.id));
        for set in &self.sets {
            command.arg("--set").arg(set);
        }
        Process::start(command, &self.place, subcommand)
    }

    pub fn torque_client(&self) -> Process {
        let mut command = plumbline();
        command.args(["torque", "--follow", "--rate", "500", "--robot", self.id.as_str()]);
        Process::start(command, &self.place, "torque")
    }

    pub fn ask(&self, request: &Request) -> Option<Response> {
        let mut client = Client::connect(&self.id, Duration::from_millis(200)).ok()?;
        client.send(request, Duration::from_secs(5)).ok()
    }

    pub fn status(&self) -> Option<Status> {
        match self.ask(&Request::Status {})? {
            Response::Status(status) => Some(*status),
            _ => None,
        }
    }
}

pub type Violations = Arc<Mutex<Vec<String>>>;

/// Two monitor threads: one reads every sample, one the newest torque.
pub struct Monitors {
    stop: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    pub violations: Violations,
    pub samples: Arc<AtomicU64>,
    pub torques: Arc<AtomicU64>,
    pub stale: Arc<AtomicBool>,
}

impl Monitors {
    /// Starts the monitors of a robot with a daemon.
    pub fn watch(id: &RobotId) -> Monitors {
        let stop = Arc::new(AtomicBool::new(false));
        let violations: Violations = Arc::default();
        let (samples, torques) = (Arc::new(AtomicU64::new(0)), Arc::new(AtomicU64::new(0)));
        let stale = Arc::new(AtomicBool::new(false));
        let (robot, done, found, count) = (id.clone(), stop.clone(), violations.clone(), samples.clone());
        let follower = std::thread::spawn(move || follow_samples(&robot, &done, &found, &count));
        let (robot, done, found, count, old) =
            (id.clone(), stop.clone(), violations.clone(), torques.clone(), stale.clone());
        let reader = std::thread::spawn(move || follow_torque(&robot, &done, &found, &count, &old));
        Monitors { stop, threads: vec![follower, reader], violations, samples, torques, stale }
    }

    pub fn end(self) -> (u64, u64) {
        self.stop.store(true, Ordering::Relaxed);
        for thread in self.threads {
            thread.join().unwrap();
        }
        (self.samples.load(Ordering::Relaxed), self.torques.load(Ordering::Relaxed))
    }
}

/// Checks that every record arrives exactly once and in order, over all starts of the daemon.
fn follow_samples(robot: &RobotId, stop: &AtomicBool, violations: &Violations, count: &AtomicU64) {
    let settings = StreamSettings { name: "monitor".into(), ..StreamSettings::default() };
    let mut stream = SampleStream::connect(robot, settings, LIMIT).unwrap();
    let (mut next, mut cycle) = (stream.position(), None);
    let report = |words: String| violations.lock().unwrap().push(words);
    while !stop.load(Ordering::Relaxed) {
        match stream.next(Duration::from_millis(50)) {
            Ok(Delivery::Records { first, records }) => {
                if first != next {
                    report(format!("sample {first} came where {next} was due"));
                }
                for record in &records {
                    // Cycle numbers increase within a connection and restart with a new one.
                    if cycle.is_some_and(|last| record.cycle <= last && record.cycle > 1) {
                        report(format!("cycle {} came after {cycle:?}", record.cycle));
                    }
                    cycle = Some(record.cycle);
                }
                next = first + records.len() as u64;
                count.fetch_add(records.len() as u64, Ordering::Relaxed);
            }
            Ok(Delivery::Missed { from, to }) => {
                report(format!("samples {from} to {to} are gone"));
                next = to;
            }
            Ok(Delivery::Restarted { .. }) => (next, cycle) = (0, None),
            Ok(Delivery::Idle | Delivery::Gone) => {}
            Err(error) => report(error.to_string()),
        }
    }
}

/// Checks the newest torque: sequence numbers increase within a start, and a value not marked stale is younger than the limit.
fn follow_torque(robot: &RobotId, stop: &AtomicBool, violations: &Violations, count: &AtomicU64, stale: &AtomicBool) {
    let settings = FeedForwardSettings::default();
    let mut client = FeedForwardClient::connect(robot, settings, LIMIT).unwrap();
    let mut last = (0, 0);
    while !stop.load(Ordering::Relaxed) {
        match client.latest() {
            Ok(Some(latest)) => {
                let now = (latest.message.epoch, latest.message.sequence);
                // The clock is read again, because this process may have been suspended.
                let age = plumbline_ipc::boot_ns().saturating_sub(latest.message.stamp_ns);
                let slack = 50_000_000;
                if !latest.stale && age > settings.stale_after_ms * 1_000_000 + slack {
                    violations.lock().unwrap().push(format!("a torque of {age} ns age was not marked"));
                }
                if now.0 == last.0 && now.1 < last.1 || now.0 < last.0 {
                    violations.lock().unwrap().push(format!("torque {now:?} came after {last:?}"));
                }
                if now != last {
                    count.fetch_add(1, Ordering::Relaxed);
                }
                last = now;
                stale.store(latest.stale, Ordering::Relaxed);
            }
            Ok(None) => stale.store(true, Ordering::Relaxed),
            Err(error) => violations.lock().unwrap().push(error.to_string()),
        }
        std::thread::sleep(Duration::from_micros(700));
    }
}

/// Lines of `plumbline torque` with a stale value that is not marked.
pub fn unmarked(lines: &str) -> Vec<String> {
    let age = |line: &str| line.split("age").nth(1)?.split_whitespace().next()?.parse::<f64>().ok();
    let old = |line: &&str| age(line).is_some_and(|age| age > 5.0);
    lines
        .lines()
        .filter(old)
        .filter(|line| !line.contains("STALE") && !line.contains("GONE"))
        .map(str::to_string)
        .collect()
}

/// Whether the robot's programme is running.
pub fn driving(status: &Status) -> bool {
    status.progress == Progress::Driving && status.motion != 0
}
