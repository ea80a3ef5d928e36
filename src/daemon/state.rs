//! The state of the daemon. Answers to requests are in `requests`, the status message in `status`.

use super::gravity::{GravityMonitor, HealthChange, ServiceChange, Verdict};
use super::job_setup::JobSetup;
use super::models::{Accepted, Models};
use super::recorder::Recorder;
use crate::config::job::OnEstimatorLoss;
use crate::failure::Failure;
use crate::process::signals::{Cause, Ending};
use crate::recording::about::{Reason, ReasonKind};
use crate::recording::messages::event_text;
use plumbline_core::{Fault, Record};
use plumbline_ipc::{FollowerEvent, GuestStatus, Progress, Session as SessionStatistics, StopOrder, now_ns};
use plumbline_model::Mounting;
use plumbline_rt::cycle::End;
use plumbline_rt::{Controls, Event, StopReason};

#[derive(Default)]
pub struct ProgrammeState {
    pub progress: Progress,
    pub start: bool,
    /// A paused programme was resumed, and the next connection drives the rest of it.
    pub continues: bool,
    /// Until when a start waits for the model's check at rest \[ns\].
    pub start_due_ns: u64,
    pub ended: Vec<u32>,
    /// Number and samples of every motion of the programme, once it is driven.
    pub motions: Vec<(u32, u64)>,
    /// Samples published when everything had been driven.
    pub driven: Option<u64>,
    pub recoveries: u32,
    /// The end of the recording was requested, of an arm that is only listened to.
    pub stop_listening: bool,
    /// Why the identified model is not served, where the rest is driven without it.
    pub without_model: Option<String>,
}

impl ProgrammeState {
    /// What waited for a model goes on.
    pub fn go_on(&mut self) {
        if self.progress == Progress::AwaitingModel {
            self.progress = Progress::Driving;
        }
    }
}

#[derive(Default)]
pub struct StopState {
    /// Nothing moves before an operator allows it, in this connection to the arm or another.
    pub barred: bool,
    /// A stop was requested from the running loop, and the arm is not at rest since.
    pub braking: bool,
    /// Why the daemon itself has requested the stop that comes next.
    pub cause: Option<String>,
    /// Why the arm was stopped last, if it was.
    pub stopped: Option<String>,
}

#[derive(Default)]
pub struct EndState {
    /// Signals, and the end of the parent process.
    pub ending: Ending,
    announced: Option<Cause>,
    pub quit: bool,
}

#[derive(Default)]
pub struct LoopHistory {
    pub sessions: Vec<SessionStatistics>,
    /// Rights that the machine does not grant the running loop, with what to change.
    pub degraded: Vec<String>,
    pub last: Record,
    /// What was received of an arm that another program controls.
    pub guest: Option<GuestStatus>,
}

/// The state of the daemon, owned by the bridge thread.
pub struct DaemonState {
    /// Keeps the last seconds of the loop.
    pub recorder: Recorder,
    pub setup: JobSetup,
    pub mounting: Mounting,
    pub models: Models,
    pub gravity: GravityMonitor,
    pub programme: ProgrammeState,
    pub stops: StopState,
    pub end: EndState,
    pub history: LoopHistory,
}

/// Response to the loss of a follower of the samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LossResponse {
    /// Nothing: nothing moves or waits.
    None,
    /// The motion continues, and the samples are kept.
    Continue,
    /// The arm waits for a model, and the samples are kept.
    Wait,
    Stop,
}

impl DaemonState {
    /// Opens the inclinometer, where there is one: call it before the priority of this thread goes up.
    pub fn new(setup: JobSetup, recorder: Recorder, ending: Ending) -> Result<DaemonState, Failure> {
        Ok(DaemonState {
            recorder,
            mounting: setup.job.mounting,
            models: Models::default(),
            gravity: GravityMonitor::open(&setup.job)?,
            programme: ProgrammeState::default(),
            stops: StopState::default(),
            end: EndState { ending, ..EndState::default() },
            history: LoopHistory::default(),
            setup,
        })
    }

    pub fn must_quit(&self) -> bool {
        self.end.quit || self.end.ending.arrived()
    }

