//! Fixtures for tests of the whole program: the binary, a separate job per test, true parameter values.

use std::borrow::BorrowMut;
use std::collections::BTreeMap;
use std::ffi::OsString;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

pub use crate::wait::{TIMEOUT, wait_for};
use nalgebra::DVector;
use plumbline::report::Report;
use plumbline_core::Phase;
use plumbline_ipc::{Client, Progress, Request, Response, RobotId, Status};
use plumbline_model::{Reduction, Robot};
use plumbline_sim::Truth;
use tempfile::TempDir;

pub const WALL: &str = "config/sim-panda-wall.toml";

/// The shipped job with an arm without undeclared effects, and one identification motion.
pub const PLAIN: [&str; 2] = ["backend.arm=arms/sim-panda.toml", "excitation.trajectories=1"];

/// Overrides that make the shipped job short: 4 s periods, few of them, a coarse search, no counter-experiment.
pub const SHORT: [&str; 8] = [
    "excitation.period=4 s",
    "excitation.periods=3",
    "excitation.starts=1",
    "excitation.rounds=0",
    "validation.trajectories=1",
    "validation.counter-experiment=false",
    "output.dataset=false",
    "diagnosis.enabled=false",
];

/// The program that was built beside the test, benchmark or example that runs.
///
/// # Panics
/// A missing program; Cargo builds it for the tests of its package.
pub fn program() -> PathBuf {
    let test = std::env::current_exe().unwrap();
    let built = test.ancestors().skip(1).map(|folder| folder.join("plumbline")).find(|path| path.is_file());
    built.unwrap_or_else(|| panic!("no `plumbline` in the folders above {}", test.display()))
}

/// The program, run from the project's folder. A test run under `nohup` would hand an ignored SIGHUP on to it.
pub fn plumbline() -> Command {
    let mut command = Command::new("env");
    command.arg("--default-signal=HUP").arg(program());
    command.current_dir(crate::ROOT).env_remove("PLUMBLINE_LOG").stdin(Stdio::null());
    command
}

/// A separate folder and robot of one test, so that tests can run in parallel.
pub struct Place {
    /// Name of the robot in shared memory.
    pub id: String,
    dir: TempDir,
    planned_for: Mutex<Option<String>>,
}

/// Files of plans with their names, by what they depend on. The first test of a program that needs them has them planned, the others find them as an
/// earlier run has left them: the same search takes seconds each time. The program checks that they belong to its job.
static PLANS: Mutex<BTreeMap<String, Files>> = Mutex::new(BTreeMap::new());

type Files = Vec<(OsString, Vec<u8>)>;

/// The overrides that plans may depend on.
const PLANNED_BY: [&str; 6] = ["excitation.", "validation.", "limits.", "workspace.", "mounting=", "robot="];

/// Overrides that repeat the motions of plans.
const REPEATED_BY: [&str; 3] = ["excitation.periods=", "excitation.lead-in=", "validation.periods="];

impl Place {
    pub fn new(test: &str) -> Place {
        let id = format!("test-{test}-{}", std::process::id());
        Place { id, dir: tempfile::tempdir().unwrap(), planned_for: Mutex::new(None) }
    }

    /// Copies the plans of a job with these overrides into the folder of the results, where an earlier test has planned them.
    pub fn reuse_plans(&self, job: &str, sets: &[&str]) {
        let own = sets.iter().filter(|set| PLANNED_BY.iter().any(|key| set.starts_with(key)));
        let own = own.filter(|set| !REPEATED_BY.iter().any(|key| set.starts_with(key)));
        let key = own.fold(job.to_string(), |key, set| format!("{key} {set}"));
        let plans = self.out().join("plans");
        if let Some(files) = PLANS.lock().unwrap().get(&key).filter(|_| !plans.exists()) {
            std::fs::create_dir_all(&plans).unwrap();
            files.iter().for_each(|(name, bytes)| std::fs::write(plans.join(name), bytes).unwrap());
        }
        *self.planned_for.lock().unwrap() = Some(key);
    }

