//! `plumbline run`: daemon, estimator and report on one machine, for people without systemd.

use super::estimator::status;
use super::say::say;
use super::signals::Ending;
use super::{Failure, JobOptions, plan, progress, robot_id};
use crate::ipc::{Client, Progress, Request, Response, RobotId};
use crate::report::Report;
use clap::Args;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Options of `plumbline run`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    job: JobOptions,
}

/// How long the two processes may take to find each other.
const PATIENCE: Duration = Duration::from_secs(30);
/// Pause between two looks at them.
const LOOK: Duration = Duration::from_millis(100);
/// How often a killed estimator is started again.
const RESTARTS: usize = 3;

/// Plans, starts both processes, waits for the results and says what they are.
pub fn run(options: Options) -> Result<(), Failure> {
    let (job, robot, out) = options.job.load()?;
    let id = robot_id(&job)?;
    // What a daemon would refuse is refused here, before anything starts.
    drop(super::lock(&id)?);
    drop(super::arm_lock(&job)?);
    super::truth(&job)?;
    super::rest(&job, &robot)?;
    std::fs::create_dir_all(&out).map_err(|error| Failure::job(format!("{}: {error}", out.display())))?;
    let programme = plan::programme(&job, &robot, &out, plan::arm_limits(&job)?.as_ref())?;
    let ticks: usize = programme.motions().map(|motion| motion.ticks()).sum();

    let ending = Ending::watch()?;
    let mut daemon = Process::start("daemon", &options.job, &out, &["--end-with-stdin"])?;
    let outcome = drive(&id, &options.job, &out, &mut daemon, ticks as u64, &ending);
    // Whatever happened, the daemon ends by its own rules: it brakes first when the arm moves.
    if daemon.child.try_wait().map_err(Failure::job)?.is_none() {
        let quit = Client::connect(&id, LOOK).and_then(|mut client| client.send(&Request::Quit {}, PATIENCE));
        if quit.is_err() {
            // A daemon that can't be asked brakes and ends when its standard input does.
            drop(daemon.child.stdin.take());
        }
    }
    let ended = daemon.child.wait().map_err(Failure::job)?;
    outcome?;
    if !ended.success() {
        return Err(Failure::job(format!("the daemon ended badly: {ended}")));
    }
    summarise(&out)
}

/// Sees the programme through.
fn drive(
    id: &RobotId,
    job: &JobOptions,
    out: &Path,
    daemon: &mut Process,
    ticks: u64,
    ending: &Ending,
) -> Result<(), Failure> {
    let mut client = await_daemon(id, daemon)?;
    let mut estimator = Process::start("estimator", job, out, &["--once"])?;
    let outcome = (|| {
        await_follower(id, daemon, &mut estimator)?;
        start(&mut client, ending)?;
        let bar = progress::bar("running");
        let mut restarts = 0;
        let mut stopped: Option<Instant> = None;
        loop {
            std::thread::sleep(LOOK);
            if let Some(cause) = ending.cause() {
                return Err(Failure::job(format!("interrupted, {cause}; the arm was stopped")));
            }
            if let Some(ended) = daemon.ended()? {
                return Err(Failure::job(format!("the daemon ended in mid-job: {ended}")));
            }
            match estimator.ended()? {
                Some(ended) if ended.success() => break,
                Some(ended) if ended.code().is_none() && restarts < RESTARTS => {
                    restarts += 1;
                    tracing::warn!("the estimator was killed ({ended}); a new one goes on from what the daemon kept");
                    estimator = Process::start("estimator", job, out, &["--once"])?;
                }
                Some(ended) => {
                    let stopped = status(id).ok().and_then(|now| now.stopped);
                    let why = stopped
                        .map_or(format!("the estimator ended: {ended}"), |why| format!("the arm was stopped: {why}"));
                    return Err(Failure::job(why));
                }
                None => {}
            }
            // A daemon that is busy for a moment is no reason to give up; one that is gone is seen above.
            if let Ok(now) = status(id) {
                bar.at(now.cycles as f64 / (1.3 * ticks as f64), &now.job);
                // The estimator ends by itself then, unless it computes on and on.
                if now.progress == Progress::Stopped && stopped.get_or_insert_with(Instant::now).elapsed() > PATIENCE {
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

fn await_daemon(id: &RobotId, daemon: &mut Process) -> Result<Client, Failure> {
    let start = Instant::now();
    loop {
        if let Some(ended) = daemon.ended()? {
            return Err(Failure::job(format!("the daemon did not start: {ended}")));
        }
        match Client::connect(id, LOOK) {
            Ok(client) => return Ok(client),
            Err(error) if start.elapsed() > PATIENCE => return Err(Failure::job(error)),
            Err(_) => {}
        }
    }
}

/// Waits until the daemon has heard of the estimator, so that not even the first sample needs a replay.
fn await_follower(id: &RobotId, daemon: &mut Process, estimator: &mut Process) -> Result<(), Failure> {
    let start = Instant::now();
    while start.elapsed() < PATIENCE {
        if status(id).is_ok_and(|status| !status.served.followers.is_empty()) {
            return Ok(());
        }
        for process in [&mut *daemon, &mut *estimator] {
            if let Some(ended) = process.ended()? {
                return Err(Failure::job(format!("the {} did not start: {ended}", process.name)));
            }
        }
        std::thread::sleep(LOOK);
    }
    Err(Failure::job("the estimator did not find the daemon"))
}

/// Starts the programme. A daemon that refuses may still be on its way up, as its inclinometer is; it says what it waits for.
fn start(client: &mut Client, ending: &Ending) -> Result<(), Failure> {
    let begin = Instant::now();
    loop {
        match client.send(&Request::Start {}, PATIENCE).map_err(Failure::job)? {
            Response::Accepted {} => return Ok(()),
            Response::Refused { .. } if begin.elapsed() < PATIENCE && !ending.arrived() => {
                std::thread::sleep(LOOK);
            }
            Response::Refused { reason } => return Err(Failure::job(format!("the daemon does not start: {reason}"))),
            other => return Err(Failure::job(format!("the daemon answered a start with {other:?}"))),
        }
    }
}

/// A process of this program.
struct Process {
    name: &'static str,
    child: Child,
}

impl Process {
    fn start(name: &'static str, job: &JobOptions, out: &Path, more: &[&str]) -> Result<Process, Failure> {
        let program = std::env::current_exe().map_err(Failure::job)?;
        let mut command = Command::new(program);
        command.arg(name).arg(&job.config).arg("--out").arg(out).args(more);
        for set in &job.sets {
            command.arg("--set").arg(set);
        }
        // The daemon's standard input ends with this process, however that ends.
        command.stdin(Stdio::piped());
        let child = command.spawn().map_err(|error| Failure::job(format!("the {name} can't be started: {error}")))?;
        Ok(Process { name, child })
    }

    fn ended(&mut self) -> Result<Option<ExitStatus>, Failure> {
        self.child.try_wait().map_err(Failure::job)
    }
}

/// The last lines: what came out and where it lies.
fn summarise(out: &Path) -> Result<(), Failure> {
    let path = out.join("report.json");
    let text = std::fs::read_to_string(&path).map_err(|error| Failure::job(format!("{}: {error}", path.display())))?;
    let report: Report = serde_json::from_str(&text).map_err(Failure::job)?;
    for line in report.summary() {
        say!("{line}");
    }
    say!("report: {}", out.join("report.html").display());
    Ok(())
}
