//! What the daemon knows and decides: answers requests, accepts models, says what the loop does.

use super::check::{Checked, check};
use super::gravity::Watch;
use super::recorder::Recorder;
use crate::config::job::{Adopt, Job, OnEstimatorLoss};
use crate::failure::Failure;
use crate::process::signals::{Cause, Ending};
use crate::recording::about::Reason;
use crate::recording::messages::event_text;
use plumbline_core::{BadInput, JointVec, Record};
use plumbline_franka::{Interface, RobotLimits};
use plumbline_identify::{Implausible, plausible};
use plumbline_ipc::{
    Held, Mounting as MountingMessage, News, Progress, Proposal, Request, Response, Served,
    Session as SessionStatistics, Status, StopOrder, now_ns,
};
use plumbline_model::{Mounting, Robot, TorqueModel};
use plumbline_rt::{Controls, Event, StopReason};
use plumbline_sim::Truth;
use std::collections::VecDeque;
use std::path::Path;

/// Cycles between two that are kept of what the arm did last.
const EVERY: u64 = 16;
/// How many are kept.
const KEPT: usize = 64;

/// Longest wait of a start for the model's check at rest \[ns\].
const REST_TIMEOUT_NS: u64 = 10_000_000_000;

/// A model that passed every check.
pub struct Accepted {
    /// Identity of its text.
    pub id: u64,
    /// Its text.
    pub text: String,
    /// The model.
    pub model: TorqueModel,
    /// Noise of the measured torque by its file, per joint \[Nm\]; empty where unknown.
    pub noise: Vec<f64>,
}

/// What the arm did last: every [`EVERY`]th cycle of the last second.
#[derive(Default)]
pub struct Recent(VecDeque<Record>);

impl Recent {
    /// Takes in what the loop has recorded.
    pub fn take(&mut self, records: &[Record]) {
        for record in records.iter().filter(|record| record.cycle.is_multiple_of(EVERY)) {
            if self.0.len() == KEPT {
                self.0.pop_front();
            }
            self.0.push_back(*record);
        }
    }

    /// Another connection to the arm.
    pub fn clear(&mut self) {
        self.0.clear();
    }
}

/// The daemon without its ports.
pub struct Desk {
    /// Keeps the last seconds of the loop.
    pub recorder: Recorder,
    /// What to do.
    pub job: Job,
    /// The arm's description.
    pub robot: Robot,
    /// Limits of the connected arm that the programme was checked under; `None` for a simulated arm.
    pub arm_limits: Option<RobotLimits>,
    /// What the simulated arm is made of, where one is driven.
    pub truth: Option<Truth>,
    /// Where the arm starts and returns to \[rad\].
    pub rest: JointVec,
    /// The model being served.
    pub model: Option<Accepted>,
    /// A proposed model that waits for a decision, and why it was proposed.
    pub held: Option<(Accepted, Proposal)>,
    /// How the arm is mounted now.
    pub mounting: Mounting,
    /// What is known of gravity.
    pub gravity: Watch,
    /// Where the job stands.
    pub progress: Progress,
    /// Numbers and names of the motions.
    pub names: Vec<(u32, String)>,
    /// Connections to the arm that have ended.
    pub sessions: Vec<SessionStatistics>,
    /// Samples published when everything had been driven.
    pub driven: Option<u64>,
    /// Orders that were driven to their end.
    pub ended: Vec<u32>,
    /// How often the daemon has let the arm go on by itself after a fault.
    pub recoveries: u32,
    /// What the machine does not grant the running loop, with what to change: while there is anything, it is degraded.
    pub degraded: Vec<String>,
    /// Why the arm was stopped last, if it was.
    pub stopped: Option<String>,
    /// Why the daemon itself asks for the stop that comes next.
    pub cause: Option<String>,
    /// A stop stands, whatever has become of the connection that it was given on: nothing moves before an operator allows it.
    pub barred: bool,
    /// The model that was served before it: the loop falls back to it.
    pub reserve: Option<Accepted>,
    /// The running loop was told to stop and has not come to rest since.
    pub braking: bool,
    /// The model whose torque broke a limit: it is not handed to another loop.
    pub distrusted: Option<u64>,
    /// The last cycle seen.
    pub last: Record,
    /// Signals, and the end of the parent process.
    pub ending: Ending,
    /// The reason to end that was logged last.
    pub announced: Option<Cause>,
    /// What the arm did last.
    pub recent: Recent,
    /// Somebody asked for the programme.
    pub start: bool,
    /// Until when a start waits for the model's check at rest \[ns\].
    pub start_due_ns: u64,
    /// Somebody asked for the end.
    pub quit: bool,
}

