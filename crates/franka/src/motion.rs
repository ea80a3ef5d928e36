//! One motion: how it begins, what it commands, and how its end is read.

// The walls of the real-time loop: clippy.toml.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

use super::arm::{FrankaArm, Phase, answer_to};
use super::codes::{REFLEX_MODE, REFUSED_MOVE, REFUSED_NO_START, REFUSED_NOT_FINITE};
use super::limiter::{Aim, Limited, Limiter};
use super::limits::RobotLimits;
use super::reference::{Commands, Followed, Point};
use super::settings::{Controller, Interface, Settings};
use super::torque::TorqueLaw;
use super::wire::{
    ControllerMode, ErrorBit, Errors, MotionGeneratorMode, Move, MoveController, MoveGenerator, MoveStatus, Protocol,
    Request, RobotCommand, RobotMode, RobotState,
};
use plumbline_core::Fault;
use plumbline_rt::os::now_ns;

/// Longest wait for the motion to start \[ns\].
const START_NS: u64 = 1_000_000_000;
/// How far a state's `q_d` may be off what was sent \[rad\]: double precision, and the rounding of single precision below 4 rad.
const EXACT: f64 = 1e-9;
const ROUNDED: f64 = 3e-7;

/// A motion, or the one that is to begin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    interface: Interface,
    protocol: Protocol,
    request: Move,
    /// Number of the call of Move, once sent.
    pub call: Option<u32>,
    /// The arm's last word about it, once it has ended.
    end: Option<MoveStatus>,
    /// `reflex_reason` as it stood before.
    old_reasons: Errors,
    /// Commands sent.
    pub cycles: u64,
    sent: Commands,
    pub limiter: Limiter,
    pub torque: TorqueLaw,
}

/// What answers a state.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Answer {
    /// Where it leads.
    pub point: Point,
    /// The torque, for a motion of torques \[Nm\].
    pub tau: [f64; 7],
    /// Whether the motion ends with it.
    pub finished: bool,
    /// Whether a limit had to be held.
    pub held: bool,
    /// Whether it is on its way back to the motion.
    pub returning: bool,
    /// What the limiter goes on from, where it has made the point.
    pub aim: Option<Aim>,
}

impl Motion {
    pub fn new(settings: &Settings, limits: &RobotLimits, state: &RobotState, protocol: Protocol) -> Motion {
        let controller = match (settings.interface, settings.controller) {
            (Interface::Torque, _) => MoveController::External,
            (_, Controller::JointImpedance) => MoveController::JointImpedance,
            (_, Controller::CartesianImpedance) => MoveController::CartesianImpedance,
        };
        let generator = match settings.interface {
            Interface::JointPosition => MoveGenerator::JointPosition,
            Interface::JointVelocity => MoveGenerator::JointVelocity,
            Interface::Torque => MoveGenerator::torque_only(protocol),
        };
        let tolerance = if protocol >= Protocol::V10 { ROUNDED } else { EXACT };
        Motion {
            interface: settings.interface,
            protocol,
            request: Move::new(controller, generator),
            call: None,
            end: None,
            old_reasons: state.reflex_reason,
            cycles: 0,
            sent: Commands::new(state.q_d, tolerance),
            limiter: Limiter::new(*limits, settings.limits_share, state.q_d),
            torque: TorqueLaw::new(settings.torque, limits, settings.limits_share, state.tau_j_d),
        }
    }

