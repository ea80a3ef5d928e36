//! The arm in the loop: the state machine of one session.
//!
//! | phase | call | what happens | next phase |
//! |---|---|---|---|
//! | ready | `read`, [`Purpose::Drive`] | Move is called; returns with the first state that shows it | moving, ended |
//! | ready | `read`, [`Purpose::Monitor`] | the newest state | ready |
//! | moving | `read` | the newest state; a state or an answer may show the end | moving, ended |
//! | moving | `write` | one command per state, inside the arm's limits | moving |
//! | moving | `stop` | brakes, finishes; asks the arm to stop where that does not work | stopped |
//! | ended | `read` | the same fault again | ended |
//! | ended | `stop` | reads the arm's final answer; asks the arm to stop where it has not reported the end | stopped |
//! | stopped | `read` | the newest state | stopped |

use super::limiter::{Limited, Objection};
use super::motion::{Answer, Motion, request};
use super::reference::{Followed, Point};
use super::torque::Tracking;
use super::transport::Transport;
use crate::codes::{
    REFLEX_MODE, REFUSED_BEFORE_START, REFUSED_JUMP, REFUSED_MOVE, REFUSED_NO_START, REFUSED_NOT_FINITE,
    REFUSED_POSITION, REFUSED_REACH, REFUSED_STOPPED,
};
use crate::limits::{RobotLimits, narrow, widen};
use crate::settings::{Interface, Purpose, Settings};
use crate::wire::{ControllerMode, ErrorBit, Errors, MotionGeneratorMode, MoveStatus, RobotMode};
use plumbline_core::{Backend, Command, Fault, PERIOD_S, State};
use plumbline_rt::os::now_ns;
use std::time::Duration;

/// Longest wait for the motion to start \[ns\].
const START_TIMEOUT_NS: u64 = 1_000_000_000;
/// Cycles of a motion before the arm's success rate of commands is counted.
const RATE_AFTER_CYCLES: u64 = 100;

const MS: u64 = 1_000_000;
/// Longest stop \[ns\].
const STOP_TIMEOUT_NS: u64 = 950 * MS;
/// Longest braking and finishing \[ns\]; what is left is for StopMove.
const FINISH_TIMEOUT_NS: u64 = 700 * MS;
/// Longest wait for a state during a stop.
const STOP_STATE_TIMEOUT: Duration = Duration::from_millis(60);
/// Longest wait for the arm's final answer once it rests \[ns\].
const ANSWER_TIMEOUT_NS: u64 = 100 * MS;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Nothing was commanded yet.
    Ready,
    /// A motion runs.
    Moving,
    /// The motion has ended, for this reason.
    Ended(Fault),
    /// Stopped by this side.
    Stopped,
}

/// A Franka arm with an open session. Made by [`crate::connect()`]; dropping it ends its motion.
#[derive(Debug)]
pub struct FrankaArm {
    transport: Transport,
    limits: RobotLimits,
    settings: Settings,
    phase: Phase,
    motion: Motion,
    followed: Followed,
    first_id: u64,
}

impl FrankaArm {
    pub(crate) fn new(settings: &Settings, transport: Transport, limits: RobotLimits) -> FrankaArm {
        let state = transport.state;
        FrankaArm {
            limits,
            settings: settings.clone(),
            phase: Phase::Ready,
            motion: Motion::new(settings, &limits, &state, state.reflex_reason, transport.protocol()),
            followed: Followed { point: Point::at_rest(state.q_d), missed: 0, own: true, shown_ns: None, late: false },
            first_id: state.message_id,
            transport,
        }
    }