    pub fn path(&self) -> &Path {
        self.dir.path()
    }

    pub fn out(&self) -> PathBuf {
        self.dir.path().join("out")
    }

    /// `plumbline SUBCOMMAND JOB --out ... --set ...` for this place's robot; later overrides win.
    pub fn job(&self, subcommand: &str, sets: &[&str]) -> Command {
        let sets: Vec<&str> = PLAIN.iter().chain(sets).copied().collect();
        self.reuse_plans(WALL, &sets);
        let mut command = plumbline();
        command.arg(subcommand).arg(WALL).arg("--out").arg(self.out());
        command.arg("--set").arg(format!("serve.id={}", self.id));
        if subcommand == "run" {
            command.arg("--verbose");
        }
        sets.iter().for_each(|set| {
            command.arg("--set").arg(set);
        });
        command
    }

    /// `plumbline run` to its end.
    pub fn run(&self, sets: &[&str]) -> Done {
        Done::of(self.job("run", sets))
    }

    /// `plumbline command WHAT` for this place's robot.
    pub fn command(&self, what: &str) -> Done {
        let mut command = plumbline();
        command.args(["command", what, "--robot", &self.id]);
        Done::of(command)
    }

    /// The daemon's status, if it responds: as `plumbline command status`, without a process for every poll.
    pub fn status(&self) -> Option<Status> {
        let robot = RobotId::parse("test", "robot", &self.id).unwrap();
        let mut client = Client::connect_operator(&robot, Duration::from_millis(500)).ok()?;
        match client.send(&Request::Status {}, Duration::from_secs(2)).ok()? {
            Response::Status(status) => Some(*status),
            _ => None,
        }
    }

    #[track_caller]
    pub fn daemon(&self, sets: &[&str]) -> Running {
        let daemon = Running::start(self.job("daemon", sets));
        wait_for("the daemon", || self.status());
        daemon
    }

    /// Waits until the programme moves the arm: to the start of its first motion, which takes seconds, or along it.
    #[track_caller]
    pub fn await_motion(&self) {
        let moves =
            |now: &Status| now.progress == Progress::Driving && matches!(now.phase, Phase::Approach | Phase::Excite);
        wait_for("motion", || self.status().filter(moves));
    }

    /// Ends the daemon by command.
    #[track_caller]
    pub fn quit(&self, daemon: Running) -> Done {
        self.command("quit").expect_code(0);
        daemon.end().expect_code(0)
    }

    pub fn report(&self) -> Report {
        let text = std::fs::read_to_string(self.out().join("report.json")).unwrap();
        serde_json::from_str(&text).unwrap()
    }

    /// Every file below the folder, relative to it, in order.
    pub fn files(&self) -> Vec<PathBuf> {
        let mut found = Vec::new();
        let mut folders = vec![self.path().to_path_buf()];
        while let Some(folder) = folders.pop() {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() {
                    folders.push(path)
                } else {
                    found.push(path.strip_prefix(self.path()).unwrap().into())
                }
            }
        }
        found.sort();
        found
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let (plans, key) = (self.out().join("plans"), self.planned_for.lock().unwrap().take());
        let Some(key) = key.filter(|_| plans.join("planned-for").is_file() && !std::thread::panicking()) else {
            return;
        };
        let file = |path: PathBuf| Some((path.file_name()?.to_owned(), std::fs::read(&path).ok()?));
        let files = std::fs::read_dir(plans).into_iter().flatten().filter_map(|entry| file(entry.ok()?.path()));
        PLANS.lock().unwrap().entry(key).or_insert_with(|| files.collect());
    }
}

/// A motion of many minutes at the pace of the clock; a test machine that stalls does not end it.
pub const LONG_ON_CLOCK: [&str; 4] =
    ["backend.pace=wall-clock", "realtime.lock-memory=false", "safety.max-lost=1000", "excitation.periods=100"];

