//! `plumbline estimator`: receives the daemon's samples, identifies, offers the model, writes the results.

pub mod live;

use crate::analysis::collector::{Collector, Recorded};
use crate::analysis::results::Results;
use crate::estimator::live::{Live, OfferedModel, Verdict};
use crate::failure::Failure;
use crate::process::journal;
use crate::process::progress::{self, Target};
use crate::process::service::Service;
use crate::setup::programme::Programme;
use crate::setup::{JobOptions, robot_id};
use clap::Args;
use plumbline_ipc::{
    Client, Delivery, IpcError, Progress, Request, Response, RobotId, SampleStream, Status, StreamCounters,
    StreamSettings,
};
use plumbline_model::Mounting;
use std::path::PathBuf;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

/// Options of `plumbline estimator`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    job: JobOptions,
    /// End when the results of one programme are written
    #[arg(long)]
    once: bool,
    /// Results of the round before: their runs are identified from and judged by, too
    #[arg(long, value_name = "DIR", requires = "once")]
    after: Option<PathBuf>,
    /// Write progress to standard output, for the process that has started this one
    #[arg(long, hide = true)]
    progress: bool,
    /// Command to name in the report
    #[arg(long, hide = true, value_name = "COMMAND")]
    command: Option<String>,
}

/// Timeout of the connection to a daemon.
const CONNECT_TIMEOUT: Duration = Duration::from_secs(30);
/// Timeout of a response.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
/// Interval of log messages during a computation.
const PROGRESS_LOG_INTERVAL: Duration = Duration::from_secs(20);
/// Timeout for samples, and interval of the status queries.
const POLL_INTERVAL: Duration = Duration::from_millis(200);

/// Runs until the results are written with `--once`, else until it is ended.
pub fn run(options: Options) -> Result<(), Failure> {
    progress::send_to(if options.progress { Target::Lines } else { Target::Nowhere });
    let (job, robot, out) = options.job.load()?;
    let id = robot_id(&job)?;
    journal::about(id.as_str());
    let mut service = Service::of_environment();
    service.ready("waits for a daemon");
    loop {
        let mut stream = match SampleStream::connect(&id, StreamSettings::default(), CONNECT_TIMEOUT) {
            Ok(stream) => stream,
            // As a service, the estimator also runs without a daemon.
            Err(IpcError::NoDaemon { .. }) if !options.once => {
                service.turned();
                continue;
            }
            Err(error) => return Err(Failure::job(error)),
        };
        let programme = Programme::load(&job, &out.join("plans"))?;
        let mut results = Results::new(&job, &robot, &programme, &out);
        options.command.iter().for_each(|command| results.made_by(command));
        options.after.as_deref().map_or(Ok(()), |dir| results.go_on_from(dir))?;
        let live = Live::new(&job, &robot, &out);
        service.status("follows the samples");
        let outcome = match follow(&id, &mut stream, &programme, results, live, &mut service, options.once) {
            Err(Failure::Input(bad)) => Outcome::Unusable { why: bad.to_string() },
            outcome => outcome?,
        };
        match outcome {
            Outcome::Written if options.once => return Ok(()),
            Outcome::Written => await_next_daemon(&mut stream, &mut service, "the results are written")?,
            Outcome::Stopped { why } if options.once => return Err(Failure::job(no_results(&why))),
            Outcome::Stopped { why } => {
                tracing::error!("{}", no_results(&why));
                await_next_daemon(&mut stream, &mut service, "the arm was stopped; waits for the daemon's next start")?;
            }
            Outcome::Unusable { why } if options.once => return Err(Failure::job(why)),
            // A retry would fail again.
            Outcome::Unusable { why } => {
                tracing::error!("no results: {why}");
                await_next_daemon(&mut stream, &mut service, "no results; waits for the daemon's next start")?;
            }
            Outcome::DaemonGone if options.once => return Err(Failure::job("the daemon is gone; its samples with it")),
            Outcome::DaemonGone => {}
        }
    }
}

enum Outcome {
    Written,
    Stopped {
        why: String,
    },
    /// The recording or its model is unusable. This is not bad input (exit code 2), after which a service would
    /// stay down.
    Unusable {
        /// Found and expected value, or the daemon's reason.
        why: String,
    },
    DaemonGone,
}

fn no_results(why: &str) -> String {
    format!("the arm was stopped, so there are no complete results: {why}")
}

fn await_next_daemon(stream: &mut SampleStream, service: &mut Service, status: &str) -> Result<(), Failure> {
    service.status(status);
    while !matches!(stream.next(POLL_INTERVAL).map_err(Failure::job)?, Delivery::Restarted { .. }) {
        service.turned();
    }
    Ok(())
}

