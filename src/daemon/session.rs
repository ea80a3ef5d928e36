//! One connection to the arm: builds the loop, runs it on a thread of its own, and bridges it to shared memory meanwhile.

use super::Daemon;
use super::arm::{self, Connected, Purpose, Robot, connect};
use super::desk::Desk;
use super::gravity::{Verdict, Watch, uncompensated};
use super::labels::Labels;
use super::recorder::{Left, Tape};
use super::rhythm::Rhythm;
use super::script::{Next, Planned, Script};
use crate::config::job::{self, Job, OnRefusal};
use crate::failure::Failure;
use crate::process::service;
use crate::recording::about::{Reason, RecordedModel, panic_message};
use crate::setup::{planner, programme};
use nalgebra::Vector3;
use plumbline_core::{Backend, Histogram, Limits, MAX_JOINTS, Phase, Record, Sink};
use plumbline_ipc::{FeedForwardMessage, Progress, Session as SessionStatistics, now_ns};
use plumbline_model::{Mounting, NoModel, Reach, ServedModel};
use plumbline_rt::cycle::{Cycle, End, Outcome};
use plumbline_rt::os::Rights;
use plumbline_rt::recorder::Drain;
use plumbline_rt::{Controls, CycleSettings, Event, GuardSettings, Handles, Told, cycle, os, recorder};
use plumbline_sim::Gate;
use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Records between the loop and the bridge thread: eight seconds at 1 kHz.
pub(super) const RING: usize = 8192;
/// Records that the loop itself keeps: what the bridge thread may be behind at the end, whatever has become of the ring.
const FLIGHT: usize = 2048;
/// Records taken from the ring at once.
const DRAIN: usize = 512;
/// Pause of the bridge thread when there is nothing to do.
const PAUSE: Duration = Duration::from_micros(200);
/// Time without a heartbeat after which the loop brakes an arm that moves \[ms\]: either this thread or the one that listens for stops hangs.
const SILENCE: u64 = 1000;
/// Records that simulated time may run ahead of an estimator that watches it: two seconds.
const AHEAD: u64 = 2000;
/// The longest that the loop takes to end after a panic of the bridge thread: a stop, and a word of the robot.
const PANIC_STOP: Duration = Duration::from_secs(5);
/// How many levels the bridge thread's priority lies below the loop's.
const BELOW_LOOP: u8 = 10;

/// A running loop and this side of it.
pub struct Session {
    name: String,
    mounting: Mounting,
    handles: Handles,
    drain: Drain,
    /// Back-pressure of an arm that runs as fast as it can.
    gate: Option<Arc<Gate>>,
    /// The robot at the other end of a network.
    robot: Option<Robot>,
    thread: Option<JoinHandle<Left>>,
    tape: Tape,
    script: Script,
    purpose: Purpose,
    /// Identity of the model handed to this loop, 0 for none.
    model: u64,
    /// It was said what the loop's thread was granted.
    judged: bool,
    /// When the next record is due.
    records_due: Rhythm,
    /// Gravity that it was handed over with \[m/s2\].
    gravity: Vector3<f64>,
    /// Gravity that the arm's own controller compensates \[m/s2\].
    vendor: Vector3<f64>,
    /// What the records are computed with, which are behind.
    labels: Labels,
    /// Events that were taken out and not looked at yet.
    told: VecDeque<Told>,
    /// Simulated time waits for the estimator.
    waiting: bool,
    /// When the arm no longer holds for a model, while it does \[ns\].
    model_due_ns: Option<u64>,
    /// From state read to shared memory \[ns\].
    bridged: Histogram,
    records: Vec<Record>,
}