    /// Logs a reason to end, once; the controlled stop and its recording carry the first one.
    pub fn announce_end(&mut self) {
        let cause = self.end.ending.cause();
        let Some(new) = cause.filter(|_| cause != self.end.announced) else { return };
        if self.end.quit && new == Cause::ParentEnded {
            // `plumbline run` requests the end first, then closes the pipe.
            return;
        }
        if self.end.announced.is_none() {
            tracing::warn!(plumbline_event = "ending", "{new}: the daemon brakes an arm that moves, then ends");
            self.stops.cause = Some(new.to_string());
            self.recorder.set_reason(Reason::new(new.kind(), new.to_string()));
        } else {
            tracing::warn!(plumbline_event = "ending", "{new}: the daemon is ending already; a stop under way goes on");
        }
        self.end.announced = cause;
    }

    /// Whether nothing more of the programme is driven.
    pub fn is_over(&self) -> bool {
        self.must_quit() || self.stops.barred || self.programme.progress == Progress::Stopped
    }

    /// Whether the programme was interrupted by a pause, and a further connection drives the rest of it.
    pub fn is_paused(&self) -> bool {
        self.programme.progress == Progress::Paused || self.programme.continues
    }

    /// Whether the present connection is to end: for good, or to start or continue the programme.
    pub fn must_leave(&self) -> bool {
        let starts = self.programme.start && self.programme.progress == Progress::Idle;
        self.must_quit() || ((starts || self.programme.continues) && !self.start_awaits_rest())
    }

    /// Whether a start waits for the arm's rest: under torque control the model alone holds the arm, and is not checked yet.
    pub fn start_awaits_rest(&self) -> bool {
        let held_by_model = self.setup.commands_torques() && self.gravity.uncompensated() != Some(false);
        let checks = self.models.served().is_some() && self.gravity.awaits_rest();
        held_by_model && checks && now_ns() < self.programme.start_due_ns
    }

    /// Whether the daemon may recover the arm after `end` and continue without an operator: by the rule of the arm and the job, and never where the
    /// arm was stopped before.
    pub fn may_recover(&self, end: &End) -> bool {
        let recoverable = |fault: &Fault| self.programme.recoveries < self.setup.arm.max_recoveries(fault);
        matches!(end, End::Fault(fault) if recoverable(fault)) && !self.is_over()
    }

    /// Takes note of a stop that the running loop, if any, has been given already.
    pub fn take_stop(&mut self, order: StopOrder, controls: Option<&Controls>) {
        tracing::info!(plumbline_event = "stop", "a stop was requested by {order}");
        self.stop(controls);
    }

    /// Brakes the arm. The stop holds until an operator lifts it, also where no loop runs. Of an arm that another program controls, it ends
    /// the recording.
    pub fn stop(&mut self, controls: Option<&Controls>) {
        if self.setup.listens() {
            tracing::warn!("the recording ends; the arm itself is not stopped: another program controls it");
            self.programme.stop_listening = true;
            return;
        }
        self.stops.barred = true;
        if let Some(controls) = controls {
            controls.stop();
            self.stops.braking = true;
        } else if matches!(self.programme.progress, Progress::Driving | Progress::AwaitingModel) {
            // Between two connections: the interrupted motion is not driven again.
            self.programme.progress = Progress::Stopped;
        }
        match self.programme.progress {
            Progress::Idle => self.programme.start = false,
            Progress::Paused => self.programme.progress = Progress::Stopped,
            _ => {}
        }
        if std::mem::take(&mut self.programme.continues) {
            // Resumed, and not driven yet.
            self.programme.progress = Progress::Stopped;
        }
    }

    /// Brakes the arm for a reason of the daemon's own, which log, status and recording carry.
    pub fn stop_because(&mut self, reason: Reason, controls: Option<&Controls>) {
        self.stops.cause = Some(reason.text.clone());
        self.recorder.set_reason(reason);
        self.stop(controls);
    }

