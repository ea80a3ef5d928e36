//! `plumbline run`: daemon, estimator and report on one machine, without systemd.

use crate::analysis::next;
use crate::cli::say::say;
use crate::failure::Failure;
use crate::process::signals::Ending;
use crate::process::{owned, progress};
use crate::report::Report;
use crate::setup::{JobOptions, programme, robot_id};
use clap::Args;
use plumbline_ipc::{Client, Progress, Request, Response, RobotId, Status};
use plumbline_model_file::models;
use rustix::process::{Pid, Signal, kill_process};
use std::ffi::OsStr;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Options of `plumbline run`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    job: JobOptions,
    /// Model to serve until the identified one; needed for torque control of an arm that is not mounted upright
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
}

/// Timeout of the start of daemon and estimator.
const START_TIMEOUT: Duration = Duration::from_secs(30);
/// Timeout of a response.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval of the status queries.
const POLL_INTERVAL: Duration = Duration::from_millis(100);
/// Restarts of a killed estimator.
const MAX_ESTIMATOR_RESTARTS: usize = 3;

/// Runs the job, and again with the motion that is planned for what its diagnosis leaves open; then prints the results.
pub fn run(mut options: Options) -> Result<(), Failure> {
    let (job, _, out) = options.job.load()?;
    let plan = out.join(next::FILE);
    let mut before: Option<PathBuf> = None;
    for round in 1..=1 + job.diagnosis.rounds {
        // That of an earlier job would be driven.
        crate::atomic::remove_file(&plan).map_err(Failure::job)?;
        one_round(&options, before.as_deref())?;
        if !plan.exists() {
            break;
        }
        let dir = out.join(format!("round-{round}"));
        put_aside(&out, &dir)?;
        say!("round {round}: {}", dir.join("report.html").display());
        for line in Report::read(&dir)?.diagnosis_lines() {
            say!("  {line}");
        }
        options.job.sets.extend(next_round(&dir, job.diagnosis.rounds - round)?);
        before = Some(dir);
    }
    summarise(&out)
}

/// What a job of the next round has in the place of its own keys: the motion that was planned, and nothing else.
fn next_round(dir: &Path, rounds: usize) -> Result<[String; 6], Failure> {
    let plan = std::path::absolute(dir.join(next::FILE)).map_err(Failure::job)?;
    Ok([
        format!("excitation.plan={}", plan.display()),
        "excitation.trajectories=1".into(),
        "validation.trajectories=0".into(),
        "validation.counter-experiment=false".into(),
        "live.motion=0 s".into(),
        format!("diagnosis.rounds={rounds}"),
    ])
}

/// Moves the results of a round into a folder of their own, in the place of those of an earlier job.
fn put_aside(out: &Path, dir: &Path) -> Result<(), Failure> {
    let failed = |error: std::io::Error| Failure::job(format!("{}: {error}", dir.display()));
    match std::fs::remove_dir_all(dir) {
        Err(error) if error.kind() != ErrorKind::NotFound => return Err(failed(error)),
        _ => std::fs::create_dir_all(dir).map_err(failed)?,
    }
    for entry in std::fs::read_dir(out).map_err(failed)? {
        let name = entry.map_err(failed)?.file_name();
        let text = name.to_string_lossy();
        let named = ["report.json", "report.html", "dataset", "plans", next::FILE].contains(&&*text);
        if named || (text.starts_with("model") && text.ends_with(".toml")) {
            std::fs::rename(out.join(&name), dir.join(&name)).map_err(failed)?;
        }
    }
    Ok(())
}