impl Session {
    /// Connects to the arm in `mounting` and starts the loop. The loop asks for real-time rights when the arm keeps wall-clock time.
    ///
    /// Where somebody stops or ends everything while the robot is being reached, the loop gets no order and ends at once.
    pub fn open(
        daemon: &mut Daemon,
        name: String,
        mounting: Mounting,
        purpose: Purpose,
        script: Script,
    ) -> Result<Session, Failure> {
        let Connected { arm, gate, robot: connected, vendor } = connect(daemon, mounting, purpose)?;
        let desk = &mut daemon.desk;
        let unwanted = purpose == Purpose::Drive && desk.is_over();
        let script = if unwanted { Script::hold() } else { script };
        let uncompensated =
            purpose == Purpose::Drive && desk.commands_torques() && uncompensated(&mounting.gravity(), &vendor);
        desk.recent.clear();
        desk.gravity.connect(mounting, connected.as_ref().and_then(Robot::side), vendor, uncompensated);
        let (job, robot) = (&desk.job, &desk.robot);
        let (limits, envelope) = planner::held_to(job, robot, connected.as_ref().map(Robot::limits))?;
        if let Some(connected) = &connected {
            // The programme was checked under the limits of the arm that the daemon found when it started.
            if purpose == Purpose::Drive && desk.arm_limits.as_ref() != Some(connected.limits()) {
                return Err(other_limits(job));
            }
            // A real arm stands wherever somebody left it.
            if let Some(target) = script.first_target() {
                stands_inside(&limits, &connected.pose()[..robot.chain.len()])?;
                programme::free_way(job, robot, connected.limits(), &connected.pose(), &target)?;
            }
        }
        // An arm that is only watched is sent nothing: it may stand outside the job's limits, and be guided by hand.
        let watched = purpose == Purpose::Hold && connected.is_some();
        let mut settings = CycleSettings::new(GuardSettings {
            limits: if watched { anywhere(limits) } else { limits },
            envelope,
            workspace: Some(job.workspace(&robot.workspace)).filter(|_| !watched),
            tracking: [if watched { TAU } else { job.safety.tracking_error }; MAX_JOINTS],
        });
        settings.max_consecutive_lost = u64::from(job.safety.max_lost);
        settings.queue = 3 * desk.names.len() + 8;
        settings.rights = if gate.is_some() { Rights::NONE } else { rights(&job.realtime, 0) };
        settings.max_silence = gate.is_none().then_some(SILENCE);
        settings.must_be_realtime = job.realtime.on_refusal == OnRefusal::Refuse;
        let (sink, drain) = recorder::ring(RING);
        settings.flight = FLIGHT;
        let reach = Box::new(Reach(robot.chain.clone()));
        let (mut cycle, handles) = cycle::new(arm, sink, Some(reach), settings.clone()).map_err(Failure::job)?;
        // The bridge's own priority goes up before the loop starts, and stays below it.
        if gate.is_none() {
            os::become_realtime(&rights(&desk.job.realtime, BELOW_LOOP));
        }
        // From here on a stop reaches this loop by itself; one that came before stands.
        daemon.stops.connect(Some(Arc::clone(&handles.controls)));
        if let Some(order) = daemon.stops.attend(Some(&handles.controls)) {
            desk.take_stop(order, Some(&handles.controls));
        }
        let unwanted = purpose == Purpose::Drive && desk.is_over();
        let script = if unwanted { Script::hold() } else { script };
        let tape = desk.recorder.tape(desk, mounting, &name, &settings, &handles.controls);
        let mut session = Session {
            name,
            mounting,
            handles,
            drain,
            gate,
            robot: connected,
            thread: None,
            tape,
            script,
            purpose,
            model: 0,
            judged: false,
            records_due: Rhythm::default(),
            gravity: mounting.gravity(),
            vendor,
            labels: Labels::new(mounting.gravity()),
            told: VecDeque::new(),
            waiting: false,
            model_due_ns: None,
            bridged: Histogram::default(),
            records: Vec::with_capacity(DRAIN),
        };
        // Connecting took its time: what is handed over goes by the inclinometer of now.
        desk.gravity.tick(now_ns(), false);
        // The model and the first orders are there before the first cycle, so that a seed gives the same motion every time.
        session.hand_over_model(desk);
        let feeds = |franka: &job::Franka| franka.torque.feed_forward;
        if uncompensated && !unwanted && (session.model == 0 || !desk.job.backend.franka.as_ref().is_some_and(feeds)) {
            return Err(Failure::job(falls(&vendor, &desk.gravity)));
        }
        session.give_orders();
        if unwanted {
            session.handles.controls.quit();
        }
        let thread = std::thread::Builder::new().name("plumbline-loop".into());
        session.thread = Some(thread.spawn(move || see_through(&mut cycle)).map_err(Failure::job)?);
        Ok(session)
    }