impl Desk {
    /// Nothing has happened yet. It listens to the inclinometer, where there is one: call it before the priority of this thread goes up.
    ///
    /// # Errors
    /// What the job says of the arm, its pose at rest or its inclinometer can't be used.
    pub fn new(
        job: Job,
        robot: Robot,
        names: Vec<(u32, String)>,
        recorder: Recorder,
        ending: Ending,
    ) -> Result<Desk, Failure> {
        Ok(Desk {
            recorder,
            arm_limits: None,
            truth: crate::setup::truth(&job)?,
            rest: crate::setup::rest(&job, &robot)?,
            model: None,
            held: None,
            mounting: job.mounting,
            gravity: Watch::open(&job)?,
            progress: Progress::Idle,
            names,
            sessions: Vec::new(),
            ended: Vec::new(),
            recoveries: 0,
            degraded: Vec::new(),
            driven: None,
            stopped: None,
            cause: None,
            barred: false,
            braking: false,
            reserve: None,
            recent: Recent::default(),
            distrusted: None,
            last: Record::default(),
            ending,
            announced: None,
            start: false,
            start_due_ns: 0,
            quit: false,
            job,
            robot,
        })
    }

    /// Whether the daemon is to end.
    pub fn must_quit(&self) -> bool {
        self.quit || self.ending.arrived()
    }

    /// Logs a reason to end, once; the controlled stop and its recording carry the first one.
    pub fn announce_end(&mut self) {
        let cause = self.ending.cause();
        let Some(new) = cause.filter(|_| cause != self.announced) else { return };
        if self.quit && new == Cause::ParentEnded {
            // `plumbline run` asks for the end first, then closes the pipe.
            return;
        }
        if self.announced.is_none() {
            tracing::warn!(plumbline_event = "ending", "{new}: the daemon brakes an arm that moves, then ends");
            self.cause = Some(new.to_string());
            self.recorder.blame(Reason::new(new.kind(), new.to_string()));
        } else {
            tracing::warn!(plumbline_event = "ending", "{new}: the daemon is ending already; a stop under way goes on");
        }
        self.announced = cause;
    }

    /// Whether the programme is not to go on, whatever it was interrupted by.
    pub fn is_over(&self) -> bool {
        self.must_quit() || self.barred || self.progress == Progress::Stopped
    }

    /// Whether the present connection is to end: for good, or to start the programme.
    pub fn must_leave(&self) -> bool {
        self.must_quit() || (self.start && self.progress == Progress::Idle && !self.awaits_rest())
    }

    /// Whether the job commands torques.
    pub fn commands_torques(&self) -> bool {
        self.job.backend.franka.as_ref().is_some_and(|franka| franka.interface == Interface::Torque)
    }

    /// Whether a start waits for the arm's rest: under torque control the model alone holds the arm, and is not checked yet.
    fn awaits_rest(&self) -> bool {
        let held_by_model = self.commands_torques() && self.gravity.uncompensated() != Some(false);
        held_by_model && self.model.is_some() && self.gravity.awaits_rest() && now_ns() < self.start_due_ns
    }

