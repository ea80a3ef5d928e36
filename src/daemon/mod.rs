//! `plumbline daemon`: connects to the arm, drives the job's programme when told to, serves the model.
//!
//! The main thread is the bridge thread: it owns everything that talks to other processes. The loop has a thread of its own for each
//! connection to the arm (`session`), and knows this side only through its rings.

mod arm;
mod check;
mod desk;
mod gravity;
mod labels;
#[cfg(test)]
mod logged;
mod recorder;
mod rest;
mod rhythm;
mod script;
mod session;
mod stop_line;

use crate::config::job::Job;
use crate::failure::Failure;
use crate::process::service::{self, Service};
use crate::process::signals::Ending;
use crate::process::{journal, owned};
use crate::setup::JobOptions;
use crate::setup::programme::Programme;
use arm::Purpose;
use check::{Answerable, Checked, Checker};
use clap::Args;
use desk::Desk;
use plumbline_core::Distribution;
use plumbline_ipc::{
    Asked, Lock, Progress, Server, ServerSettings, Session as SessionStatistics, StopListener, now_ns,
};
use plumbline_model::Mounting;
use plumbline_rt::cycle::End;
use plumbline_rt::{Controls, os};
use recorder::Recorder;
use rhythm::RequestShare;
use script::Script;
use session::Session;
use std::path::PathBuf;
use std::time::Duration;
use stop_line::StopLine;

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

/// What the bridge thread owns.
pub struct Daemon {
    stops: StopLine,
    server: Server,
    checker: Checker,
    desk: Desk,
    service: Service,
    /// When requests are answered next.
    share: RequestShare,
}

/// How a session was seen through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Seen {
    /// It ended as it was meant to.
    Through,
    /// The connection was lost, and the job allows another: what had not been driven to the end is driven again.
    Interrupted,
}

/// Runs until it is told to quit.
pub fn run(options: Options) -> Result<(), Failure> {
    let (job, robot, out) = options.job.load()?;
    let model = options.model.map(|path| model(path, options.job.root_owned)).transpose()?;
    let id = crate::setup::robot_id(&job)?;
    journal::about(id.as_str());
    // Before anything else is touched: nobody else may drive this robot.
    let lock = if options.adopt_lock { crate::setup::adopted_lock(&id)? } else { crate::setup::lock(&id)? };
    // A stop is taken from here on, also while the excitation is planned.
    let stops = stop_line(&lock, &job)?;
    let _arm = crate::setup::arm_lock(&job)?;
    let arm_limits = crate::setup::planner::arm_limits(&job)?;
    let programme = crate::setup::planner::programme(&job, &robot, &out, arm_limits.as_ref())?;
    let ending = Ending::watch()?;
    if options.end_with_stdin {
        ending.watch_parent()?;
    }
    // Its thread begins before anything asks for priority.
    let recorder = Recorder::start(&job, &id, &out)?;
    let names = programme.motions().map(|motion| (motion.number, motion.name.clone())).collect();
    let mut desk = Desk::new(job, robot, names, recorder, ending)?;
    desk.arm_limits = arm_limits;
    if let Some((path, text)) = model {
        desk.accept_text(&path, &text)?;
    }
    let server = Server::open(&id, ServerSettings::default()).map_err(Failure::job)?;
    let checker = Checker::start(desk.robot.clone(), server.epoch()).map_err(Failure::job)?;
    let (service, share) = (Service::of_environment(), RequestShare::default());
    let mut daemon = Daemon { stops, server, checker, desk, service, share };
    tracing::info!("the daemon of robot `{id}` is ready; the arm moves after `plumbline command start`");
    daemon.service.ready("at rest; the arm moves after `plumbline command start`");
    daemon.hold(daemon.desk.mounting)?;
    if daemon.desk.start && !daemon.desk.must_quit() {
        daemon.drive(&programme)?;
        daemon.hold(daemon.desk.mounting)?;
    }
    daemon.service.stopping();
    tracing::info!("the daemon ends; it has published {} samples", daemon.server.served().published);
    Ok(())
}