    /// Bridges until the loop ends.
    ///
    /// A panic on this thread would end the process, and the loop with it in mid-motion: the loop is ended first.
    pub fn run(mut self, daemon: &mut Daemon) -> Result<(SessionStatistics, End), Failure> {
        let controls = Arc::clone(&self.handles.controls);
        match unless_panic(&controls, || self.bridge_until_end(daemon)) {
            Ok(ended) => ended,
            Err(message) => self.end_after_panic(&message),
        }
    }

    fn bridge_until_end(&mut self, daemon: &mut Daemon) -> Result<(SessionStatistics, End), Failure> {
        daemon.desk.mounting = self.mounting;
        while !self.thread.as_ref().is_none_or(JoinHandle::is_finished) {
            daemon.take_stop(Some(&self.handles.controls));
            let busy = self.bridge(daemon);
            self.hear_of_rights(&mut daemon.desk);
            self.handle_events(&mut daemon.desk);
            daemon.desk.gravity.tick(now_ns(), self.model != 0);
            daemon.desk.note_gravity();
            self.hand_over_model(&mut daemon.desk);
            self.give_orders();
            self.check_model_timeout(&mut daemon.desk);
            self.keep_pace_with_the_watch(daemon);
            if let (Purpose::Hold, Some(robot)) = (self.purpose, &mut self.robot) {
                robot.watch();
            }
            self.talk(daemon);
            daemon.service.beat(self.progress());
            if daemon.desk.must_leave() {
                // Before the loop hears of it: the stop's event and recording carry the reason.
                daemon.desk.announce_end();
                self.handles.controls.quit();
                self.open_gate();
            }
            if !busy {
                self.pause();
            }
        }
        let joined = self.thread.take().and_then(|thread| thread.join().ok());
        let left = joined.ok_or(Failure::job("the loop's thread is gone"))?;
        // One that the loop has not heard any more stands all the same.
        daemon.take_stop(Some(&self.handles.controls));
        while self.bridge(daemon) {}
        self.hear_of_rights(&mut daemon.desk);
        self.handle_events(&mut daemon.desk);
        self.handles.free_retired();
        match left {
            Left::Panicked { ref message, .. } => {
                let failure = format!("the loop's thread panicked; the arm was stopped by its own means: {message}");
                self.tape.close(&left, &failure, Vec::new(), false);
                Err(Failure::job(failure))
            }
            Left::Ended(ref outcome) => {
                let statistics = self.statistics(outcome);
                let words = statistics.link.as_ref().and_then(|link| link.fault.clone());
                let words = words.unwrap_or_else(|| outcome.end.to_string());
                let goes_on = arm::goes_on(&daemon.desk, &outcome.end);
                self.tape.close(&left, &words, self.next_step(&outcome.end), goes_on);
                Ok((statistics, outcome.end))
            }
        }
    }

    /// Waits for a loop that was told to end because the bridge thread panicked: it brakes an arm that moves. The recording comes after that,
    /// because the session may be half changed and the next panic ends the process.
    fn end_after_panic(&mut self, message: &str) -> Result<(SessionStatistics, End), Failure> {
        let failure = format!("the bridge thread panicked, and the arm was stopped: {message}");
        tracing::error!("{failure}");
        let thread = self.thread.take().inspect(|thread| await_end(thread, self.gate.as_deref()));
        if let Some(left) = thread.filter(JoinHandle::is_finished).and_then(|thread| thread.join().ok()) {
            self.tape.blame(Reason::new("panic", &failure));
            self.records.clear();
            self.drain.take_into(&mut self.records, RING);
            self.tape.keep(&self.records);
            while let Ok(told) = self.handles.events.pop() {
                self.tape.tell(told);
            }
            self.tape.close(&left, &failure, Vec::new(), false);
        }
        Err(Failure::job(failure))
    }

    /// What an operator does after an end that the robot explains itself.
    fn next_step(&self, end: &End) -> Vec<String> {
        match (end, &self.robot) {
            (End::Fault(fault), Some(robot)) => vec![robot.next_step(fault)],
            _ => Vec::new(),
        }
    }

    /// Takes stops, then answers requests.
    fn talk(&mut self, daemon: &mut Daemon) {
        let waited = self.handles.controls.is_waiting();
        daemon.talk(Some(&self.handles.controls));
        if waited && !self.handles.controls.is_waiting() {
            // The loop hears of its permission by its next state.
            self.open_gate();
        }
    }

