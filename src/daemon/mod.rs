//! `plumbline daemon`: connects to the arm, drives the job's programme on request, serves the model.
//!
//! The main thread is the bridge thread: it owns everything that communicates with other processes. The loop has a thread of its own for each
//! connection to the arm (`session`), and reaches this side only through its rings.

mod check;
#[cfg(test)]
mod fixture;
mod gravity;
mod guest;
mod job_setup;
mod labels;
#[cfg(test)]
mod logged;
pub mod metrics;
mod models;
mod recorder;
mod requests;
mod rest_poses;
mod schedule;
mod script;
mod session;
mod state;
mod status;
mod stop_relay;

use crate::config::job::Job;
use crate::failure::Failure;
use crate::process::service::{self, Service};
use crate::process::signals::Ending;
use crate::process::{journal, owned};
use crate::setup::programme::Programme;
use crate::setup::{self, JobOptions};
use check::{Answerable, Checked, Checker};
use clap::Args;
use job_setup::JobSetup;
use metrics::Metrics;
use plumbline_core::{ArmConnector, Distribution, Purpose, Validity};
use plumbline_ipc::{
    IncomingRequest, Lock, ModelHeader, Progress, Server, ServerSettings, Session as SessionStatistics, StopListener,
    now_ns,
};
use plumbline_model::Mounting;
use plumbline_rt::cycle::End;
use plumbline_rt::{Controls, become_realtime};
use recorder::Recorder;
use schedule::RequestShare;
use script::Script;
use session::Session;
use state::DaemonState;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;
use stop_relay::StopRelay;

/// Options of `plumbline daemon`.
#[derive(Args)]
pub struct Options {
    #[command(flatten)]
    job: JobOptions,
    /// Serve this model from the start
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// The robot's lock is passed on by the process that has started this one
    #[arg(long, hide = true)]
    adopt_lock: bool,
    /// Brake and end when standard input ends: for a program that starts a daemon and may die
    #[arg(long)]
    end_with_stdin: bool,
}

/// The longest that connecting to a robot, or its recovery, takes before it fails by itself; the watchdog waits for it.
const CONNECTION: Duration = Duration::from_secs(90);

pub struct Daemon {
    stops: StopRelay,
    server: Server,
    checker: Checker,
    state: DaemonState,
    service: Service,
    share: RequestShare,
    /// Model that was published last, as the daemon fills its header.
    published: ModelHeader,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum SessionEnd {
    /// Its script was driven, or the end was requested.
    Completed,
    /// The connection was lost, and the job allows another: motions that were not driven to their end are driven again.
    Interrupted,
}

/// Runs until the end is requested.
pub fn run(options: Options) -> Result<(), Failure> {
    let (job, robot, out) = options.job.load()?;
    let model = options.model.map(|path| model(path, options.job.root_owned)).transpose()?;
    let id = setup::robot_id(&job)?;
    journal::about(id.as_str());
    // Before anything else: no other process may drive this robot.
    let lock = if options.adopt_lock { setup::adopted_lock(&id)? } else { setup::lock(&id)? };
    // A stop is taken from here on, also while the excitation is planned.
    let stops = stop_relay(&lock, &job)?;
    let endpoint = metrics::bind(&job)?;
    let arm: Arc<dyn ArmConnector> = setup::backend::connector(&job, &robot)?.into();
    let _arm = setup::arm_lock(arm.as_ref())?;
    let arm_limits = arm.read_limits().map_err(Failure::job)?;
    let programme = setup::programme::plan_or_load(&job, &robot, &out, arm_limits.as_ref())?;
    let ending = Ending::watch()?;
    if options.end_with_stdin {
        ending.watch_parent()?;
    }
    // Their threads begin before any other has a real-time priority.
    let recorder = Recorder::start(&job, &id, &out)?;
    let _metrics = endpoint.map(|listener| Metrics::start(listener, &id)).transpose().map_err(Failure::job)?;
    let names = programme.motions().map(|motion| (motion.number, motion.name.clone())).collect();
    let rest = setup::rest(&job, &robot)?;
    let setup = JobSetup { job, robot, arm, arm_limits, rest, names };
    let mut state = DaemonState::new(setup, recorder, ending)?;
    if let Some((path, text)) = model {
        state.accept_text(&path, &text)?;
    }
    let server = Server::open(&id, ServerSettings::default()).map_err(Failure::job)?;
    let checker = Checker::start(state.setup.robot.clone(), server.epoch()).map_err(Failure::job)?;
    let (service, share) = (Service::of_environment(), RequestShare::default());
    let mut daemon = Daemon { stops, server, checker, state, service, share, published: ModelHeader::default() };
    if daemon.state.setup.listens() {
        daemon.listen(&id, &programme)?;
        return daemon.end();
    }
    tracing::info!("the daemon of robot `{id}` is ready; the arm moves after `plumbline command start`");
    daemon.service.ready("at rest; the arm moves after `plumbline command start`");
    daemon.hold(daemon.state.mounting)?;
    if daemon.state.programme.start && !daemon.state.must_quit() {
        daemon.drive(&programme)?;
        daemon.hold(daemon.state.mounting)?;
    }
    daemon.end()
}

/// Starts the thread that receives stops. Its priority is above the bridge thread's, where a loop commands the arm at the pace of the clock.
fn stop_relay(lock: &Lock, job: &Job) -> Result<StopRelay, Failure> {
    let failed = |error: std::io::Error| Failure::job(format!("stops can't be listened for: {error}"));
    let listener = StopListener::open(lock).map_err(failed)?;
    let rights = job.backend.needs_realtime().then(|| session::stop_listener_rights(&job.realtime));
    StopRelay::start(listener, move || rights.iter().for_each(|rights| drop(become_realtime(rights)))).map_err(failed)
}

/// A model file that a person named, with its text.
fn model(path: PathBuf, root_owned: bool) -> Result<(PathBuf, String), Failure> {
    if root_owned {
        owned::trusted(&path)?;
    }
    let text = owned::read_model(&path)?;
    Ok((path, text))
}

impl Daemon {
    fn end(self) -> Result<(), Failure> {
        self.service.stopping();
        tracing::info!("the daemon ends; it has published {} samples", self.server.served().published);
        Ok(())
    }

