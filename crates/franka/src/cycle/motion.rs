//! The commands of one motion: what was sent, what the next one is, and the arm's reference.

use super::limiter::{Aim, Limited, Limiter};
use super::reference::{Commands, Followed, Point};
use super::torque::TorqueLaw;
use crate::limits::RobotLimits;
use crate::settings::{Controller, Interface, Settings};
use crate::wire::{Errors, Move, MoveController, MoveGenerator, Protocol, RobotCommand, RobotState};

/// Largest difference between a state's `q_d` and the command that it shows \[rad\]: in double precision, and with the rounding of single precision
/// below 4 rad.
const DOUBLE_TOLERANCE: f64 = 1e-9;
const SINGLE_TOLERANCE: f64 = 3e-7;

#[derive(Clone, Copy, Debug)]
pub(super) struct Motion {
    interface: Interface,
    protocol: Protocol,
    /// `reflex_reason` before the motion.
    pub old_reasons: Errors,
    /// Commands sent.
    pub cycles: u64,
    sent: Commands,
    pub limiter: Limiter,
    pub torque: TorqueLaw,
}

/// A command in answer to a state, with what follows from it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Answer {
    /// Commanded point.
    pub point: Point,
    /// Commanded torque, for a motion of torques \[Nm\].
    pub tau: [f64; 7],
    /// Whether the motion ends with it.
    pub finished: bool,
    /// Whether a limit had to be held.
    pub held: bool,
    /// Whether it is on its way back to the motion.
    pub returning: bool,
    /// The limiter's next start, where it has made the point.
    pub aim: Option<Aim>,
}

pub(super) fn request(settings: &Settings, protocol: Protocol) -> Move {
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
    Move::new(controller, generator)
}

impl Motion {
    /// A motion that begins in `state`; `old_reasons` are those of the state before the call of Move.
    pub fn new(
        settings: &Settings,
        limits: &RobotLimits,
        state: &RobotState,
        old_reasons: Errors,
        protocol: Protocol,
    ) -> Motion {
        let tolerance = if protocol >= Protocol::V10 { SINGLE_TOLERANCE } else { DOUBLE_TOLERANCE };
        Motion {
            interface: settings.interface,
            protocol,
            old_reasons,
            cycles: 0,
            sent: Commands::new(state.q_d, tolerance),
            limiter: Limiter::new(*limits, settings.limits_share, state.q_d),
            torque: TorqueLaw::new(settings.torque, limits, settings.limits_share, state.tau_j_d),
        }
    }

    /// The arm's reference in `state`, by the commands sent.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn follow(&mut self, state: &RobotState) -> Followed {
        let shown = Point { q: state.q_d, dq: state.dq_d, ddq: state.ddq_d };
        match self.interface {
            Interface::JointPosition | Interface::JointVelocity => self.sent.follow(state.message_id, &shown),
            // The arm has no desired position of its own here; a missed command repeats the last torque.
            Interface::Torque => {
                let point = self.sent.newest().copied().unwrap_or(Point::at_rest(state.q_d));
                Followed { point, missed: 0, own: true, shown_ns: None, late: false }
            }
        }
    }

    /// The arm's cycles since the last command; 1 before the first.
    pub fn ticks_since(&self, id: u64) -> u64 {
        self.sent.answered().map_or(1, |answered| id.saturating_sub(answered))
    }

    /// The next point towards `desired`. The first is the arm's own, to the bit.
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
        let mut command = RobotCommand { message_id: state.message_id, ..RobotCommand::default() };
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

    /// Whether the last command leaves the arm at rest.
    pub fn rests(&self) -> bool {
        self.sent.newest().is_none_or(Point::rests)
    }

    /// The point that brakes from `from`.
    pub fn brake(&self, from: &Point) -> Point {
        if self.sent.answered().is_none() { Point::at_rest(from.q) } else { self.limiter.brake(from) }
    }

    /// Keeps a command that left. A command that did not leave is not kept: the next one continues from what the arm can have received.
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