    /// Answers one request. `controls` are the running loop's, where one runs.
    pub fn answer(&mut self, request: Request, served: &Served, controls: Option<&Controls>) -> Response {
        let refused = |reason: &str| Response::Refused { reason: reason.to_string() };
        match request {
            Request::Status {} => Response::Status(Box::new(self.status(served, controls))),
            Request::Start {} if self.progress != Progress::Idle => {
                refused("the programme was started before; restart the daemon to drive it again")
            }
            Request::Start {} if self.barred => {
                refused("the arm was stopped; it moves again only after `plumbline command resume`")
            }
            Request::Start {} => match self.gravity.refusal() {
                Some(refusal) => refused(&refusal),
                None => {
                    (self.start, self.start_due_ns) = (true, now_ns().saturating_add(REST_TIMEOUT_NS));
                    if self.awaits_rest() {
                        let most = REST_TIMEOUT_NS / 1_000_000_000;
                        tracing::info!(
                            "the start waits, {most} s at most, until the arm has rested and its torques have agreed with the model that \
                             is to hold it"
                        );
                    }
                    Response::Accepted {}
                }
            },
            Request::Quit {} => {
                self.quit = true;
                Response::Accepted {}
            }
            Request::Stop {} => {
                self.stop(controls);
                Response::Accepted {}
            }
            Request::Resume {} => {
                if controls.is_some_and(Controls::resume) {
                    self.barred = false;
                    return Response::Accepted {};
                }
                if self.braking {
                    return refused("the arm is being braked; ask again when it is at rest");
                }
                // The stop was given to a loop that has ended.
                if std::mem::take(&mut self.barred) {
                    return Response::Accepted {};
                }
                refused("nothing waits for a permission to go on")
            }
            Request::Record {} if controls.is_none() => {
                refused("the arm is not connected, so there is nothing to record")
            }
            Request::Record {} => match self.recorder.on_demand(self.last.cycle, now_ns()) {
                Ok(()) => Response::Accepted {},
                Err(reason) => Response::Refused { reason },
            },
            Request::OfferModel { .. } | Request::ProposeModel { .. } => {
                match Checked::of(&self.robot, &self.mounting, request) {
                    Checked::Other(_) => refused("no model"),
                    checked => self.conclude(checked, served, controls),
                }
            }
            Request::Adopt {} => match self.held.take() {
                Some((held, proposal)) => self.adopt(held, proposal),
                None => refused("no model was proposed"),
            },
            Request::Reject {} => match self.held.take() {
                Some((held, proposal)) => {
                    tracing::info!("the proposed model {:016x} ({}) was rejected", held.id, proposal.what);
                    Response::Accepted {}
                }
                None => refused("no model was proposed"),
            },
        }
    }

    /// Answers a request whose model was checked.
    pub fn conclude(&mut self, checked: Checked, served: &Served, controls: Option<&Controls>) -> Response {
        let refused = |bad: BadInput| Response::Refused { reason: bad.to_string() };
        match checked {
            Checked::Offered(model) => match self.accept("offered model", *model) {
                Ok(model) => Response::ModelAccepted { model },
                Err(bad) => refused(bad),
            },
            Checked::Proposed(model, proposal) => match self.admit("proposed model", &model) {
                Ok(()) => self.propose(*model, proposal),
                Err(bad) => refused(bad),
            },
            Checked::Other(request) => self.answer(request, served, controls),
            Checked::Refused(response) | Checked::Garbled(response) => response,
        }
    }

    /// Takes note of a stop that the running loop, if any, has been told of already.
    pub fn take_stop(&mut self, order: StopOrder, controls: Option<&Controls>) {
        tracing::warn!(plumbline_event = "stop", "a stop was requested by {order}");
        self.stop(controls);
    }

    /// Brakes the arm. The stop stands until an operator lifts it, also where no loop is there to hear it or the one that is hears no more.
    pub fn stop(&mut self, controls: Option<&Controls>) {
        self.barred = true;
        if let Some(controls) = controls {
            controls.stop();
            self.braking = true;
        } else if self.is_under_way() {
            // Between two connections: what was interrupted is not gone on with.
            self.progress = Progress::Stopped;
        }
        if self.progress == Progress::Idle {
            self.start = false;
        }
    }

    /// The same, because of what is known of the mounting.
    pub fn stop_for_mounting(&mut self, why: String, controls: &Controls) {
        self.recorder.blame(Reason::new("mounting", &why));
        self.cause = Some(why);
        self.stop(Some(controls));
    }

    /// The same, because no model came.
    pub fn stop_without_model(&mut self, why: String, controls: &Controls) {
        self.recorder.blame(Reason::new("model-timeout", &why));
        self.cause = Some(why);
        self.stop(Some(controls));
    }

    /// What has happened to gravity goes into the flight recorder, too.
    pub fn note_gravity(&mut self) {
        self.gravity.take_untold().into_iter().for_each(|event| self.recorder.note(event));
    }

    /// Whether the programme was begun and has not ended.
    fn is_under_way(&self) -> bool {
        matches!(self.progress, Progress::Driving | Progress::AwaitingModel)
    }

    /// Holds a proposed model, or serves it where the job says so.
    fn propose(&mut self, checked: Accepted, proposal: Proposal) -> Response {
        let Proposal { what, since, joint, before, after } = &proposal;
        let model = checked.id;
        tracing::warn!(
            "since {since:.1} s the served model does not hold: {what}; error in joint {joint} {before:.3} -> {after:.3} Nm \
             with model {model:016x}"
        );
        if self.job.live.adopt == Adopt::Auto {
            self.held = None;
            return Response::ModelAccepted { model: self.serve(checked) };
        }
        tracing::warn!("it waits for `plumbline command adopt` or `plumbline command reject`");
        self.held = Some((checked, proposal));
        Response::ModelHeld { model }
    }