    /// Holds and serves until there is something to do. An arm in simulated time would only burn the processor meanwhile: it waits
    /// unconnected.
    fn hold(&mut self, mounting: Mounting) -> Result<(), Failure> {
        if self.state.setup.job.backend.is_fast() {
            while !self.state.must_leave() {
                self.answer_requests(None);
                self.service.beat(service::Progress::Waiting);
                std::thread::sleep(Duration::from_millis(1));
            }
            return Ok(());
        }
        // Whoever has ended the job in mid-motion does not want another connection. A start may be taken back by a stop until the last moment.
        while !self.state.must_leave() {
            self.service.long_step(CONNECTION);
            let session = Session::open(self, "hold".into(), mounting, Purpose::Monitor, Script::hold())?;
            self.service.status("at rest; the arm holds");
            self.run_session(session)?;
        }
        Ok(())
    }

    fn drive(&mut self, programme: &Programme) -> Result<(), Failure> {
        self.state.programme.motions =
            programme.motions().map(|motion| (motion.number, motion.ticks() as u64)).collect();
        for stage in &programme.stages {
            self.state.programme.progress = Progress::Driving;
            let place = stage.mounting.to_string();
            tracing::info!("the arm is mounted {place}; {} motions", stage.motions.len());
            loop {
                let script =
                    Script::of(stage, self.state.setup.rest, &self.state.programme.ended).map_err(Failure::job)?;
                self.service.long_step(CONNECTION);
                let session = Session::open(self, place.clone(), stage.mounting, Purpose::Drive, script)?;
                self.service.status(&format!("moving; mounted {place}"));
                let end = self.run_session(session)?;
                if self.state.is_paused() && !self.state.must_quit() {
                    self.hold(stage.mounting)?;
                    if std::mem::take(&mut self.state.programme.continues) {
                        self.state.stops.stopped = None;
                        continue;
                    }
                }
                // Interrupted: once more, unless the arm was stopped meanwhile.
                if end == SessionEnd::Completed || self.state.is_over() {
                    break;
                }
            }
            if self.state.is_over() {
                if self.state.stops.barred {
                    self.state.programme.progress = Progress::Stopped;
                }
                return Ok(());
            }
        }
        self.state.programme.driven = Some(self.server.served().published);
        self.state.programme.progress = Progress::Done;
        tracing::info!("everything was driven");
        Ok(())
    }

    /// Runs a session to its end and keeps its figures.
    fn run_session(&mut self, session: Session) -> Result<SessionEnd, Failure> {
        let ended = session.run(self);
        self.stops.connect(None);
        self.state.stops.braking = false;
        let (statistics, end) = ended?;
        tracing::info!("{}", account(&statistics));
        let words = session::end_words(&statistics, &end);
        self.state.history.sessions.push(statistics);
        match end {
            End::Quit => Ok(SessionEnd::Completed),
            end if self.state.may_recover(&end) => {
                self.state.programme.recoveries += 1;
                tracing::warn!(
                    "{words}; going on by itself, time {}, as the job allows",
                    self.state.programme.recoveries
                );
                self.service.long_step(CONNECTION);
                let arm = Arc::clone(&self.state.setup.arm);
                self.meanwhile(|| arm.recover())?.map_err(Failure::job)?;
                Ok(SessionEnd::Interrupted)
            }
            End::NotRealTime => {
                let refusals = self.state.history.degraded.join("; ");
                Err(Failure::job(format!("the loop ended: {words} (realtime.on-refusal): {refusals}")))
            }
            _ => Err(Failure::job(format!("the loop ended: {words}"))),
        }
    }