    /// The newest state as the loop takes it.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn report(&self) -> State {
        let state = &self.transport.state;
        let q_d = if self.phase == Phase::Moving { self.followed.point.q } else { state.q_d };
        State {
            seq: state.message_id,
            time: state.message_id.saturating_sub(self.first_id) as f64 * PERIOD_S,
            q: widen(&state.q),
            dq: widen(&state.dq),
            tau: widen(&state.tau_j),
            q_d: widen(&q_d),
        }
    }

    // Ready to moving.

    /// Asks for the motion and returns with the first state that shows it running.
    fn begin(&mut self) -> Result<(), Fault> {
        let timeout = self.settings.state_timeout;
        self.transport.discard_backlog(timeout)?;
        let protocol = self.transport.protocol();
        let old_reasons = self.transport.state.reflex_reason;
        self.transport.telemetry.motion_began();
        self.transport.call_move(request(&self.settings, protocol)).map_err(|_| Fault::Disconnected)?;
        let begin = now_ns();
        while !self.transport.shows_motion() {
            self.transport.read_answers().map_err(|_| Fault::Disconnected)?;
            if let Some(status) = self.transport.answer() {
                return Err(refused(status));
            }
            if now_ns().saturating_sub(begin) > START_TIMEOUT_NS {
                return Err(Fault::Refused { code: REFUSED_NO_START });
            }
            self.transport.take_newest(timeout)?;
        }
        self.motion = Motion::new(&self.settings, &self.limits, &self.transport.state, old_reasons, protocol);
        if !self.transport.state.q_d.iter().all(|q| q.is_finite()) {
            return Err(Fault::Refused { code: REFUSED_NOT_FINITE });
        }
        self.transport.set_running(true);
        self.phase = Phase::Moving;
        self.follow();
        Ok(())
    }

    // Moving.

    /// One cycle of a running motion: the newest state, or the reason of the motion's end.
    fn continue_motion(&mut self) -> Result<State, Fault> {
        let taken = self.transport.take_newest(self.settings.state_timeout);
        let answers = self.transport.read_answers();
        if self.transport.motion_has_ended() {
            return Err(self.end_reason());
        }
        taken?;
        answers.map_err(|_| Fault::Disconnected)?;
        self.follow();
        if self.motion.cycles >= RATE_AFTER_CYCLES {
            self.transport.telemetry.rate(self.transport.state.control_command_success_rate);
        }
        Ok(self.report())
    }

    /// Determines the arm's reference in the newest state.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn follow(&mut self) {
        self.followed = self.motion.follow(&self.transport.state);
        let arrival_ns = self.transport.arrival_ns();
        let round_trip_ns = self.followed.shown_ns.map(|sent_ns| arrival_ns.saturating_sub(sent_ns));
        self.transport.telemetry.followed(self.followed.late, self.followed.own, round_trip_ns);
    }

    /// Sends `answer`, and keeps it if it has left.
    fn send(&mut self, answer: &Answer) -> Result<(), Fault> {
        let command = self.motion.command(&self.transport.state, answer);
        let Some(now) = self.transport.send(&command)? else { return Ok(()) };
        self.motion.sent(self.transport.state.message_id, now, answer);
        self.transport.count_sent(now, answer.held, answer.returning);
        Ok(())
    }

    /// Answers the newest state of a running motion.
    fn answer(&mut self, command: &Command) -> Result<(), Fault> {
        let refused = |code| Err(Fault::Refused { code });
        let (desired, dq_d) = (narrow(&command.desired.q), narrow(&command.desired.dq));
        let (tau_ff, tau_vendor) = (narrow(&command.tau_ff.0), narrow(&command.tau_vendor.0));
        // The arm's own controller adds `tau_vendor`.
        let ahead: [f64; 7] = std::array::from_fn(|j| tau_ff[j] - tau_vendor[j]);
        if desired.iter().chain(&dq_d).chain(&ahead).any(|value| !value.is_finite()) {
            return refused(REFUSED_NOT_FINITE);
        }
        let from = self.followed.point;
        match self.motion.limiter.objection(&from, &desired) {
            Some(Objection::NotFinite) => return refused(REFUSED_NOT_FINITE),
            Some(Objection::Position) => return refused(REFUSED_POSITION),
            Some(Objection::Jump) => return refused(REFUSED_JUMP),
            None => {}
        }
        let ticks = self.motion.ticks_since(self.transport.state.message_id);
        if ticks == 0 {
            // This state was answered before; one command per state is all that the arm takes.
            return Ok(());
        }
        if self.settings.interface == Interface::Torque {
            let tracking = Tracking::of(desired, dq_d, &self.transport.state);
            if self.motion.torque.out_of_reach(&tracking) {
                return refused(REFUSED_REACH);
            }
            let (tau, held) = self.motion.torque.torque(&tracking, &ahead);
            let point = Point { q: desired, dq: dq_d, ddq: [0.0; 7] };
            return self.send(&Answer { point, tau, held, ..Answer::default() });
        }
        let own = self.followed.own && self.followed.missed == 0;
        let Limited { point, held, returning, aim } = self.motion.step(&from, &desired, ticks, own);
        self.send(&Answer { point, held, returning, aim: Some(aim), ..Answer::default() })
    }

    // Moving to ended.

    /// Why a motion ended by itself: by the first state after it, else by the arm's answer.
    fn end_reason(&mut self) -> Fault {
        // After an answer the state that explains it is on its way.
        let timeout = self.settings.state_timeout;
        let begin = now_ns();
        while self.transport.ended_in().is_none() && u128::from(now_ns().saturating_sub(begin)) < timeout.as_nanos() {
            // An arm that sends no states has lost its commands for the same reason.
            if let Err(fault) = self.transport.take_newest(timeout) {
                return fault;
            }
        }
        let stall = self.transport.recent.worst();
        let Some(state) = self.transport.ended_in().copied() else {
            self.transport.telemetry.stalled(&stall);
            return self.transport.answer().map_or(Fault::Disconnected, refused);
        };
        let _ = self.transport.read_answers();
        self.transport.telemetry.motion_ended(state.reflex_reason, state.errors, state.robot_mode, &stall);
        // A user stop leaves the reasons of an earlier end where they were.
        let named = state.robot_mode == RobotMode::Reflex || state.reflex_reason != self.motion.old_reasons;
        match (gravest(state.reflex_reason), self.transport.answer()) {
            (Some(bit), _) if named => Fault::Reflex { code: bit as u32 },
            // Ended in order, though not by this side.
            (_, Some(status)) if state.robot_mode == RobotMode::Idle => refused(status),
            _ => Fault::Reflex { code: REFLEX_MODE + u32::from(state.robot_mode.code()) },
        }
    }

    fn end(&mut self, fault: Fault) {
        self.transport.telemetry.stalled(&self.transport.recent.worst());
        self.transport.set_running(false);
        self.phase = Phase::Ended(fault);
    }

    // Any phase to stopped.

    /// Ends whatever runs, within a second.
    fn halt(&mut self) {
        let begin = now_ns();
        match self.phase {
            Phase::Moving => {
                if !self.finish(begin + FINISH_TIMEOUT_NS) {
                    self.abort(begin + STOP_TIMEOUT_NS);
                }
            }
            // Ended by a fault: unless the arm has reported the end itself, it may still move.
            Phase::Ended(_) if self.transport.call.is_some() && self.settings.purpose == Purpose::Drive => {
                if self.transport.motion_has_ended() {
                    self.await_answer(begin + ANSWER_TIMEOUT_NS);
                } else {
                    self.abort(begin + STOP_TIMEOUT_NS);
                }
            }
            Phase::Ended(_) | Phase::Ready | Phase::Stopped => {}
        }
        self.transport.set_running(false);
        self.phase = Phase::Stopped;
    }

    /// Brakes, commands the end of the motion until states show it, and reads the final answer; `false` where that failed.
    fn finish(&mut self, deadline_ns: u64) -> bool {
        let mut resting = false;
        while now_ns() < deadline_ns {
            if self.transport.take_newest(STOP_STATE_TIMEOUT).is_err() || self.transport.read_answers().is_err() {
                return false;
            }
            if self.transport.motion_has_ended() {
                self.await_answer(now_ns() + ANSWER_TIMEOUT_NS);
                return true;
            }
            self.follow();
            if self.brake(resting).is_err() {
                return false;
            }
            resting = self.motion.rests();
        }
        false
    }

    /// One command of the brake; at rest it ends the motion.
    fn brake(&mut self, finished: bool) -> Result<(), Fault> {
        let point = self.motion.brake(&self.followed.point);
        let mut tau = [0.0; 7];
        if self.settings.interface == Interface::Torque {
            let tracking = Tracking::of(point.q, point.dq, &self.transport.state);
            (tau, _) = self.motion.torque.torque(&tracking, &[0.0; 7]);
        }
        self.send(&Answer { point, tau, finished, ..Answer::default() })
    }

    /// Asks the arm to stop by itself and waits until a state shows that it has.
    fn abort(&mut self, deadline_ns: u64) {
        if self.transport.call_stop().is_err() {
            return;
        }
        while now_ns() < deadline_ns {
            let state = &self.transport.state;
            let idle = state.motion_generator_mode == MotionGeneratorMode::Idle
                && state.controller_mode == ControllerMode::Other;
            if idle || self.transport.ended_in().is_some() {
                self.await_answer(deadline_ns.min(now_ns() + ANSWER_TIMEOUT_NS));
                return;
            }
            if self.transport.take_newest(STOP_STATE_TIMEOUT).is_err() || self.transport.read_answers().is_err() {
                return;
            }
        }
    }

    /// The arm always ends Move with a final answer; it is read, but not awaited beyond the deadline.
    fn await_answer(&mut self, deadline_ns: u64) {
        while self.transport.answer().is_none() && now_ns() < deadline_ns {
            if self.transport.read_answers().is_err() || self.transport.take_newest(STOP_STATE_TIMEOUT).is_err() {
                return;
            }
        }
    }
}