/// Plans, starts both processes and waits for the results. `before` holds those of the round before.
fn one_round(options: &Options, before: Option<&Path>) -> Result<(), Failure> {
    let (job, robot, out) = options.job.load()?;
    let id = robot_id(&job)?;
    // The lock excludes another daemon for this robot during planning; the daemon below inherits it.
    let lock = crate::setup::lock(&id)?;
    // The checks of the daemon, before any process starts.
    let connector = crate::setup::backend::connector(&job, &robot)?;
    let arm = crate::setup::arm_lock(connector.as_ref())?;
    crate::setup::rest(&job, &robot)?;
    if let Some(model) = &options.model {
        models::of_robot(&model.display().to_string(), &owned::read_model(model)?, &robot, "the job's robot")?;
    }
    std::fs::create_dir_all(&out).map_err(|error| Failure::job(format!("{}: {error}", out.display())))?;
    let arm_limits = connector.read_limits().map_err(Failure::job)?;
    let programme = programme::plan_or_load(&job, &robot, &out, arm_limits.as_ref())?;
    let ticks: usize = programme.motions().map(|motion| motion.ticks()).sum();

    let ending = Ending::watch()?;
    // The inheritable lock is closed again before another process starts.
    let passed_on = lock.pass_on().map_err(Failure::job)?;
    // The daemon locks the arm itself.
    drop(arm);
    let mut more: Vec<&OsStr> = ["--end-with-stdin", "--adopt-lock"].map(OsStr::new).to_vec();
    if let Some(model) = &options.model {
        more.extend([OsStr::new("--model"), model.as_os_str()]);
    }
    let mut daemon = Process::start("daemon", &options.job, &out, &more)?;
    drop(passed_on);
    let results = EstimatorOptions { job: &options.job, out: &out, before };
    let outcome = drive(&id, results, &mut daemon, ticks as u64, &ending);
    // The daemon ends with a controlled stop if the arm moves.
    let ended = daemon.end()?;
    outcome?;
    if !ended.success() {
        return Err(Failure::job(format!("the daemon failed: {ended}")));
    }
    Ok(())
}

/// What an estimator of this job is started with.
#[derive(Clone, Copy)]
struct EstimatorOptions<'a> {
    job: &'a JobOptions,
    out: &'a Path,
    before: Option<&'a Path>,
}

impl EstimatorOptions<'_> {
    fn start(self) -> Result<Process, Failure> {
        let mut more = vec![OsStr::new("--once")];
        if let Some(before) = self.before {
            more.extend([OsStr::new("--after"), before.as_os_str()]);
        }
        Process::start("estimator", self.job, self.out, &more)
    }
}

fn drive(
    id: &RobotId,
    results: EstimatorOptions,
    daemon: &mut Process,
    ticks: u64,
    ending: &Ending,
) -> Result<(), Failure> {
    let mut client = await_daemon(id, daemon)?;
    let mut estimator = results.start()?;
    let outcome = (|| {
        await_follower(&mut client, daemon, &mut estimator)?;
        start(&mut client, ending)?;
        let bar = progress::bar("running");
        let mut restarts = 0;
        let mut stopped: Option<Instant> = None;
        loop {
            std::thread::sleep(POLL_INTERVAL);
            if let Some(cause) = ending.cause() {
                return Err(Failure::job(format!("interrupted, {cause}; the arm was stopped")));
            }
            if let Some(ended) = daemon.ended()? {
                return Err(Failure::job(format!("the daemon ended during the job: {ended}")));
            }
            match estimator.ended()? {
                Some(ended) if ended.success() => break,
                Some(ended) if ended.code().is_none() && restarts < MAX_ESTIMATOR_RESTARTS => {
                    restarts += 1;
                    tracing::warn!("the estimator was killed ({ended}); a new one continues with the daemon's samples");
                    estimator = results.start()?;
                }
                Some(ended) => {
                    let stopped = status(&mut client).and_then(|now| now.stopped);
                    let why = stopped
                        .map_or(format!("the estimator ended: {ended}"), |why| format!("the arm was stopped: {why}"));
                    return Err(Failure::job(why));
                }
                None => {}
            }
            // A missing response is ignored: an ended daemon is detected above.
            if let Some(now) = status(&mut client) {
                bar.at(now.cycles as f64 / (1.3 * ticks as f64), &now.job);
                // The estimator should end by itself after a stop.
                if now.progress == Progress::Stopped
                    && stopped.get_or_insert_with(Instant::now).elapsed() > START_TIMEOUT
                {
                    let why = now.stopped.unwrap_or_default();
                    return Err(Failure::job(format!(
                        "the arm was stopped: {why}; the estimator did not end by itself"
                    )));
                }
            }
        }
        bar.done();
        Ok(())
    })();
    if outcome.is_err() && estimator.ended()?.is_none() {
        estimator.child.kill().map_err(Failure::job)?;
        estimator.child.wait().map_err(Failure::job)?;
    }
    outcome
}

