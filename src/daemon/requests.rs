//! Answers to requests.

use super::check::{Checked, check};
use super::models::{Accepted, NotAdmitted};
use super::state::DaemonState;
use crate::config::job::Adopt;
use crate::failure::Failure;
use plumbline_core::BadInput;
use plumbline_ipc::{Progress, Proposal, Request, Response, Served, now_ns};
use plumbline_rt::Controls;
use std::path::Path;

/// Longest wait of a start for the model's check at rest \[ns\].
const REST_TIMEOUT_NS: u64 = 10_000_000_000;

fn refused(reason: impl ToString) -> Response {
    Response::Refused { reason: reason.to_string() }
}

impl DaemonState {
    /// Answers one request. `controls` are the running loop's, where one runs.
    pub fn answer(&mut self, request: Request, served: &Served, controls: Option<&Controls>) -> Response {
        match request {
            Request::Status {} => Response::Status(Box::new(self.status(served, controls))),
            Request::Start {} => self.start(),
            Request::Quit {} => {
                self.end.quit = true;
                Response::Accepted {}
            }
            Request::Stop {} => {
                self.stop(controls);
                Response::Accepted {}
            }
            Request::Pause {} => self.pause(controls),
            Request::Resume {} => self.resume(controls),
            Request::Record {} if controls.is_none() => {
                refused("the arm is not connected, so there is nothing to record")
            }
            Request::Record {} => match self.recorder.on_demand(self.history.last.cycle, now_ns()) {
                Ok(()) => Response::Accepted {},
                Err(reason) => refused(reason),
            },
            Request::OfferModel { .. } | Request::ProposeModel { .. } => {
                match Checked::of(&self.setup.robot, &self.mounting, request) {
                    Checked::Other(_) => refused("no model"),
                    checked => self.conclude(checked, served, controls),
                }
            }
            Request::Adopt {} => {
                let gravity = self.gravity.served();
                match self.models.adopt(&self.mounting, &gravity, &self.setup.robot.limits) {
                    Some(Ok(model)) => Response::ModelAccepted { model: self.serve(model) },
                    Some(Err(reason)) => refused(reason),
                    None => refused("no model was proposed"),
                }
            }
            Request::Doubt { model, why } => {
                let words = why.clone();
                if !self.models.doubt(model, why) {
                    return refused(format!("model {model:016x} is not served"));
                }
                match words {
                    Some(why) => tracing::warn!("the served torque is marked as doubtful: {why}"),
                    None => {
                        tracing::info!("the served torque is trusted again");
                        // It was for what has gone again.
                        if let Some((held, proposal)) = self.models.take_held() {
                            tracing::info!("the proposed model {:016x} ({}) is withdrawn", held.id, proposal.what);
                        }
                    }
                }
                Response::Accepted {}
            }
            Request::Reject {} => match self.models.take_held() {
                Some((held, proposal)) => {
                    tracing::info!("the proposed model {:016x} ({}) was rejected", held.id, proposal.what);
                    Response::Accepted {}
                }
                None => refused("no model was proposed"),
            },
        }
    }

    pub fn conclude(&mut self, checked: Checked, served: &Served, controls: Option<&Controls>) -> Response {
        match checked {
            Checked::Offered(model) => match self.accept("offered model", *model) {
                Ok(model) => Response::ModelAccepted { model },
                Err(refusal) => self.refuse_offer(refusal),
            },
            Checked::Proposed(model, proposal) => match self.admit("proposed model", &model) {
                Ok(()) => self.propose(*model, proposal),
                Err(NotAdmitted { bad, .. }) => refused(bad),
            },
            Checked::Other(request) => self.answer(request, served, controls),
            Checked::Refused(response) | Checked::Garbled(response) => response,
        }
    }

    fn start(&mut self) -> Response {
        if self.programme.progress != Progress::Idle {
            return refused("the programme was started before; restart the daemon to drive it again");
        }
        if self.stops.barred {
            return refused("the arm was stopped; it moves again only after `plumbline command resume`");
        }
        if let Some(refusal) = self.gravity.refusal() {
            return refused(refusal);
        }
        self.programme.start = true;
        self.programme.start_due_ns = now_ns().saturating_add(REST_TIMEOUT_NS);
        if self.start_awaits_rest() {
            let most = REST_TIMEOUT_NS / 1_000_000_000;
            tracing::info!(
                "the start waits, {most} s at most, until the arm has rested and its torques have agreed with the model that \
                 is to hold it"
            );
        }
        Response::Accepted {}
    }

