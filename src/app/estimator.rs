//! `plumbline estimator`: follows the daemon's samples, identifies, offers the model, writes the results.

use super::collector::{Collector, Recorded};
use super::programme::{Programme, Role};
use super::results::Results;
use super::{Failure, JobOptions, robot_id};
use crate::ipc::{Client, Delivery, Progress, Request, Response, RobotId, SampleStream, Status, StreamSettings};
use clap::Args;
use std::time::{Duration, Instant};

/// Options of `plumbline estimator`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    job: JobOptions,
    /// End when the results of one programme are written
    #[arg(long)]
    once: bool,
}

/// How long to wait for a daemon that is just starting.
const PATIENCE: Duration = Duration::from_secs(30);
/// How long to wait for an answer.
const ANSWER: Duration = Duration::from_secs(5);
/// How long to wait for samples before looking at the daemon again.
const STEP: Duration = Duration::from_millis(200);

/// Runs until the results are written, or for ever.
pub fn run(options: Options) -> Result<(), Failure> {
    let (job, robot, out) = options.job.load()?;
    let id = robot_id(&job)?;
    loop {
        let mut stream = SampleStream::connect(&id, StreamSettings::default(), PATIENCE).map_err(Failure::job)?;
        let programme = Programme::load(&job, &robot, &out.join("plans"))?;
        let results = Results::new(&job, &robot, &programme, &out);
        match follow(&id, &mut stream, &programme, results)? {
            Outcome::Written if options.once => return Ok(()),
            Outcome::Written => {
                while !matches!(stream.next(STEP).map_err(Failure::job)?, Delivery::Restarted { .. }) {}
            }
            Outcome::DaemonGone if options.once => return Err(Failure::job("the daemon is gone; its samples with it")),
            Outcome::DaemonGone => {}
        }
    }
}

enum Outcome {
    Written,
    DaemonGone,
}

/// Follows one start of the daemon.
fn follow(
    id: &RobotId,
    stream: &mut SampleStream,
    programme: &Programme,
    mut results: Results,
) -> Result<Outcome, Failure> {
    let mut collector = Collector::new(programme, results.joints());
    let mut done: Option<Status> = None;
    let mut looked = Instant::now();
    loop {
        match stream.next(STEP).map_err(Failure::job)? {
            Delivery::Records { records, .. } => {
                for record in &records {
                    if let Some(recorded) = collector.take(record) {
                        take(id, &mut results, recorded)?;
                    }
                }
            }
            Delivery::Missed { from, to } => {
                tracing::warn!("samples {from} to {} are gone: the daemon no longer had them", to - 1);
            }
            Delivery::Restarted { .. } if stream.counters().received == 0 => {}
            Delivery::Restarted { .. } | Delivery::Gone => return Ok(Outcome::DaemonGone),
            Delivery::Idle => {}
        }
        // An arm that keeps wall-clock time goes on sending while it holds: the daemon says when everything was driven.
        if done.is_none() && looked.elapsed() >= STEP {
            looked = Instant::now();
            let status = status(id)?;
            match status.progress {
                Progress::Done => done = Some(status),
                Progress::Stopped => {
                    return Err(Failure::job("the arm was stopped, so there are no complete results"));
                }
                _ => {}
            }
        }
        if let Some(status) = done.take_if(|status| stream.position() >= status.served.published) {
            // Samples sent and received are both counted up to the end of the programme.
            let mut counters = stream.counters();
            counters.received -= stream.position() - status.served.published;
            results.finish(&status, &counters)?;
            return Ok(Outcome::Written);
        }
    }
}

/// Takes one motion in; offers the model when it was the one to identify from.
fn take(id: &RobotId, results: &mut Results, recorded: Recorded) -> Result<(), Failure> {
    if !recorded.complete {
        tracing::warn!("{} is incomplete and left out", recorded.run.file);
        return Ok(());
    }
    let role = recorded.role;
    results.take(recorded);
    if role != Role::Identify {
        return Ok(());
    }
    let text = results.identify()?;
    let offer = Request::OfferModel { toml: text };
    match client(id)?.send(&offer, ANSWER).map_err(Failure::job)? {
        Response::ModelAccepted { model } => {
            tracing::info!("the daemon serves model {model:016x}");
            Ok(())
        }
        Response::Refused { reason } => Err(Failure::job(format!("the daemon refused the model: {reason}"))),
        other => Err(Failure::job(format!("the daemon answered a model with {other:?}"))),
    }
}

fn client(id: &RobotId) -> Result<Client, Failure> {
    Client::connect(id, ANSWER).map_err(Failure::job)
}

/// The daemon's status.
pub fn status(id: &RobotId) -> Result<Status, Failure> {
    match client(id)?.send(&Request::Status {}, ANSWER).map_err(Failure::job)? {
        Response::Status(status) => Ok(*status),
        other => Err(Failure::job(format!("the daemon answered a question for its status with {other:?}"))),
    }
}