/// Processes the samples of one start of the daemon. Without `once`, a watched model is watched on after the results were written.
fn follow(
    id: &RobotId,
    stream: &mut SampleStream,
    programme: &Programme,
    mut results: Results,
    mut live: Option<Live>,
    service: &mut Service,
    once: bool,
) -> Result<Outcome, Failure> {
    let mut collector = Collector::new(programme, results.joints());
    let mut written = false;
    let mut last_poll = Instant::now();
    loop {
        service.turned();
        match stream.next(POLL_INTERVAL).map_err(Failure::job)? {
            Delivery::Records { records, .. } => {
                for record in &records {
                    results.time(record);
                    if let Some(recorded) = collector.take(record)
                        && let Some(why) = process_run(id, stream.epoch(), &mut results, &mut live, recorded)?
                    {
                        return Ok(Outcome::Unusable { why: format!("the daemon refused the model: {why}") });
                    }
                    if let Some(live) = &mut live {
                        let offer = live.update(record)?;
                        live.verdict().map_or(Ok(()), |verdict| tell(id, stream.epoch(), verdict))?;
                        offer.map_or(Ok(()), |offer| propose(id, stream.epoch(), offer))?;
                    }
                }
            }
            Delivery::Missed { from, to } => {
                live.iter_mut().for_each(Live::clear);
                tracing::warn!("samples {from} to {} are gone: the daemon no longer had them", to - 1);
                if let Some(motion) = collector.missed() {
                    tracing::warn!("some of them were of {motion}, which is incomplete for it");
                }
            }
            Delivery::Restarted { .. } if stream.counters().received == 0 => {}
            Delivery::Restarted { .. } | Delivery::Gone => {
                live.iter_mut().try_for_each(|live| live.finish().map(drop))?;
                return Ok(Outcome::DaemonGone);
            }
            Delivery::Idle => {}
        }
        if let Some(offer) = live.as_mut().map_or(Ok(None), |live| live.collect(false))? {
            propose(id, stream.epoch(), offer)?;
        }
        // The end of the programme is read from the status: samples continue after it.
        if last_poll.elapsed() < POLL_INTERVAL {
            continue;
        }
        last_poll = Instant::now();
        let status = match status(id, None) {
            Err(_) if written => continue,
            status => status?,
        };
        // The end of the daemon, or another start, is what the stream reports next.
        let Some(status) = status.filter(|status| status.served.epoch == stream.epoch()) else { continue };
        live.iter_mut().for_each(|live| live.process_status(&status));
        if written {
            continue;
        }
        if let Some(driven) = status.driven
            && stream.position() >= driven
        {
            // Samples after the end of the programme are not counted.
            let beyond = stream.position() - driven;
            let StreamCounters { received, .. } = stream.counters();
            let counters = StreamCounters { received: received.saturating_sub(beyond), ..stream.counters() };
            if let Some(recorded) = collector.close()
                && let Some(why) = process_run(id, stream.epoch(), &mut results, &mut live, recorded)?
            {
                return Ok(Outcome::Unusable { why: format!("the daemon refused the model: {why}") });
            }
            if results.awaits_model()
                && let Some(why) = identify(id, stream.epoch(), &mut results, &mut live)?
            {
                return Ok(Outcome::Unusable { why: format!("the daemon refused the model: {why}") });
            }
            if let Some(live) = &mut live {
                if let Some(offer) = live.collect(true)? {
                    propose(id, stream.epoch(), offer)?;
                }
                live.finish()?.into_iter().for_each(|note| results.note(note));
            }
            with_progress_log("the diagnosis and the report", || results.finish(&status, driven, &counters))?;
            if once || live.is_none() {
                return Ok(Outcome::Written);
            }
            service.status("the results are written; the model is watched");
            written = true;
        }
        if status.progress == Progress::Stopped {
            return Ok(Outcome::Stopped { why: status.stopped.unwrap_or_default() });
        }
    }
}

/// Takes one motion in; offers the model when it was the one to identify from. Why the daemon does not want it, if so. The motion, and so the
/// model, are those of one start of the daemon, the `epoch`.
fn process_run(
    id: &RobotId,
    epoch: u64,
    results: &mut Results,
    live: &mut Option<Live>,
    mut recorded: Recorded,
) -> Result<Option<String>, Failure> {
    let identifies = results.identifies_after(&recorded);
    if !recorded.complete {
        tracing::warn!("{} is incomplete and left out", recorded.run.data.name);
        // The last run of an arm that plumbline does not drive may be too short; there may be others.
        return if identifies && results.awaits_model() { identify(id, epoch, results, live) } else { Ok(None) };
    }
    if results.has_inclinometer()
        && let Some(status) = status(id, Some(epoch))?
    {
        set_measured_mounting(&status, results.first_mounting(), &mut recorded);
    }
    results.take(recorded);
    if identifies { identify(id, epoch, results, live) } else { Ok(None) }
}