    /// Whether `state` shows this motion running.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn is_shown_by(&self, state: &RobotState) -> bool {
        let generator: MotionGeneratorMode = self.request.generator.shown().shown_at(self.protocol);
        let controller: ControllerMode = self.request.controller.shown();
        state.motion_generator_mode == generator
            && state.controller_mode == controller
            && state.robot_mode == RobotMode::Move
    }

    /// Takes in the arm's word.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn heard(&mut self, status: MoveStatus) {
        if status != MoveStatus::MotionStarted {
            self.end = Some(status);
        }
    }

    /// Whether the arm has said that the motion is over.
    pub fn is_over(&self) -> bool {
        self.end.is_some()
    }

    /// Where the arm is in `state`, by what was sent.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn follow(&mut self, state: &RobotState) -> Followed {
        let said = Point { q: state.q_d, dq: state.dq_d, ddq: state.ddq_d };
        match self.interface {
            Interface::JointPosition | Interface::JointVelocity => self.sent.follow(state.message_id, &said),
            // The arm has no desired position of its own here; a missed command repeats the last torque.
            Interface::Torque => {
                let point = self.sent.newest().copied().unwrap_or(Point::at_rest(state.q_d));
                Followed { point, alone: 0, own: true, shown_ns: None, late: false }
            }
        }
    }

    /// The position that the arm was told last, or went on to by itself.
    pub fn position(&self, followed: &Followed) -> [f64; 7] {
        followed.point.q
    }

    /// The arm's cycles since the last command; 1 before the first.
    pub fn ticks_since(&self, id: u64) -> u64 {
        self.sent.answered().map_or(1, |answered| id.saturating_sub(answered))
    }

    /// The next point towards `desired`. The first is where the arm says that it is, to the bit.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn step(&self, from: &Point, desired: &[f64; 7], ticks: u64, own: bool) -> Limited {
        let first = self.sent.answered().is_none();
        let limited = self.limiter.step(from, desired, ticks, own && !first);
        if first {
            Limited { point: Point::at_rest(from.q), held: false, returning: false, ..limited }
        } else {
            limited
        }
    }

    /// The command that answers `state`.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn command(&self, state: &RobotState, answer: &Answer) -> RobotCommand {
        let mut command = answer_to(state);
        match self.interface {
            Interface::JointPosition => command.q_c = answer.point.q,
            Interface::JointVelocity => command.dq_c = answer.point.dq,
            Interface::Torque => command.tau_j_d = answer.tau,
        }
        let torque_only = self.interface == Interface::Torque && self.protocol.has_torque_only();
        command.motion_generation_finished = answer.finished && !torque_only;
        command.torque_command_finished = answer.finished && torque_only;
        command
    }

    /// Whether no command was sent yet.
    pub fn is_unanswered(&self) -> bool {
        self.sent.answered().is_none()
    }

    /// Whether the last command leaves the arm at rest.
    pub fn rests(&self) -> bool {
        self.sent.newest().is_none_or(Point::rests)
    }

    /// The command that brakes from `from`.
    pub fn brake(&self, from: &Point) -> Point {
        self.limiter.brake(from)
    }

    /// Takes in that a command left. Nothing of it is remembered before: the next one goes on from what the arm can have got.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn sent(&mut self, id: u64, at_ns: u64, answer: &Answer) {
        self.sent.push(id, at_ns, answer.point);
        if let Some(aim) = answer.aim {
            self.limiter.sent(aim);
        }
        if self.interface == Interface::Torque {
            self.torque.sent(answer.tau);
        }
        self.cycles += 1;
    }
}

impl FrankaArm {
    /// Asks for the motion and returns with the first state that shows it running.
    pub(super) fn begin(&mut self) -> Result<(), Fault> {
        self.discard_backlog()?;
        self.motion = Motion::new(&self.settings, &self.limits, &self.state, self.protocol());
        self.telemetry.motion_began();
        let request = Request::Move(self.motion.request);
        let call = self.commands.post(self.protocol(), &request).map_err(|_| Fault::Disconnected)?;
        self.motion.call = Some(call);
        let begin = now_ns();
        while !self.motion.is_shown_by(&self.state) {
            self.hear().map_err(|_| Fault::Disconnected)?;
            if let Some(status) = self.motion.end {
                return Err(refused(status));
            }
            if now_ns().saturating_sub(begin) > START_NS {
                return Err(Fault::Refused { code: REFUSED_NO_START });
            }
            self.take_newest(self.settings.state_timeout)?;
        }
        let Motion { request, call, end, old_reasons, .. } = self.motion;
        self.motion = Motion {
            request,
            call,
            end,
            old_reasons,
            ..Motion::new(&self.settings, &self.limits, &self.state, self.protocol())
        };
        if !self.state.q_d.iter().all(|q| q.is_finite()) {
            return Err(Fault::Refused { code: REFUSED_NOT_FINITE });
        }
        self.changed = None;
        self.phase = Phase::Moving;
        self.follow();
        Ok(())
    }

    /// Why a motion ended by itself: what the first state after it says, else what the arm says over TCP.
    pub(super) fn conclude(&mut self) -> Fault {
        // Heard over TCP first: the state that explains it is on its way.
        let patience = self.settings.state_timeout;
        let begin = now_ns();
        while self.changed.is_none() && u128::from(now_ns().saturating_sub(begin)) < patience.as_nanos() {
            // An arm that is silent over UDP has lost its commands for that reason.
            if let Err(fault) = self.take_newest(patience) {
                return fault;
            }
        }
        let stall = self.recent.worst();
        let Some(state) = self.changed else {
            self.telemetry.stalled(&stall);
            return self.motion.end.map_or(Fault::Disconnected, refused);
        };
        let _ = self.hear();
        self.telemetry.motion_ended(state.reflex_reason, state.errors, state.robot_mode, &stall);
        // A user stop leaves the reasons of an earlier end where they were.
        let named = state.robot_mode == RobotMode::Reflex || state.reflex_reason != self.motion.old_reasons;
        match (gravest(state.reflex_reason), self.motion.end) {
            (Some(bit), _) if named => Fault::Reflex { code: bit as u32 },
            // Ended in order, though not by us.
            (_, Some(status)) if state.robot_mode == RobotMode::Idle => refused(status),
            _ => Fault::Reflex { code: REFLEX_MODE + u32::from(state.robot_mode.code()) },
        }
    }
}

/// The reason that stands for all of them: the first, but lost communication only where there is no other. It is the one that a job may
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