/// Waits for the daemon that this process has started. The client is bound to that daemon.
fn await_daemon(id: &RobotId, daemon: &mut Process) -> Result<Client, Failure> {
    let start = Instant::now();
    loop {
        if let Some(ended) = daemon.ended()? {
            return Err(Failure::job(format!("the daemon did not start: {ended}")));
        }
        let found = Client::connect(id, POLL_INTERVAL).and_then(|mut client| {
            let answer = client.send(&Request::Status {}, RESPONSE_TIMEOUT)?;
            Ok((client, answer))
        });
        match found {
            Ok((mut client, Response::Status(status))) => {
                let own = daemon.child.id();
                if status.process != own {
                    return Err(Failure::job(format!(
                        "another daemon (process {}) serves robot `{id}`; it is left alone, and the daemon of this run (process {own}) is \
                         ended",
                        status.process
                    )));
                }
                client.bind(status.served.epoch);
                return Ok(client);
            }
            Ok((_, other)) => {
                return Err(Failure::job(format!("unexpected response of the daemon to a status request: {other:?}")));
            }
            Err(error) if start.elapsed() > START_TIMEOUT => return Err(Failure::job(error)),
            Err(_) => {}
        }
    }
}

/// Waits until the daemon has registered the estimator of this process, so that the first samples need no replay.
fn await_follower(client: &mut Client, daemon: &mut Process, estimator: &mut Process) -> Result<(), Failure> {
    let start = Instant::now();
    while start.elapsed() < START_TIMEOUT {
        let own = estimator.child.id();
        if status(client).is_some_and(|status| status.served.followers.iter().any(|follower| follower.pid == own)) {
            return Ok(());
        }
        for process in [&mut *daemon, &mut *estimator] {
            if let Some(ended) = process.ended()? {
                return Err(Failure::job(format!("the {} did not start: {ended}", process.name)));
            }
        }
        std::thread::sleep(POLL_INTERVAL);
    }
    Err(Failure::job("the estimator did not find the daemon"))
}

/// The daemon's status, if it responds.
fn status(client: &mut Client) -> Option<Status> {
    match client.send(&Request::Status {}, RESPONSE_TIMEOUT).ok()? {
        Response::Status(status) => Some(*status),
        _ => None,
    }
}

/// Starts the programme. A refusal is retried, because the inclinometer may still be starting.
fn start(client: &mut Client, ending: &Ending) -> Result<(), Failure> {
    let begin = Instant::now();
    loop {
        match client.send(&Request::Start {}, START_TIMEOUT).map_err(Failure::job)? {
            Response::Accepted {} => return Ok(()),
            Response::Refused { .. } if begin.elapsed() < START_TIMEOUT && !ending.arrived() => {
                std::thread::sleep(POLL_INTERVAL);
            }
            Response::Refused { reason } => return Err(Failure::job(format!("the daemon does not start: {reason}"))),
            other => return Err(Failure::job(format!("unexpected response of the daemon to a start: {other:?}"))),
        }
    }
}

struct Process {
    name: &'static str,
    child: Child,
}

impl Process {
    fn start(name: &'static str, job: &JobOptions, out: &Path, more: &[&OsStr]) -> Result<Process, Failure> {
        let program = std::env::current_exe().map_err(Failure::job)?;
        let mut command = Command::new(program);
        command.arg(name).arg(&job.config).arg("--out").arg(out).args(more);
        for set in &job.sets {
            command.arg("--set").arg(set);
        }
        // The standard input of the child is closed when this process ends.
        command.stdin(Stdio::piped());
        let child = command.spawn().map_err(|error| Failure::job(format!("the {name} can't be started: {error}")))?;
        Ok(Process { name, child })
    }

    fn ended(&mut self) -> Result<Option<ExitStatus>, Failure> {
        self.child.try_wait().map_err(Failure::job)
    }

    /// Ends the child by SIGTERM, and by SIGKILL after a timeout.
    fn end(&mut self) -> Result<ExitStatus, Failure> {
        let start = Instant::now();
        let mut signalled = false;
        loop {
            if let Some(ended) = self.ended()? {
                return Ok(ended);
            }
            if !std::mem::replace(&mut signalled, true) {
                kill_process(Pid::from_child(&self.child), Signal::TERM).map_err(Failure::job)?;
            }
            if start.elapsed() > START_TIMEOUT {
                self.child.kill().map_err(Failure::job)?;
            }
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// Prints the results and the path of the report.
fn summarise(out: &Path) -> Result<(), Failure> {
    for line in Report::read(out)?.summary() {
        say!("{line}");
    }
    say!("report: {}", out.join("report.html").display());
    Ok(())
}