    /// Sleeps until the next record is due. An arm that keeps the clock's time makes one every millisecond: this thread then wakes up right behind
    /// the loop, once, instead of looking again and again.
    fn pause(&self) {
        match self.records_due.next_look(now_ns()).filter(|_| self.gate.is_none()) {
            Some(at_ns) => os::sleep_until(at_ns),
            None => std::thread::sleep(PAUSE),
        }
    }

    /// What the watchdog goes by: the cycles, where the arm keeps wall-clock time. Simulated time may stand still on purpose.
    fn progress(&self) -> service::Progress {
        match self.gate {
            Some(_) => service::Progress::Waiting,
            None => service::Progress::Count(self.handles.controls.cycles()),
        }
    }

    /// Moves records from the ring to shared memory; whether there were any.
    fn bridge(&mut self, daemon: &mut Daemon) -> bool {
        self.records.clear();
        let taken = self.drain.take_into(&mut self.records, DRAIN);
        let Some(&last) = self.records.last() else { return false };
        self.hear();
        // The torque first: whoever waits for it drives something.
        let gravity = self.labels.at(last.cycle).into();
        daemon.server.feed_forward(FeedForwardMessage::new(
            &last,
            daemon.desk.robot.chain.len(),
            gravity,
            self.vendor.into(),
        ));
        daemon.server.publish(&self.records);
        self.tape.keep(&self.records);
        if let Some(why) = daemon.desk.gravity.take(&self.records) {
            daemon.desk.stop_for_mounting(why, &self.handles.controls);
        }
        daemon.desk.recent.take(&self.records);
        daemon.desk.last = last;
        self.records_due.saw(last.stamp_ns, last.work_ns);
        let now = now_ns();
        for record in &self.records {
            self.bridged.add(now.saturating_sub(record.stamp_ns));
        }
        if let Some(gate) = &self.gate {
            gate.consumed(taken as u64);
        }
        true
    }

    /// Says as soon as it is known whether this loop is real-time or degraded.
    fn hear_of_rights(&mut self, desk: &mut Desk) {
        let Some(granted) = self.handles.granted.get().filter(|_| !self.judged) else { return };
        self.judged = true;
        desk.degraded = granted.refusals().map(str::to_string).collect();
        for refusal in &desk.degraded {
            tracing::warn!("degraded, not real-time: {refusal}");
        }
    }

    /// What watches the served model must see it in time: an arm that runs as fast as it can waits for the estimator.
    fn keep_pace_with_the_watch(&mut self, daemon: &Daemon) {
        let Some(gate) = self.gate.as_ref().filter(|_| daemon.desk.job.live.watch && self.model != 0) else { return };
        let served = daemon.server.served();
        let behind = served.published.saturating_sub(served.acknowledged);
        let watched = !served.followers.is_empty();
        if !self.waiting && watched && behind > AHEAD {
            self.waiting = true;
            gate.shut();
        } else if self.waiting && (!watched || behind < AHEAD / 2) && !self.handles.controls.is_waiting() {
            self.waiting = false;
            gate.open();
        }
    }

    /// Stops an arm that has held for a model for too long. The clock is this machine's: simulated time stands still meanwhile.
    fn check_model_timeout(&mut self, desk: &mut Desk) {
        let controls = &self.handles.controls;
        let holds = desk.model.is_none() && self.script.awaits_model() && controls.phase() == Phase::Hold;
        if !holds || desk.is_over() {
            self.model_due_ns = None;
            return;
        }
        let seconds = desk.job.safety.model_timeout;
        let due = *self.model_due_ns.get_or_insert(now_ns().saturating_add((1e9 * seconds) as u64));
        if now_ns() >= due {
            let why = format!("the estimator gave no model within {seconds} s (safety.model-timeout)");
            desk.stop_without_model(why, controls);
            self.open_gate();
        }
    }