/// `SHORT` with more overrides behind it.
pub fn short<'a>(more: &[&'a str]) -> Vec<&'a str> {
    SHORT.iter().copied().chain(more.iter().copied()).collect()
}

#[derive(Debug)]
pub struct Done {
    pub code: Option<i32>,
    pub out: String,
    pub err: String,
}

impl Done {
    pub fn of(mut command: impl BorrowMut<Command>) -> Done {
        Done::from(command.borrow_mut().output().unwrap())
    }

    /// All output, for the message of a failed assertion.
    pub fn output(&self) -> String {
        format!("exit code {:?}\n--- stdout\n{}--- stderr\n{}", self.code, self.out, self.err)
    }

    #[track_caller]
    pub fn expect_code(self, code: i32) -> Done {
        assert_eq!(self.code, Some(code), "{}", self.output());
        self
    }
}

impl From<Output> for Done {
    fn from(output: Output) -> Done {
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        Done { code: output.status.code(), out: text(output.stdout), err: text(output.stderr) }
    }
}

/// A process of the test, killed on drop.
pub struct Running(Option<Process>);

struct Process {
    child: Child,
    out: Capture,
    err: Capture,
}

impl Running {
    pub fn start(mut command: impl BorrowMut<Command>) -> Running {
        let mut child = command.borrow_mut().stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let (out, err) =
            (Capture::through(child.stdout.take().unwrap()), Capture::through(child.stderr.take().unwrap()));
        Running(Some(Process { child, out, err }))
    }

    pub fn pid(&self) -> u32 {
        self.0.as_ref().unwrap().child.id()
    }

    pub fn runs(&mut self) -> bool {
        self.0.as_mut().unwrap().child.try_wait().unwrap().is_none()
    }

    /// Waits for its end, at most [`TIMEOUT`].
    pub fn end(mut self) -> Done {
        let start = Instant::now();
        while self.runs() {
            assert!(start.elapsed() < TIMEOUT, "process {} did not end", self.pid());
            std::thread::sleep(Duration::from_millis(10));
        }
        let mut process = self.0.take().unwrap();
        let code = process.child.wait().unwrap().code();
        Done { code, out: process.out.whole(), err: process.err.whole() }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        let Some(process) = &mut self.0 else { return };
        let _ = process.child.kill();
        let _ = process.child.wait();
        if std::thread::panicking() {
            // The output helps to find the cause of the failure.
            eprintln!("--- stdout until then\n{}--- stderr until then\n{}", process.out.so_far(), process.err.so_far());
        }
    }
}

/// Output of a process, read continuously, so that the process does not block on a full pipe.
struct Capture {
    bytes: Arc<Mutex<Vec<u8>>>,
    reader: JoinHandle<()>,
}

impl Capture {
    fn through(mut pipe: impl Read + Send + 'static) -> Capture {
        let bytes = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&bytes);
        let reader = std::thread::spawn(move || {
            let mut some = [0; 4096];
            while let Ok(length @ 1..) = pipe.read(&mut some) {
                heard.lock().unwrap().extend_from_slice(&some[..length]);
            }
        });
        Capture { bytes, reader }
    }

    fn so_far(&self) -> String {
        String::from_utf8_lossy(&self.bytes.lock().unwrap()).into_owned()
    }

    /// Waits until the other end is closed.
    fn whole(self) -> String {
        self.reader.join().unwrap();
        String::from_utf8(std::mem::take(&mut *self.bytes.lock().unwrap())).unwrap()
    }
}

pub fn signal(pid: u32, name: &str) {
    signal_all(&[pid], name);
}

/// Sends a signal to several processes at once: one may end because another does.
pub fn signal_all(pids: &[u32], name: &str) {
    let pids: Vec<String> = pids.iter().map(u32::to_string).collect();
    let status = Command::new("kill").arg(format!("-{name}")).args(&pids).status().unwrap();
    assert!(status.success(), "kill -{name} {pids:?}");
}