    /// Does `work` that may block for seconds on a thread of its own, and takes stops and answers requests meanwhile.
    fn meanwhile<T: Send>(&mut self, work: impl FnOnce() -> T + Send) -> Result<T, Failure> {
        std::thread::scope(|scope| {
            let thread = scope.spawn(work);
            while !thread.is_finished() {
                self.answer_requests(None);
                std::thread::sleep(Duration::from_millis(1));
            }
            thread.join().map_err(|_panic| Failure::job("the thread that connects to the arm panicked"))
        })
    }

    /// Takes a stop that has come. `controls` are the running loop's, where one runs.
    fn take_stop(&mut self, controls: Option<&Controls>) {
        if let Some(order) = self.stops.attend(controls) {
            self.state.take_stop(order, controls);
        }
    }

    /// Publishes the model that the loop serves for clients that evaluate it themselves, where it has changed: `model` (0 for none) under
    /// `gravity`, on an arm that compensates `vendor` \[m/s2\].
    fn publish_model(&mut self, model: u64, gravity: [f64; 3], vendor: [f64; 3]) {
        let text = self.state.models.text(model).filter(|_| model != 0);
        let header = match text {
            Some(_) => {
                let doubted = self.state.models.doubted() == model;
                let validity = if doubted { Validity::Doubtful } else { Validity::Valid };
                let validity = validity as u32;
                ModelHeader { model, validity, gravity, gravity_vendor: vendor, ..ModelHeader::default() }
            }
            None if self.published.model == 0 => self.published,
            None => ModelHeader { validity: Validity::Withdrawn as u32, ..ModelHeader::default() },
        };
        if header != self.published {
            self.server.model(header, text.unwrap_or_default());
            self.published = header;
        }
    }

    /// Takes a stop; answers the requests that wait, within their share of the time.
    fn answer_requests(&mut self, controls: Option<&Controls>) {
        self.take_stop(controls);
        self.state.announce_end();
        let begin = now_ns();
        if !self.share.is_due(begin) {
            return;
        }
        let Daemon { server, state, checker, .. } = self;
        while let Some(Answerable { ticket, order, checked }) = checker.take() {
            if matches!(checked, Checked::Garbled(_)) {
                server.count_malformed_request();
            }
            let response = state.conclude(checked, &server.served(), controls);
            server.answer(ticket, order, &response);
        }
        server.serve(checker.room(begin), |asked, served| match asked {
            IncomingRequest::Light(request) => Some(state.answer(request, served, controls)),
            IncomingRequest::Heavy(ticket, bytes) => {
                checker.give(ticket, bytes, state.mounting, begin);
                None
            }
        });
        while let Some(news) = server.take_follower_event() {
            state.news(&news, controls);
        }
        let end = now_ns();
        server.add_request_time(end.saturating_sub(begin));
        self.share.spent(begin, end);
    }
}

/// How a connection's time was kept, in one line.
fn account(of: &SessionStatistics) -> String {
    let us = |what: &str, times: &Distribution| {
        let [p50, p99, p999, max] = times.in_us()?;
        Some(format!("; {what} p50 {p50:.1} p99 {p99:.1} p99.9 {p999:.1} max {max:.1} us"))
    };
    let counts = &of.statistics;
    let equal = if counts.accounted() { "=" } else { "DIFFERS FROM" };
    let clock = counts.clock.map_or(String::new(), |clock| format!(", {clock} by this machine's clock"));
    let late = counts.late.map_or(String::new(), |late| format!("{late} late, "));
    let times = [("wake-up", &counts.wake_up), ("execution", &counts.execution), ("bridge", &of.bridge)];
    format!(
        "session `{}`: {} periods {equal} {} cycles + {} skipped (longest run {}){clock}; {late}{} dropped records, {} allocations{}",
        of.name,
        counts.elapsed,
        counts.cycles,
        counts.lost,
        counts.longest_lost,
        counts.dropped_records,
        of.allocations.map_or("unwatched".to_string(), |count| count.to_string()),
        times.into_iter().filter_map(|(what, times)| us(what, times)).collect::<String>(),
    )
}

#[cfg(test)]
mod tests;