    /// Brakes the arm by the way of a stop, and keeps what was driven: `resume` drives the rest.
    fn pause(&mut self, controls: Option<&Controls>) -> Response {
        if !matches!(self.programme.progress, Progress::Driving | Progress::AwaitingModel) || self.setup.listens() {
            return refused("nothing is being driven that could be paused");
        }
        if self.stops.barred {
            return refused("the arm was stopped");
        }
        tracing::info!(plumbline_event = "pause", "a pause was requested");
        self.stop(controls);
        self.programme.progress = Progress::Paused;
        Response::Accepted {}
    }

    fn resume(&mut self, controls: Option<&Controls>) -> Response {
        let paused = self.programme.progress == Progress::Paused;
        if paused && let Some(refusal) = self.gravity.refusal() {
            return refused(refusal);
        }
        let response = self.permit(controls);
        if paused && response == (Response::Accepted {}) {
            self.programme.progress = Progress::Driving;
            self.programme.continues = true;
            self.programme.start_due_ns = now_ns().saturating_add(REST_TIMEOUT_NS);
        }
        response
    }

    /// Lifts a stop of an arm at rest.
    fn permit(&mut self, controls: Option<&Controls>) -> Response {
        if controls.is_some_and(Controls::resume) {
            self.stops.barred = false;
            return Response::Accepted {};
        }
        if self.stops.braking {
            return refused("the arm is being braked; ask again when it is at rest");
        }
        // The stop was given to a loop that has ended.
        if std::mem::take(&mut self.stops.barred) {
            return Response::Accepted {};
        }
        refused("nothing waits for a permission to go on")
    }

    /// Refuses the model of the job. Where the arm has changed since it was recorded, the rest is driven as it was until then, without a model:
    /// what is recorded tells what has changed.
    fn refuse_offer(&mut self, NotAdmitted { bad, contradicted }: NotAdmitted) -> Response {
        let reason = bad.to_string();
        if contradicted && self.models.served().is_none() {
            tracing::warn!("no torque is served, and the rest of the job is driven without a model: {reason}");
            self.programme.without_model = Some(reason.clone());
            self.programme.go_on();
        }
        refused(reason)
    }

    /// Holds a proposed model, or serves it where the job says so.
    fn propose(&mut self, checked: Accepted, proposal: Proposal) -> Response {
        let Proposal { what, since, joint, before, after } = &proposal;
        let model = checked.id;
        tracing::warn!(
            "since {since:.1} s the served model does not hold: {what}; error in joint {joint} {before:.3} -> {after:.3} Nm \
             with model {model:016x}"
        );
        if self.setup.job.live.adopt == Adopt::Auto {
            return Response::ModelAccepted { model: self.serve(checked) };
        }
        tracing::warn!("it waits for `plumbline command adopt` or `plumbline command reject`");
        Response::ModelHeld { model: self.models.hold(checked, proposal) }
    }

    /// Takes a model from a file that a person named, by its text.
    pub fn accept_text(&mut self, path: &Path, text: &str) -> Result<u64, Failure> {
        let file = path.display().to_string();
        let checked = check(&self.setup.robot, &self.mounting, &file, text)?;
        self.accept(&file, checked).map_err(|refusal| refusal.bad.into())
    }

    fn accept(&mut self, file: &str, checked: Accepted) -> Result<u64, NotAdmitted> {
        self.admit(file, &checked)?;
        let remark = self.gravity.try_out(&checked).map_err(|off| {
            BadInput::new(file, "mounting", off, "declared, measured and implied directions of gravity that agree")
        })?;
        if let Some(remark) = remark {
            tracing::warn!("{remark}");
        }
        Ok(self.serve(checked))
    }

    /// Checks a model against the present mounting and the last second of the arm.
    pub fn admit(&mut self, file: &str, checked: &Accepted) -> Result<(), NotAdmitted> {
        let gravity = self.gravity.served();
        self.models.admit(file, &checked.model, &self.mounting, &gravity, &self.setup.robot.limits)
    }
}

#[cfg(test)]
mod tests;