    /// Serves what was held, if it holds in the mounting that the arm has by now.
    fn adopt(&mut self, held: Accepted, proposal: Proposal) -> Response {
        let holds = held.model.valid_in(&self.mounting).map_err(|refused| refused.to_string());
        if let Err(reason) = holds.and_then(|()| self.plausible(&held.model).map_err(|why| why.to_string())) {
            self.held = Some((held, proposal));
            return Response::Refused { reason };
        }
        Response::ModelAccepted { model: self.serve(held) }
    }

    /// Takes a model from a file that a person named, by its text.
    pub fn accept_text(&mut self, path: &Path, text: &str) -> Result<u64, Failure> {
        let file = path.display().to_string();
        let checked = check(&self.robot, &self.mounting, &file, text)?;
        Ok(self.accept(&file, checked)?)
    }

    /// Serves a model that was checked from one of the next cycles on. What was proposed before is about another model.
    fn accept(&mut self, file: &str, checked: Accepted) -> Result<u64, BadInput> {
        self.admit(file, &checked)?;
        self.gravity.try_out(&checked).map_err(|off| {
            BadInput::new(file, "mounting", off, "declared, measured and implied directions of gravity that agree")
        })?;
        self.held = None;
        Ok(self.serve(checked))
    }

    /// Checks a model against what the daemon has seen by now: the arm may have been mounted in another way since the model's text was checked,
    /// and its torques have to go with what the arm did last.
    fn admit(&mut self, file: &str, checked: &Accepted) -> Result<(), BadInput> {
        checked.model.valid_in(&self.mounting).map_err(|refused| {
            BadInput::new(file, "key `kind`", refused, "a model that holds in the present mounting")
        })?;
        self.plausible(&checked.model).map_err(|why| BadInput::new(file, "parameters", why, "a model of this arm"))
    }

    /// Whether the served model may be handed to a loop: it holds in that loop's mounting, and no loop has distrusted it.
    pub fn may_hand_over(&self, mounting: &Mounting) -> bool {
        self.model
            .as_ref()
            .is_some_and(|accepted| accepted.model.holds_in(mounting) && self.distrusted != Some(accepted.id))
    }

    /// Whether a model can be right, by what the arm did last.
    fn plausible(&mut self, model: &TorqueModel) -> Result<(), Implausible> {
        let served = self.model.as_ref().filter(|served| self.distrusted != Some(served.id));
        let recent = self.recent.0.make_contiguous();
        plausible(model, served.map(|served| &served.model), &self.gravity.served(), recent, &self.robot.limits)
    }

    /// Serves a model that was checked.
    fn serve(&mut self, checked: Accepted) -> u64 {
        let id = checked.id;
        tracing::info!(plumbline_event = "serving", "model {id:016x} ({}) is served from now on", checked.model.kind());
        let before = self.model.replace(checked);
        if before.as_ref().is_some_and(|before| before.id != id && self.distrusted != Some(before.id)) {
            self.reserve = before;
        }
        self.distrusted = None;
        if self.progress == Progress::AwaitingModel {
            self.progress = Progress::Driving;
        }
        id
    }

    /// Says what became of a follower of the samples, and stops the arm where the job wants that.
    pub fn news(&mut self, news: &News, controls: Option<&Controls>) {
        // Simulated time waits for an estimator that watches: its silence is no loss.
        let waited_for = self.job.live.watch && self.job.backend.is_fast();
        let silent = matches!(news, News::Silent { .. });
        let stop = self.job.safety.on_estimator_loss == OnEstimatorLoss::Stop && !(silent && waited_for);
        let rule = match (news, self.progress) {
            // One that leaves in mid-motion is gone, too: it may have failed, and taken leave on its way out.
            (News::Died { .. } | News::Left { .. } | News::Silent { .. }, Progress::Driving) if stop => "the arm stops",
            (News::Died { .. } | News::Left { .. } | News::Silent { .. }, Progress::Driving) => {
                "the arm goes on and the samples are kept"
            }
            (News::Died { .. }, Progress::AwaitingModel) => "the arm waits for a model and the samples are kept",
            // Nothing moves, so nothing is decided. An estimator that computes is silent, too.
            _ => return tracing::info!("{news}"),
        };
        let words = format!("{news}; by safety.on-estimator-loss, {rule}");
        tracing::warn!("{words}");
        self.recorder.note(&words);
        if stop && self.progress == Progress::Driving {
            self.recorder.blame(Reason::new("estimator-lost", words));
            self.stop(controls);
        }
    }

