//! The robot as its interface shows it: modes, motions, errors. No sockets and no clock: one call a millisecond. What it answers to
//! requests is in `requests`.
//!
//! What Franka has not published is decided on the strict side: setters are taken when idle alone; a motion counts missing commands from
//! the first state on that shows it; commands must carry the number of the newest state.

use super::body::{Body, Drive};
use super::limits::{
    Commanded, JOINTS, Joints, Limits, Step, is_start, judge, judge_measured, judge_place, judge_start, judge_torque,
};
use super::motion::{Ending, Motion};
use plumbline_franka::wire::{
    CollisionBehavior, ControllerMode, ErrorBit, Errors, MotionGeneratorMode, MoveStatus, Protocol, RecoveryStatus,
    Response, RobotCommand, RobotMode, RobotState, StopStatus,
};

/// Missing commands in a row that are a violation.
pub const MISSING: u32 = 20;
/// How long a recovery takes \[ms\].
pub const RECOVERY: u32 = 50;
/// How long the inner controller takes from the desired position before a motion to a first position that is its start \[ms\].
const BLEND: u32 = 200;
/// How long errors show at least \[ms\].
const SHOWN: u32 = 100;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatorAction {
    UserStop,
    Release,
    /// Guides the arm by hand, as long as it is idle.
    Guide,
    LetGo,
    Lock,
    Unlock,
    /// Runs into the arm: pushes against joint 4 for a tenth of a second.
    Push,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub struct Served {
    /// Shared library for clients that load one; without it the answer is an error.
    pub model_library: Option<Vec<u8>>,
    pub urdf: String,
    /// `O_ddP_O` of every state \[m/s2\].
    pub base_acceleration: [f64; 3],
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Phase {
    Idle,
    Moving(Motion),
    Ending(Motion, Ending),
    Reflex { since: u32 },
    UserStopped,
    Guiding,
    Locked,
    Recovering { id: u32, left: u32 },
}

pub struct Robot {
    pub protocol: Protocol,
    pub limits: Limits,
    pub body: Body,
    pub served: Served,
    pub collision: CollisionBehavior,
    pub desired: Step,
    /// What the inner controller still lags behind the start of a motion \[rad\], and for how long \[ms\].
    blend: (Joints, u32),
    pub phase: Phase,
    pub errors: Errors,
    pub reflex_reason: Errors,
    collided: [bool; JOINTS],
    pub message_id: u64,
    pub outbox: Vec<Vec<u8>>,
    pub events: Vec<String>,
}

impl Robot {
    /// An idle robot that holds `start` \[rad\]. `message_id` is what the state before its first one would have had.
    pub fn new(
        protocol: Protocol,
        limits: Limits,
        body: Body,
        start: &Joints,
        served: Served,
        message_id: u64,
    ) -> Robot {
        let desired = Step::at_rest(start);
        Robot {
            protocol,
            limits,
            body,
            served,
            collision: thresholds(),
            desired,
            blend: ([0.0; JOINTS], 0),
            phase: Phase::Idle,
            errors: Errors::NONE,
            reflex_reason: Errors::NONE,
            collided: [false; JOINTS],
            message_id,
            outbox: Vec::new(),
            events: Vec::new(),
        }
    }

    /// Number of the state made last, which a command has to carry.
    pub fn message_id(&self) -> u64 {
        self.message_id
    }

    /// Whether a motion runs whose next command must come before the next millisecond.
    pub fn awaits_command(&self) -> bool {
        matches!(&self.phase, Phase::Moving(motion) if motion.shown)
    }

    /// Messages for the client, oldest first.
    pub fn outbox(&mut self) -> Vec<Vec<u8>> {
        std::mem::take(&mut self.outbox)
    }

    /// Events as text, oldest first.
    pub fn events(&mut self) -> Vec<String> {
        std::mem::take(&mut self.events)
    }

    /// One millisecond, with the command that came in time, if one did; returns the state at its end.
    pub fn cycle(&mut self, command: Option<&RobotCommand>) -> RobotState {
        let drive = match self.phase {
            Phase::Moving(motion) => self.follow(motion, command),
            _ => None,
        };
        let drive = drive.unwrap_or_else(|| {
            self.desired = self.desired.braked(&self.limits);
            Drive::Track
        });
        self.blend.1 = if drive == Drive::Track { self.blend.1.saturating_sub(1) } else { 0 };
        self.body.advance(&Step { q: self.tracked(), ..self.desired }, drive);
        self.watch();
        self.settle();
        self.message_id += 1;
        self.state()
    }

    /// A running motion takes a command or extrapolates without one; `None` when the motion has ended with it.
    fn follow(&mut self, mut motion: Motion, command: Option<&RobotCommand>) -> Option<Drive> {
        if !motion.shown {
            motion.shown = true;
            self.phase = Phase::Moving(motion);
            return Some(motion.drive());
        }
        motion.count(command.is_some());
        let mut errors = Errors::NONE;
        let mut status = MoveStatus::ReflexAborted;
        let mut next = self.desired;
        let mut torque_step = [0.0; JOINTS];
        match command {
            Some(command) => {
                if !motion.is_finite(command) {
                    status = MoveStatus::InputErrorAborted;
                }
                next = match motion.commanded() {
                    Some(Commanded::Position) => {
                        if !motion.begun {
                            errors = judge_start(&self.desired.q, &command.q_c);
                        }
                        self.desired.to_position(&command.q_c)
                    }
                    Some(Commanded::Velocity) => self.desired.with_velocity(&command.dq_c),
                    None => self.desired,
                };
                if let (true, Some(commanded)) = (errors.is_empty(), motion.commanded()) {
                    errors = judge(&self.limits, self.protocol, commanded, &self.desired, &next);
                    let from_start = self.step_from_start(&mut motion, command);
                    if let (false, Some(from_start)) = (errors.is_empty(), from_start) {
                        if !motion.begun {
                            let tracked = self.tracked();
                            self.blend = (std::array::from_fn(|j| tracked[j] - from_start.q[j]), BLEND);
                        }
                        (next, errors, motion.start) = (from_start, Errors::NONE, None);
                    }
                }
                if let Some(tau) = &mut motion.tau {
                    torque_step = std::array::from_fn(|j| command.tau_j_d[j] - tau[j]);
                    errors = union(errors, judge_torque(&self.limits, tau, &command.tau_j_d));
                    *tau = command.tau_j_d;
                }
                motion.begun = true;
            }
            None if motion.missing >= MISSING => errors.set(ErrorBit::CommunicationConstraintsViolation),
            None => {
                if motion.commanded().is_some() {
                    next = self.desired.extrapolated();
                    motion.start = motion.start.map(|start| start.extrapolated());
                    errors = judge_place(&self.limits, self.protocol, &self.desired, &next);
                }
            }
        }
        if !errors.is_empty() {
            let why = match command {
                Some(command) => {
                    format!("command {}: {}", command.message_id, boldest(&self.limits, &next, &torque_step))
                }
                None => format!("{} commands missing in a row", motion.missing),
            };
            self.phase = Phase::Moving(motion);
            self.abort(errors, status, &why);
            return None;
        }
        self.desired = next;
        if command.is_some_and(|command| motion.is_finished_by(command)) {
            self.end(motion, None);
            // The step that came with the flag is the last one of the motion.
            return motion.tau.is_none().then_some(Drive::Track);
        }
        self.phase = Phase::Moving(motion);
        Some(motion.drive())
    }

    /// Where the inner controller drives the joints to: the desired position, but for a smooth way to the start of a motion.
    fn tracked(&self) -> Joints {
        let (lag, left) = self.blend;
        let s = f64::from(left) / f64::from(BLEND);
        let share = s * s * s * (10.0 + s * (6.0 * s - 15.0));
        std::array::from_fn(|j| self.desired.q[j] + share * lag[j])
    }

    /// The step of a position command where the motion's first position is its start, at rest, and no step from the desired position;
    /// `None` where the first position is too far for that, or where a step breaks a limit. From the third step on both are the same.
    fn step_from_start(&self, motion: &mut Motion, command: &RobotCommand) -> Option<Step> {
        if motion.commanded() != Some(Commanded::Position) {
            return None;
        }
        let step = if motion.begun {
            let last = motion.start?;
            let next = last.to_position(&command.q_c);
            judge(&self.limits, self.protocol, Commanded::Position, &last, &next).is_empty().then_some(next)
        } else {
            let start = Step::at_rest(&command.q_c);
            let errors = judge_place(&self.limits, self.protocol, &start, &start);
            (is_start(&self.desired.q, &command.q_c) && errors.is_empty()).then_some(start)
        };
        motion.start = step;
        step
    }

    /// Looks at what is measured while a motion runs.
    fn watch(&mut self) {
        let external = self.body.external();
        let accelerates = self.desired.ddq.iter().any(|ddq| ddq.abs() > 1e-3);
        let upper = if accelerates {
            (&self.collision.upper_torque_acceleration, &self.collision.upper_force_acceleration)
        } else {
            (&self.collision.upper_torque_nominal, &self.collision.upper_force_nominal)
        };
        let hit: [bool; JOINTS] = std::array::from_fn(|j| external[j].abs() > upper.0[j]);
        let pushed = self.body.external_wrench().iter().zip(upper.1).any(|(force, most)| force.abs() > *most);
        let mut errors = match self.phase {
            Phase::Moving(_) => judge_measured(&self.limits, &self.body.q(), &self.body.dq(), &self.body.tau()),
            _ => Errors::NONE,
        };
        if hit.contains(&true) {
            errors.set(ErrorBit::JointReflex);
        }
        if pushed {
            errors.set(ErrorBit::CartesianReflex);
        }
        // Before the first command nothing has moved that could have met something.
        let moves = match self.phase {
            Phase::Moving(motion) => motion.begun,
            Phase::Ending(..) => true,
            _ => false,
        };
        if moves && !errors.is_empty() {
            self.collided = hit;
            self.abort(errors, MoveStatus::ReflexAborted, "measured");
        }
    }

    /// What ends by itself: orderly ends of motions, errors after the brake, recoveries.
    fn settle(&mut self) {
        let dq = self.body.dq();
        match &mut self.phase {
            Phase::Ending(motion, ending) => {
                if !ending.rests(&self.desired, &dq) {
                    return;
                }
                let (motion, ending) = (*motion, *ending);
                self.phase = Phase::Idle;
                self.answer_end(&motion, &ending);
            }
            Phase::Reflex { since } => {
                *since += 1;
                if *since > SHOWN && self.desired.still() {
                    self.errors = Errors::NONE;
                }
            }
            Phase::Recovering { id, left: 0 } => {
                let id = *id;
                self.phase = Phase::Idle;
                self.reflex_reason = Errors::NONE;
                self.collided = [false; JOINTS];
                self.reply(id, &Response::AutomaticErrorRecovery(RecoveryStatus::Success));
                self.events.push("recovered".into());
            }
            Phase::Recovering { left, .. } if self.desired.still() => *left -= 1,
            _ => {}
        }
    }

    /// An orderly end: by the client's flag, by StopMove (its call), or because the client has disconnected.
    pub fn end(&mut self, motion: Motion, stop: Option<u32>) {
        self.leave_torques(&motion);
        self.phase = Phase::Ending(motion, Ending::new(stop));
    }

    fn answer_end(&mut self, motion: &Motion, ending: &Ending) {
        let status = if ending.stop.is_some() { MoveStatus::Preempted } else { MoveStatus::Success };
        self.reply(motion.id, &Response::Move(status));
        if let Some(stop) = ending.stop {
            self.reply(stop, &Response::StopMove(StopStatus::Success));
        }
        self.events.push(format!("motion ended: {status}"));
    }

    /// The robot ends a motion: it brakes, and the next state has the reasons.
    fn abort(&mut self, errors: Errors, status: MoveStatus, why: &str) {
        let (motion, stop) = match self.phase {
            Phase::Moving(motion) => (motion, None),
            Phase::Ending(motion, ending) => (motion, ending.stop),
            _ => return,
        };
        self.leave_torques(&motion);
        self.errors = errors;
        self.reflex_reason = errors;
        self.phase = Phase::Reflex { since: 0 };
        self.reply(motion.id, &Response::Move(status));
        if let Some(stop) = stop {
            self.reply(stop, &Response::StopMove(StopStatus::ReflexAborted));
        }
        self.events.push(format!("reflex: {errors} ({why})"));
    }

    /// From torques back to the inner controller, from where the arm is and as fast as it moves.
    fn leave_torques(&mut self, motion: &Motion) {
        if motion.tau.is_some() {
            self.desired = self.body.take_over();
        }
    }

    pub fn operate(&mut self, action: OperatorAction) {
        let next = match (action, self.phase) {
            (OperatorAction::UserStop, _) => {
                self.break_off();
                Phase::UserStopped
            }
            (OperatorAction::Lock, _) => {
                self.break_off();
                Phase::Locked
            }
            (OperatorAction::Release, Phase::UserStopped)
            | (OperatorAction::LetGo, Phase::Guiding)
            | (OperatorAction::Unlock, Phase::Locked) => Phase::Idle,
            (OperatorAction::Guide, Phase::Idle) => Phase::Guiding,
            (OperatorAction::Push, same) => {
                self.events.push("Push".into());
                self.body.push();
                same
            }
            (_, same) => {
                self.events.push(format!("{action:?} does nothing now"));
                same
            }
        };
        if next != self.phase {
            self.events.push(format!("{action:?}"));
        }
        self.phase = next;
    }

    /// Ends whatever runs with the answers of a pressed user stop.
    fn break_off(&mut self) {
        match self.phase {
            Phase::Moving(motion) => {
                self.leave_torques(&motion);
                self.reply(motion.id, &Response::Move(MoveStatus::EmergencyAborted));
            }
            Phase::Ending(motion, ending) => {
                self.reply(motion.id, &Response::Move(MoveStatus::EmergencyAborted));
                if let Some(stop) = ending.stop {
                    self.reply(stop, &Response::StopMove(StopStatus::EmergencyAborted));
                }
            }
            Phase::Recovering { id, .. } => {
                self.reply(id, &Response::AutomaticErrorRecovery(RecoveryStatus::EmergencyAborted));
            }
            _ => {}
        }
        self.errors = Errors::NONE;
    }

    /// The client has disconnected: the arm brakes.
    pub fn client_gone(&mut self) {
        if let Phase::Moving(motion) = self.phase {
            self.end(motion, None);
        }
        // No client receives the answers.
        if let Phase::Ending(..) = self.phase {
            self.phase = Phase::Idle;
        }
        self.outbox.clear();
    }

    fn state(&mut self) -> RobotState {
        let mut state = RobotState { message_id: self.message_id, ..RobotState::default() };
        self.body.report(&self.desired, &mut state);
        state.o_ddp_o = self.served.base_acceleration;
        let level = |is: bool| if is { 1.0 } else { 0.0 };
        let force = state.o_f_ext_hat_k;
        let lower = (&self.collision.lower_torque_nominal, &self.collision.lower_force_nominal);
        state.joint_contact = std::array::from_fn(|j| level(state.tau_ext_hat_filtered[j].abs() > lower.0[j]));
        state.cartesian_contact = std::array::from_fn(|k| level(force[k].abs() > lower.1[k]));
        state.joint_collision = self.collided.map(level);
        state.errors = self.errors;
        state.reflex_reason = self.reflex_reason;
        state.robot_mode = match self.phase {
            Phase::Idle => RobotMode::Idle,
            Phase::Moving(_) | Phase::Ending(..) => RobotMode::Move,
            Phase::Reflex { .. } => RobotMode::Reflex,
            Phase::UserStopped => RobotMode::UserStopped,
            Phase::Guiding => RobotMode::Guiding,
            Phase::Locked => RobotMode::Other,
            Phase::Recovering { .. } => RobotMode::ErrorRecovery,
        };
        (state.motion_generator_mode, state.controller_mode) = match &self.phase {
            Phase::Moving(motion) | Phase::Ending(motion, _) => {
                (motion.request.generator.shown(), motion.request.controller.shown())
            }
            _ => (MotionGeneratorMode::Idle, ControllerMode::Other),
        };
        if let Phase::Moving(motion) = &self.phase {
            state.control_command_success_rate = motion.success_rate();
        }
        state
    }
}

/// The joint whose step is the largest against its limits, as text.
fn boldest(limits: &Limits, step: &Step, torque_step: &Joints) -> String {
    let share = |j: usize| {
        let parts =
            [step.dq[j] / limits.dq[j], step.ddq[j] / limits.ddq[j], step.jerk[j] / limits.jerk[j], torque_step[j]];
        parts.iter().fold(0.0, |most: f64, part| if part.is_nan() { f64::INFINITY } else { most.max(part.abs()) })
    };
    let j = (0..JOINTS).max_by(|a, b| share(*a).total_cmp(&share(*b))).unwrap_or(0);
    format!(
        "joint {} to {:.4} rad, {:.3} rad/s, {:.2} rad/s2, {:.0} rad/s3, by {:.3} Nm",
        j + 1,
        step.q[j],
        step.dq[j],
        step.ddq[j],
        step.jerk[j],
        torque_step[j]
    )
}

fn union(a: Errors, b: Errors) -> Errors {
    b.iter().fold(a, Errors::with)
}

/// Thresholds until a client sets some: those of libfranka's examples.
fn thresholds() -> CollisionBehavior {
    let torque: Joints = [20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0];
    let force = [20.0, 20.0, 20.0, 25.0, 25.0, 25.0];
    CollisionBehavior {
        lower_torque_acceleration: torque,
        upper_torque_acceleration: torque,
        lower_torque_nominal: torque,
        upper_torque_nominal: torque,
        lower_force_acceleration: force,
        upper_force_acceleration: force,
        lower_force_nominal: force,
        upper_force_nominal: force,
    }
}