    /// Takes the events out. That of a model's first cycle is there before that cycle's record, and the flight recorder has those of a cycle before
    /// its record, too.
    fn hear(&mut self) {
        while let Ok(told) = self.handles.events.pop() {
            self.tape.tell(told);
            match told.event {
                Event::Serving { .. } => self.labels.serving(told.cycle),
                Event::Distrusted { model, instead } => {
                    let gravity = self.labels.fell_back(told.cycle);
                    // Unless another has been handed over since.
                    if let (Some(gravity), true) = (gravity, self.model == model) {
                        (self.model, self.gravity) = (instead, gravity);
                    }
                }
                _ => {}
            }
            self.told.push_back(told);
        }
    }

    fn handle_events(&mut self, desk: &mut Desk) {
        self.hear();
        while let Some(told) = self.told.pop_front() {
            let event = told.event;
            desk.log(&event);
            if let Event::Ended { motion } = event {
                desk.ended.push(motion);
            }
            match self.script.after(&event) {
                Next::GoOn => {}
                Next::AwaitModel if self.model == 0 => {
                    desk.progress = Progress::AwaitingModel;
                    // Simulated time stands still while the estimator works.
                    self.gate.iter().for_each(|gate| gate.shut());
                }
                Next::AwaitModel => {}
                Next::Over => self.handles.controls.quit(),
                // A stop before the programme began does not use it up.
                Next::Aborted if desk.start => desk.progress = Progress::Stopped,
                Next::Aborted => {}
            }
            if event == Event::Stopped {
                self.gate.iter().for_each(|gate| gate.shut());
            }
            if event == Event::Resumed {
                self.open_gate();
            }
        }
        self.handles.free_retired();
    }

    /// Gives the loop the model that the daemon has accepted, for the gravity of now; takes it away where it may not be served.
    fn hand_over_model(&mut self, desk: &mut Desk) {
        let Some(accepted) = desk.model.as_ref().filter(|_| desk.may_hand_over(&self.mounting)) else { return };
        match desk.gravity.verdict(accepted) {
            Verdict::Serve(gravity) if accepted.id != self.model || gravity != self.gravity => {
                let served = ServedModel::new(accepted.id, &accepted.model, &gravity, &self.vendor);
                if self.handles.models.serve(Box::new(served)).is_ok() {
                    (self.model, self.gravity) = (accepted.id, gravity);
                    self.labels.handed(accepted.id, gravity);
                    let vendor = Some(self.vendor.into());
                    self.tape
                        .handed(RecordedModel { id: accepted.id, gravity: gravity.into(), vendor }, &accepted.text);
                    self.open_gate();
                }
            }
            Verdict::Serve(_) | Verdict::Wait(_) => {}
            Verdict::Refuse(why) => self.withdraw(desk, why),
        }
    }

    /// Ends the service of a model: an arm that moves is stopped first, and then has none.
    fn withdraw(&mut self, desk: &mut Desk, why: String) {
        let controls = &self.handles.controls;
        if self.model == 0 {
            return;
        }
        let phase = controls.phase();
        let moving = matches!(phase, Phase::Approach | Phase::Excite | Phase::Return);
        // Also where it holds between two motions: orders that wait would go on without a model.
        if moving || (phase == Phase::Hold && self.purpose == Purpose::Drive) {
            desk.stop_for_mounting(why, controls);
        } else if phase != Phase::Stop && self.handles.models.serve(Box::new(NoModel)).is_ok() {
            self.model = 0;
            self.labels.handed(0, self.gravity);
            self.tape.handed(RecordedModel { id: 0, gravity: [0.0; 3], vendor: None }, "");
        }
    }

    fn give_orders(&mut self) {
        while self.handles.orders.room() > 0 {
            let Some(Planned { order, given }) = self.script.next(self.model != 0) else { return };
            // There is room: it was asked for above, and this thread alone fills the ring.
            if self.handles.orders.give(order).is_ok() {
                self.tape.ordered(given);
            }
        }
    }

    fn open_gate(&self) {
        self.gate.iter().for_each(|gate| gate.open());
    }

    fn statistics(&self, outcome: &Outcome) -> SessionStatistics {
        SessionStatistics {
            name: self.name.clone(),
            statistics: outcome.summary,
            allocations: outcome.allocations,
            bridge: self.bridged.distribution(),
            refusals: outcome.granted.refusals().map(str::to_string).collect(),
            end: match outcome.last_stop {
                Some(reason) if outcome.end == End::Quit => format!("stopped: {reason}"),
                _ => outcome.end.to_string(),
            },
            link: self.robot.as_ref().map(|robot| match outcome.end {
                End::Fault(fault) => robot.link(Some(&fault)),
                _ => robot.link(None),
            }),
        }
    }
}

