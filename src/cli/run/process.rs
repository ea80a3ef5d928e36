//! The processes that `run` starts, and its requests to the daemon.

use super::RESPONSE_TIMEOUT;
use crate::failure::Failure;
use crate::process::journal;
use crate::process::progress::Stages;
use crate::process::signals::Ending;
use crate::setup::JobOptions;
use plumbline_ipc::{Client, Request, Response, RobotId, Status};
use rustix::process::{Pid, Signal, kill_process};
use std::ffi::OsStr;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::time::{Duration, Instant};

/// Timeout of the start and the end of daemon and estimator.
pub const START_TIMEOUT: Duration = Duration::from_secs(30);
/// Interval of the status queries.
pub const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// What the processes of a job are started with.
#[derive(Clone, Copy)]
pub struct Start<'a> {
    pub job: &'a JobOptions,
    pub out: &'a Path,
    /// Filter of their logs.
    pub log: &'a str,
}

/// What an estimator of this job is started with.
#[derive(Clone, Copy)]
pub struct EstimatorOptions<'a> {
    pub start: Start<'a>,
    /// Results of the round before.
    pub before: Option<&'a Path>,
    /// The command that the report names.
    pub command: &'a str,
}

impl EstimatorOptions<'_> {
    /// An estimator, and what it is doing.
    pub fn start(self) -> Result<(Process, Stages), Failure> {
        let mut more = ["--once", "--progress", "--command", self.command].map(OsStr::new).to_vec();
        if let Some(before) = self.before {
            more.extend([OsStr::new("--after"), before.as_os_str()]);
        }
        let mut process = Process::start("estimator", self.start, &more, Stdio::piped())?;
        let stages = process.child.stdout.take().map_or_else(Stages::default, Stages::read);
        Ok((process, stages))
    }
}

/// A process of the job.
pub struct Process {
    pub name: &'static str,
    pub child: Child,
}

impl Process {
    pub fn start(name: &'static str, of: Start, more: &[&OsStr], out: Stdio) -> Result<Process, Failure> {
        let program = std::env::current_exe().map_err(Failure::job)?;
        let mut command = Command::new(program);
        command.arg(name).arg(&of.job.config).arg("--out").arg(of.out).args(more);
        for set in &of.job.sets {
            command.arg("--set").arg(set);
        }
        if std::env::var_os(journal::FILTER_VARIABLE).is_none() {
            command.env(journal::FILTER_VARIABLE, of.log);
        }
        // The standard input of the child is closed when this process ends.
        command.stdin(Stdio::piped()).stdout(out);
        let child = command.spawn().map_err(|error| Failure::job(format!("the {name} can't be started: {error}")))?;
        Ok(Process { name, child })
    }

    pub fn ended(&mut self) -> Result<Option<ExitStatus>, Failure> {
        self.child.try_wait().map_err(Failure::job)
    }

    /// Ends the child by SIGTERM, and by SIGKILL after a timeout.
    pub fn end(&mut self) -> Result<ExitStatus, Failure> {
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

/// Waits for the daemon that this process has started. The client is bound to that daemon.
pub fn await_daemon(id: &RobotId, daemon: &mut Process) -> Result<Client, Failure> {
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
pub fn await_follower(client: &mut Client, daemon: &mut Process, estimator: &mut Process) -> Result<(), Failure> {
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
pub fn status(client: &mut Client) -> Option<Status> {
    match client.send(&Request::Status {}, RESPONSE_TIMEOUT).ok()? {
        Response::Status(status) => Some(*status),
        _ => None,
    }
}

/// Starts the programme. A refusal is retried, because the inclinometer may still be starting.
pub fn start(client: &mut Client, ending: &Ending) -> Result<(), Failure> {
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