/// Identifies the model and offers it. Why the daemon does not want it, if so.
fn identify(
    id: &RobotId,
    epoch: u64,
    results: &mut Results,
    live: &mut Option<Live>,
) -> Result<Option<String>, Failure> {
    let bar = progress::bar("identifying");
    bar.busy("regression");
    let text = with_progress_log("the identification", || results.identify())?;
    bar.done();
    if let (Some(live), Some((identified, run))) = (live.as_mut(), results.identified()) {
        live.identified(identified, &text, run)?;
    }
    match ask(id, Some(epoch), &Request::OfferModel { toml: text })? {
        None => Ok(None),
        Some(Response::ModelAccepted { model }) => {
            tracing::info!("the daemon serves model {model:016x}");
            Ok(None)
        }
        // What has come to the arm is in the recordings, for the diagnosis to find.
        Some(Response::Refused { reason })
            if status(id, Some(epoch))?.is_some_and(|status| status.without_model.is_some()) =>
        {
            let note = format!(
                "when the model was identified, the arm no longer agreed with it, and was driven on without its torque: {reason}"
            );
            tracing::warn!("{note}");
            results.note(note);
            Ok(None)
        }
        Some(Response::Refused { reason }) => Ok(Some(reason)),
        Some(other) => Err(Failure::job(format!("unexpected response of the daemon to a model: {other:?}"))),
    }
}

/// Computes, and reports it in the log every [`PROGRESS_LOG_INTERVAL`].
fn with_progress_log<T>(what: &str, compute: impl FnOnce() -> T) -> T {
    std::thread::scope(|scope| {
        let (end, ended) = std::sync::mpsc::channel::<()>();
        scope.spawn(move || {
            let begin = Instant::now();
            while ended.recv_timeout(PROGRESS_LOG_INTERVAL) == Err(RecvTimeoutError::Timeout) {
                tracing::info!("{what} has been computing for {:.0} s", begin.elapsed().as_secs_f64());
            }
        });
        let found = compute();
        drop(end);
        found
    })
}

/// Largest difference of two readings of an unmoved base, in standard deviations.
const UNMOVED_BASE_SIGMAS: f64 = 4.0;

/// A run was recorded in the mounting that was measured when it began, which is only about the declared one. A base that has not moved
/// since the `first` run has one mounting, not one per reading: otherwise noise would pass for several mountings.
fn set_measured_mounting(status: &Status, first: Option<Mounting>, recorded: &mut Recorded) {
    let motions = status.gravity.iter().flat_map(|gravity| &gravity.motions);
    match motions.rev().find(|own| own.motion == recorded.number) {
        Some(own) => {
            let measured = Mounting { rho: own.rho, phi: own.phi };
            let unmoved = first.filter(|first| first.angle_to(&measured) <= UNMOVED_BASE_SIGMAS * own.std);
            recorded.run.data.mounting = unmoved.unwrap_or(measured);
            tracing::info!(
                "{}: gravity as measured, rho = {:.5}, phi = {:.5} rad, +- {:.2} mrad",
                recorded.run.data.name,
                own.rho,
                own.phi,
                1e3 * own.std
            );
        }
        None => {
            tracing::warn!("{}: no inclinometer when it began; the declared mounting is taken", recorded.run.data.name)
        }
    }
}

/// Proposes a model to the daemon. A refusal is logged.
fn propose(id: &RobotId, epoch: u64, offer: OfferedModel) -> Result<(), Failure> {
    let request = Request::ProposeModel { toml: offer.toml, proposal: offer.proposal };
    match ask(id, Some(epoch), &request)? {
        None => tracing::warn!("the daemon has ended; the model found since was not proposed"),
        Some(Response::ModelAccepted { model }) => tracing::info!("the daemon serves model {model:016x}"),
        Some(Response::ModelHeld { model }) => {
            tracing::info!("the daemon holds model {model:016x} until it is adopted")
        }
        Some(Response::Refused { reason }) => tracing::warn!("the daemon refused the model: {reason}"),
        Some(other) => return Err(Failure::job(format!("unexpected response of the daemon to a proposal: {other:?}"))),
    }
    Ok(())
}

/// Tells the daemon whether its model holds. A refusal means that it serves another one by now.
fn tell(id: &RobotId, epoch: u64, verdict: Verdict) -> Result<(), Failure> {
    let request = Request::Doubt { model: verdict.model, why: verdict.doubt };
    ask(id, Some(epoch), &request).map(drop)
}

/// Response of one start of the daemon, or of whatever start runs; `None` where it has ended: there is nobody to tell, and what was recorded is
/// evaluated all the same.
fn ask(id: &RobotId, epoch: Option<u64>, request: &Request) -> Result<Option<Response>, Failure> {
    let response = Client::connect(id, RESPONSE_TIMEOUT).and_then(|mut client| {
        epoch.into_iter().for_each(|epoch| client.bind(epoch));
        client.send(request, RESPONSE_TIMEOUT)
    });
    match response {
        Err(IpcError::NoDaemon { .. }) => Ok(None),
        response => response.map(Some).map_err(Failure::job),
    }
}

/// Status, as [`ask`].
fn status(id: &RobotId, epoch: Option<u64>) -> Result<Option<Status>, Failure> {
    match ask(id, epoch, &Request::Status {})? {
        None => Ok(None),
        Some(Response::Status(status)) => Ok(Some(*status)),
        Some(other) => Err(Failure::job(format!("unexpected response of the daemon to a status request: {other:?}"))),
    }
}