/// Why such an arm is not driven without a model.
fn falls(vendor: &Vector3<f64>, gravity: &Watch) -> String {
    let [x, y, z]: [f64; 3] = (*vendor).into();
    let why = gravity.said().unwrap_or("no model is there that is checked and used");
    format!(
        "the arm compensates gravity along [{x:.2}, {y:.2}, {z:.2}] m/s2, which is not the one that acts: commanded by torques it would fall \
         without a model from the first cycle on ({why}). Start the daemon with `--model` and `backend.franka.torque.feed-forward`, let the arm \
         rest before the start, or command positions"
    )
}

/// The arm is not the one that was there when the daemon started, or was updated since.
fn other_limits(job: &Job) -> Failure {
    let job = job.file.display();
    Failure::job(format!(
        "the connected arm has other limits than when this daemon started, and the programme was not checked under them; nothing \
         has moved. Start again, which plans under them: `plumbline run {job}`, or restart the service"
    ))
}

/// The limits for an arm that may stand anywhere.
fn anywhere(limits: Limits) -> Limits {
    Limits { q_min: limits.q_min.map(|q| q - TAU), q_max: limits.q_max.map(|q| q + TAU), ..limits }
}

/// An arm outside the limits could only be stopped by them, whatever it is told.
fn stands_inside(limits: &Limits, q: &[f64]) -> Result<(), Failure> {
    let Some((j, [min, max])) = programme::outside(limits, q) else { return Ok(()) };
    let joint = j + 1;
    Err(Failure::job(format!(
        "joint {joint} stands at {:.4} rad, outside the range of job and arm, {min:.4} to {max:.4} rad; nothing has moved. Move joint {joint} \
         inside by hand (guiding mode), and start again",
        q[j]
    )))
}

/// Does the bridge thread's `work`.
///
/// # Errors
/// The message of a panic in it; the loop has been told to end then, which brakes an arm that moves.
fn unless_panic<T>(controls: &Controls, work: impl FnOnce() -> T) -> Result<T, String> {
    std::panic::catch_unwind(std::panic::AssertUnwindSafe(work)).map_err(|panic| {
        controls.quit();
        panic_message(&*panic)
    })
}

/// Waits for the end of a loop that was told to end, up to [`PANIC_STOP`].
fn await_end<T>(thread: &JoinHandle<T>, gate: Option<&Gate>) {
    let deadline = Instant::now() + PANIC_STOP;
    while !thread.is_finished() && Instant::now() < deadline {
        gate.into_iter().for_each(|gate| {
            gate.open();
            gate.consumed(RING as u64);
        });
        std::thread::sleep(PAUSE);
    }
}

/// Runs the loop to its end, whatever that is. Nothing of a panic is lost: the arm is stopped, and the last cycles come out.
fn see_through<B: Backend, S: Sink>(cycle: &mut Cycle<B, S>) -> Left {
    // What the loop leaves behind after a panic is only read.
    match std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| cycle.run())) {
        Ok(outcome) => Left::Ended(Box::new(outcome)),
        Err(panic) => {
            let (flight, unanswered) = cycle.after_panic();
            Left::Panicked { message: panic_message(&*panic), flight, unanswered: unanswered.map(Box::new) }
        }
    }
}

/// What the thread that listens for stops asks of the operating system: it comes before the bridge thread, and never before the loop.
pub(super) fn listener_rights(realtime: &job::Realtime) -> Rights {
    let Rights { priority, .. } = rights(realtime, BELOW_LOOP / 2);
    Rights { priority, ..Rights::NONE }
}

/// What the job asks of the operating system, `below` levels lower.
fn rights(realtime: &job::Realtime, below: u8) -> Rights {
    Rights {
        priority: Some(realtime.priority.saturating_sub(below)).filter(|&priority| priority > 0),
        cpu: realtime.cpu.filter(|_| below == 0),
        lock_memory: realtime.lock_memory,
        preempt_rt: realtime.preempt_rt && below == 0,
    }
}

#[cfg(test)]
mod tests;