    /// Says what happened in the loop, and remembers why it stopped.
    pub fn log(&mut self, event: &Event) {
        self.braking &= *event != Event::Stopped;
        match event {
            Event::Started { motion } => {
                self.names.iter().filter(|(number, _)| number == motion).for_each(|(_, name)| {
                    tracing::info!(plumbline_event = "started", "{name} has started");
                })
            }
            Event::Ended { motion } => {
                self.names.iter().filter(|(number, _)| number == motion).for_each(|(_, name)| {
                    tracing::info!(plumbline_event = "ended", "{name} has ended");
                })
            }
            Event::Stopping { reason, .. } => {
                let cause = self.cause.take().filter(|_| matches!(reason, StopReason::Requested | StopReason::Quit));
                let reason = cause.unwrap_or_else(|| reason.to_string());
                tracing::error!(plumbline_event = "stopping", "the arm is being stopped: {reason}");
                self.stopped = Some(reason);
                (self.barred, self.braking) = (true, true);
            }
            Event::Stopped if self.progress == Progress::Stopped => tracing::error!(
                plumbline_event = "stopped",
                "the arm is at rest, and what was left of the programme is not driven; see to the cause, start the daemon again, and \
                 give `plumbline command start`"
            ),
            Event::Stopped => {
                tracing::error!(
                    plumbline_event = "stopped",
                    "the arm is at rest; it moves again only after `plumbline command resume`"
                );
            }
            Event::Resumed => {
                tracing::info!(plumbline_event = "resumed", "an operator has allowed motion again");
                (self.barred, self.braking) = (false, false);
                // Asked for again while that stop had begun already: no reason of the next one.
                self.cause = None;
            }
            Event::Discarded { motion } => tracing::debug!("order {motion} was discarded"),
            Event::Serving { model } => tracing::debug!("the loop serves model {model:016x}"),
            Event::Distrusted { model, instead } => {
                tracing::error!(plumbline_event = "distrusted", "{}", event_text(event));
                self.distrust(*model, *instead);
            }
        }
    }

    /// The loop does not ask `model` any more, and falls back to `instead`, 0 for none.
    fn distrust(&mut self, model: u64, instead: u64) {
        self.distrusted = Some(model);
        let reserve = self.reserve.take_if(|reserve| reserve.id == instead || reserve.id == model);
        if self.model.as_ref().is_some_and(|served| served.id == model)
            && let Some(reserve) = reserve.filter(|reserve| reserve.id == instead)
        {
            self.model = Some(reserve);
        }
    }

    fn status(&self, served: &Served, controls: Option<&Controls>) -> Status {
        let name = self.names.iter().find(|(number, _)| *number == self.last.motion).map(|(_, name)| name.as_str());
        let place = self.mounting.to_string();
        let gravity = self.gravity.served();
        let Mounting { rho, phi } = Mounting::along(&gravity);
        let mut status = Status {
            robot: self.robot.name.clone(),
            process: std::process::id(),
            joints: self.robot.chain.len(),
            phase: self.last.phase,
            motion: self.last.motion,
            cycles: self.sessions.iter().map(|session| session.statistics.cycles).sum(),
            lost: self.sessions.iter().map(|session| session.statistics.lost).sum(),
            late: self.sessions.iter().filter_map(|session| session.statistics.late).sum(),
            dropped_records: self.sessions.iter().map(|session| session.statistics.dropped_records).sum(),
            model: self
                .model
                .as_ref()
                .map(|accepted| accepted.id)
                .filter(|&id| self.distrusted != Some(id))
                .unwrap_or(0),
            offered: self.held.as_ref().map(|(held, proposal)| Held { model: held.id, proposal: proposal.clone() }),
            mounting: Some(MountingMessage { rho, phi, gravity: gravity.into() }),
            gravity: Some(self.gravity.message(now_ns())),
            progress: self.progress,
            driven: self.driven,
            stopped: self.stopped.clone(),
            degraded: self.degraded.clone(),
            job: name.map_or_else(|| place.clone(), |name| format!("{place}: {name}")),
            sessions: self.sessions.clone(),
            served: served.clone(),
        };
        if let Some(controls) = controls {
            status.cycles += controls.cycles();
            status.lost += controls.lost();
            status.late += controls.late();
            status.dropped_records += controls.dropped_records();
        }
        status
    }
}

#[cfg(test)]
mod tests;