/// A shell with mounts of its own that executes `script`.
pub fn in_namespace(script: &str) -> Command {
    let mut command = Command::new("unshare");
    // Root needs no user namespace, in which the loop would have no real-time priority.
    command.args(if rustix::process::geteuid().is_root() { &["--mount"][..] } else { &["--map-root-user", "--mount"] });
    command.args(["sh", "-c", script]);
    command
}

/// Children of `parent` whose first argument is `subcommand`.
pub fn children(parent: u32, subcommand: &str) -> Vec<u32> {
    let processes =
        std::fs::read_dir("/proc").unwrap().filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    let is_child = |&pid: &u32| {
        let read = |file: &str| std::fs::read_to_string(format!("/proc/{pid}/{file}")).unwrap_or_default();
        // pid (name) state ppid ...; a name may hold anything but comes before the last parenthesis.
        let stat = read("stat");
        let ppid = stat.rsplit(')').next().and_then(|rest| rest.split_whitespace().nth(1)?.parse::<u32>().ok());
        ppid == Some(parent) && read("cmdline").split('\0').nth(1) == Some(subcommand)
    };
    processes.filter(is_child).collect()
}

/// Whether any process was started with this text in its arguments, the program's own aside.
pub fn anyone_with(text: &str) -> Vec<u32> {
    let processes =
        std::fs::read_dir("/proc").unwrap().filter_map(|entry| entry.ok()?.file_name().to_str()?.parse().ok());
    let mentions = |&pid: &u32| {
        let line = std::fs::read_to_string(format!("/proc/{pid}/cmdline")).unwrap_or_default();
        pid != std::process::id() && line.contains(text)
    };
    processes.filter(mentions).collect()
}

/// Name and true value of every parameter that the paper's model of this arm has: the general base set, then fv, then fc.
pub fn true_parameters(truth: &Truth) -> Vec<(String, f64)> {
    const SLOTS: [&str; 10] = ["Lxx", "Lxy", "Lxz", "Lyy", "Lyz", "Lzz", "lx", "ly", "lz", "m"];
    let chain = Robot::load(&truth.robot, None).unwrap().chain;
    let reduction = Reduction::any_mounting(&chain);
    let delta: Vec<f64> = truth.link_parameters().into_iter().flatten().collect();
    let base = reduction.base_of(&DVector::from_vec(delta));
    let slot = |&slot: &usize| format!("{}{}", SLOTS[slot % 10], slot / 10 + 1);
    let mut all: Vec<(String, f64)> = reduction.independent().iter().map(slot).zip(base.iter().copied()).collect();
    all.extend(truth.joints.iter().enumerate().map(|(j, joint)| (format!("fv{}", j + 1), joint.fv)));
    all.extend(truth.joints.iter().enumerate().map(|(j, joint)| (format!("fc{}", j + 1), joint.fc)));
    all
}

/// Error of every parameter in its own standard deviations.
pub fn z_scores(report: &Report, truth: &[(String, f64)]) -> Vec<(String, f64)> {
    assert_eq!(report.base.parameters.len(), truth.len());
    let z = |(name, true_value): &(String, f64)| {
        let found =
            report.base.parameters.iter().find(|found| found.name == *name).unwrap_or_else(|| panic!("no {name}"));
        (name.clone(), (found.value - true_value) / found.std.unwrap_or_else(|| panic!("{name} has no std")))
    };
    truth.iter().map(z).collect()
}

/// Noise of a raw torque sample of every joint: the sensor's noise and its step's rounding \[Nm\].
pub fn torque_noise(truth: &Truth) -> Vec<f64> {
    let one = |joint: &plumbline_sim::JointTruth| joint.torque_noise.hypot(joint.torque_quantum / 12f64.sqrt());
    truth.joints.iter().map(one).collect()
}

pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}