    pub fn take_records(&mut self, records: &[Record], controls: Option<&Controls>) {
        if let Some(moved) = self.gravity.take(records) {
            self.gravity_event(moved.event);
            if let Some(why) = moved.stop {
                self.stop_because(Reason::new(ReasonKind::Mounting, why), controls);
            }
        }
        self.models.recent.take(records);
        if let Some(last) = records.last() {
            self.history.last = *last;
        }
    }

    /// Reads the inclinometer; call it often. While no model is `serving`, the gravity served need not change slowly.
    pub fn poll_gravity(&mut self, now: u64, serving: bool) {
        match self.gravity.poll(now, serving) {
            None => {}
            Some(change @ HealthChange::Lost(_)) => self.gravity_event(change.to_string()),
            Some(change @ HealthChange::Back { .. }) => {
                tracing::info!("{change}");
                self.keep_gravity_event(change.to_string());
            }
        }
    }

    /// Whether the served model may be handed to a loop in `mounting` now, with its verdict; `None` where there is no such model.
    pub fn model_for_loop(&mut self, mounting: &Mounting) -> Option<(&Accepted, Verdict)> {
        let decision = self.gravity.decide(self.models.for_loop(mounting)?);
        if let Some(remark) = &decision.remark {
            tracing::warn!("{remark}");
        }
        match self.gravity.apply(&decision) {
            None => {}
            Some(ServiceChange::Waits(words)) => tracing::info!("{words}"),
            Some(ServiceChange::Refused(words)) => self.gravity_event(words),
            Some(ServiceChange::ServedAgain { model }) => {
                tracing::info!("model {model:016x} is served again: nothing speaks against it any more");
            }
        }
        self.models.served().map(|served| (served, decision.verdict))
    }

    /// Logs an event of the mounting, and keeps it for status and flight recorder.
    fn gravity_event(&mut self, event: String) {
        tracing::error!("{event}");
        self.keep_gravity_event(event);
    }

    fn keep_gravity_event(&mut self, event: String) {
        self.recorder.note(&event);
        self.gravity.keep(event);
    }

    /// Serves a model that was checked; its identity.
    pub fn serve(&mut self, model: Accepted) -> u64 {
        tracing::info!(
            plumbline_event = "serving",
            "model {:016x} ({}) is served from now on",
            model.id,
            model.model.kind()
        );
        self.programme.without_model = None;
        self.programme.go_on();
        self.models.serve(model)
    }

    /// Logs news of a follower of the samples, and stops the arm where the job wants that.
    pub fn news(&mut self, news: &FollowerEvent, controls: Option<&Controls>) {
        let response = self.response_to(news);
        let rule = match response {
            LossResponse::None => return tracing::info!("{news}"),
            LossResponse::Continue => "the arm goes on and the samples are kept",
            LossResponse::Wait => "the arm waits for a model and the samples are kept",
            LossResponse::Stop => "the arm stops",
        };
        let words = format!("{news}; by safety.on-estimator-loss, {rule}");
        // Simulated time runs faster than any estimator computes: its silence is no trouble.
        let is_usual = self.setup.job.backend.is_fast() && matches!(news, FollowerEvent::Silent { .. });
        if is_usual && response != LossResponse::Stop {
            tracing::info!("{words}");
        } else {
            tracing::warn!("{words}");
        }
        self.recorder.note(&words);
        if response == LossResponse::Stop {
            self.stop_because(Reason::new(ReasonKind::EstimatorLost, words), controls);
        }
    }

    /// What the job wants done about `news`.
    fn response_to(&self, news: &FollowerEvent) -> LossResponse {
        let job = &self.setup.job;
        // Simulated time waits for an estimator that watches: its silence is no loss.
        let waited_for = job.live.watch && job.backend.is_fast();
        let silent = matches!(news, FollowerEvent::Silent { .. });
        let stops = job.safety.on_estimator_loss == OnEstimatorLoss::Stop && !self.setup.listens();
        let stop = stops && !(silent && waited_for);
        match (news, self.programme.progress) {
            // One that leaves during a motion is lost, too: it may have failed and disconnected in order.
            (
                FollowerEvent::Died { .. } | FollowerEvent::Left { .. } | FollowerEvent::Silent { .. },
                Progress::Driving,
            ) => {
                if stop {
                    LossResponse::Stop
                } else {
                    LossResponse::Continue
                }
            }
            (FollowerEvent::Died { .. }, Progress::AwaitingModel) => LossResponse::Wait,
            // Nothing moves, so nothing is decided. An estimator that computes is silent, too.
            _ => LossResponse::None,
        }
    }