/// Begins to listen for stops. The thread's priority is above the bridge thread's, where the arm keeps the clock's time.
fn stop_line(lock: &Lock, job: &Job) -> Result<StopLine, Failure> {
    let failed = |error: std::io::Error| Failure::job(format!("stops can't be listened for: {error}"));
    let listener = StopListener::open(lock).map_err(failed)?;
    let rights = (!job.backend.is_fast()).then(|| session::listener_rights(&job.realtime));
    StopLine::start(listener, move || rights.iter().for_each(|rights| drop(os::become_realtime(rights))))
        .map_err(failed)
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
    /// Holds and serves until there is something to do. An arm in simulated time would only burn the processor meanwhile: it waits
    /// unconnected.
    fn hold(&mut self, mounting: Mounting) -> Result<(), Failure> {
        if self.desk.job.backend.is_fast() {
            while !self.desk.must_leave() {
                self.talk(None);
                self.service.beat(service::Progress::Waiting);
                std::thread::sleep(Duration::from_millis(1));
            }
            return Ok(());
        }
        // Whoever has ended the job in mid-motion does not want another connection. A start may be taken back by a stop until the last moment.
        while !self.desk.must_leave() {
            self.service.long_step(CONNECTION);
            let session = Session::open(self, "hold".into(), mounting, Purpose::Hold, Script::hold())?;
            self.service.status("at rest; the arm holds");
            self.see_through(session)?;
        }
        Ok(())
    }

    /// Drives every stage of the programme.
    fn drive(&mut self, programme: &Programme) -> Result<(), Failure> {
        for stage in &programme.stages {
            self.desk.progress = Progress::Driving;
            let place = stage.mounting.to_string();
            tracing::info!("the arm is mounted {place}; {} motions", stage.motions.len());
            loop {
                let script = Script::of(stage, self.desk.rest, &self.desk.ended).map_err(Failure::job)?;
                self.service.long_step(CONNECTION);
                let session = Session::open(self, place.clone(), stage.mounting, Purpose::Drive, script)?;
                self.service.status(&format!("moving; mounted {place}"));
                // Interrupted: once more, unless somebody has stopped it meanwhile.
                if self.see_through(session)? == Seen::Through || self.desk.is_over() {
                    break;
                }
            }
            if self.desk.is_over() {
                if self.desk.barred {
                    self.desk.progress = Progress::Stopped;
                }
                return Ok(());
            }
        }
        self.desk.driven = Some(self.server.served().published);
        self.desk.progress = Progress::Done;
        tracing::info!("everything was driven");
        Ok(())
    }

    /// Runs a session to its end and keeps its figures.
    fn see_through(&mut self, session: Session) -> Result<Seen, Failure> {
        let ended = session.run(self);
        self.stops.connect(None);
        self.desk.braking = false;
        let (statistics, end) = ended?;
        tracing::info!("{}", account(&statistics));
        let words = statistics.link.as_ref().and_then(|link| link.fault.clone()).unwrap_or_else(|| end.to_string());
        self.desk.sessions.push(statistics);
        match end {
            End::Quit => Ok(Seen::Through),
            end if arm::goes_on(&self.desk, &end) => {
                self.desk.recoveries += 1;
                tracing::warn!("{words}; going on by itself, time {}, as the job allows", self.desk.recoveries);
                self.service.long_step(CONNECTION);
                arm::recover(self)?;
                Ok(Seen::Interrupted)
            }
            End::NotRealTime => {
                let refusals = self.desk.degraded.join("; ");
                Err(Failure::job(format!("the loop ended: {words} (realtime.on-refusal): {refusals}")))
            }
            _ => Err(Failure::job(format!("the loop ended: {words}"))),
        }
    }

    /// Does what takes a robot seconds on a thread of its own, and answers requests meanwhile: a stop is heard then, too.
    fn meanwhile<T: Send>(&mut self, work: impl FnOnce() -> T + Send) -> Result<T, Failure> {
        std::thread::scope(|scope| {
            let thread = scope.spawn(work);
            while !thread.is_finished() {
                self.talk(None);
                std::thread::sleep(Duration::from_millis(1));
            }
            thread.join().map_err(|_panic| Failure::job("the thread that connects to the arm panicked"))
        })
    }

    /// Takes note of a stop that has come. `controls` are the running loop's, where one runs.
    fn take_stop(&mut self, controls: Option<&Controls>) {
        if let Some(order) = self.stops.attend(controls) {
            self.desk.take_stop(order, controls);
        }
    }

    /// Takes note of a stop; answers the requests that are waiting, where their share of the time allows that.
    fn talk(&mut self, controls: Option<&Controls>) {
        self.take_stop(controls);
        self.desk.announce_end();
        let begin = now_ns();
        if !self.share.is_due(begin) {
            return;
        }
        let Daemon { server, desk, checker, .. } = self;
        while let Some(Answerable { ticket, order, checked }) = checker.take() {
            if matches!(checked, Checked::Garbled(_)) {
                server.garbled();
            }
            let response = desk.conclude(checked, &server.served(), controls);
            server.answer(ticket, order, &response);
        }
        server.serve(checker.room(begin), |asked, served| match asked {
            Asked::Light(request) => Some(desk.answer(request, served, controls)),
            Asked::Heavy(ticket, bytes) => {
                checker.give(ticket, bytes, desk.mounting, begin);
                None
            }
        });
        while let Some(news) = server.take_news() {
            desk.news(&news, controls);
        }
        let end = now_ns();
        server.answered_for(end.saturating_sub(begin));
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