impl Backend for FrankaArm {
    fn joints(&self) -> usize {
        7
    }

    fn read(&mut self) -> Result<State, Fault> {
        let timeout = self.settings.state_timeout;
        let state = match self.phase {
            Phase::Ended(fault) => return Err(fault),
            Phase::Ready if self.settings.purpose == Purpose::Drive => self.begin().map(|()| self.report()),
            Phase::Moving => self.continue_motion(),
            Phase::Ready if !self.transport.has_read => {
                return self.transport.discard_backlog(timeout).map(|()| self.report());
            }
            Phase::Ready | Phase::Stopped => return self.transport.take_newest(timeout).map(|()| self.report()),
        };
        if let Err(fault) = state {
            self.end(fault);
        }
        state
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        match (self.settings.purpose, self.phase) {
            (Purpose::Monitor, _) => Ok(()),
            (Purpose::Drive, Phase::Moving) => self.answer(command),
            (Purpose::Drive, Phase::Ready) => Err(Fault::Refused { code: REFUSED_BEFORE_START }),
            (Purpose::Drive, Phase::Ended(_) | Phase::Stopped) => Err(Fault::Refused { code: REFUSED_STOPPED }),
        }
    }

    fn stop(&mut self) {
        self.halt();
    }

    /// When the kernel received the newest state: from then to its read is the wake-up latency.
    fn deadline_ns(&self) -> Option<u64> {
        self.transport.arrived_ns()
    }
}

impl Drop for FrankaArm {
    fn drop(&mut self) {
        self.halt();
    }
}

/// The reason that represents all of them: the first, but lost communication only where there is no other. It is the one that a job may
/// recover from by itself.
fn gravest(reasons: Errors) -> Option<ErrorBit> {
    let lost = ErrorBit::CommunicationConstraintsViolation;
    reasons.iter().find(|bit| *bit != lost).or(reasons.iter().next())
}

/// The fault of a motion that the arm ended or did not begin.
fn refused(status: MoveStatus) -> Fault {
    let index = MoveStatus::ALL.iter().position(|other| *other == status).unwrap_or(0);
    Fault::Refused { code: REFUSED_MOVE + index as u32 }
}