    pub fn take_event(&mut self, event: &Event) {
        if let Event::Stopping { reason, .. } = event {
            let cause = self.stops.cause.take();
            let own = cause.filter(|_| matches!(reason, StopReason::Requested | StopReason::Quit));
            self.stops.stopped = Some(own.unwrap_or_else(|| reason.to_string()));
        }
        if matches!(event, Event::Stopping { reason, .. } if *reason != StopReason::Requested) && self.is_paused() {
            // Braked for another reason than the pause.
            self.programme.progress = Progress::Stopped;
        }
        self.log(event);
        match event {
            Event::Stopping { .. } => (self.stops.barred, self.stops.braking) = (true, true),
            Event::Stopped => self.stops.braking = false,
            Event::Resumed => {
                (self.stops.barred, self.stops.braking) = (false, false);
                // Requested again while that stop had begun already: no reason of the next one.
                self.stops.cause = None;
            }
            Event::Distrusted { model, instead } => self.models.reject(*model, *instead),
            Event::Started { .. } | Event::Ended { .. } | Event::Discarded { .. } | Event::Serving { .. } => {}
        }
    }

    fn log(&self, event: &Event) {
        match event {
            Event::Started { motion } => {
                if let Some(name) = self.name_of(*motion) {
                    tracing::info!(plumbline_event = "started", "{name} has started");
                }
            }
            Event::Ended { motion } => {
                if let Some(name) = self.name_of(*motion) {
                    tracing::info!(plumbline_event = "ended", "{name} has ended");
                }
            }
            Event::Stopping { .. } => {
                let reason = self.stops.stopped.as_deref().unwrap_or_default();
                match self.stop_was_requested() {
                    true => tracing::info!(plumbline_event = "stopping", "the arm is being stopped: {reason}"),
                    false => tracing::error!(plumbline_event = "stopping", "the arm is being stopped: {reason}"),
                }
            }
            Event::Stopped if self.stop_was_requested() => tracing::info!(
                plumbline_event = "stopped",
                "the arm is at rest; {}",
                match self.programme.progress {
                    Progress::Stopped =>
                        "what was left of the programme is not driven; start the daemon again, and give \
                        `plumbline command start`",
                    Progress::Paused => "the programme continues after `plumbline command resume`",
                    _ => "it moves again only after `plumbline command resume`",
                }
            ),
            Event::Stopped if self.programme.progress == Progress::Stopped => tracing::error!(
                plumbline_event = "stopped",
                "the arm is at rest, and what was left of the programme is not driven; see to the cause, start the daemon again, and \
                 give `plumbline command start`"
            ),
            Event::Stopped => tracing::error!(
                plumbline_event = "stopped",
                "the arm is at rest; it moves again only after `plumbline command resume`"
            ),
            Event::Resumed => tracing::info!(plumbline_event = "resumed", "an operator has allowed motion again"),
            Event::Discarded { motion } => tracing::debug!("order {motion} was discarded"),
            Event::Serving { model } => tracing::debug!("the loop serves model {model:016x}"),
            Event::Distrusted { .. } => {
                tracing::error!(plumbline_event = "distrusted", "{}", event_text(event));
            }
        }
    }

    /// Whether the last stop was an operator's, and no failure.
    fn stop_was_requested(&self) -> bool {
        let requested = [StopReason::Requested, StopReason::Quit].map(|reason| reason.to_string());
        self.stops.stopped.as_ref().is_some_and(|stopped| requested.contains(stopped))
    }

    pub fn name_of(&self, motion: u32) -> Option<&str> {
        self.setup.names.iter().find(|(number, _)| *number == motion).map(|(_, name)| name.as_str())
    }
}

#[cfg(test)]
mod tests;
