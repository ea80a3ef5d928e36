//! Checks every command before it is sent.
//!
//! A command passes when it is finite, inside every limit by its stated values and by differences of the sent positions, and when a stop
//! from it remains inside the limits. The measured state is checked, too. A command that fails is not sent: the loop brakes, and samples of
//! the stop pass the checks of [`Guard::check_brake`].

mod history;

use super::moves::{seconds, stop_distances};
use super::torque::{ModelTorques, Torques};
use history::History;
use plumbline_core::{
    Command, JointVec, Kinematics, Limits, MAX_JOINTS, PERIOD_S, Record, Setpoint, SpeedEnvelope, State, Workspace,
};
use std::fmt;
use std::ops::Range;

/// A limit of commands or states.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Limit {
    /// A number of the command is NaN or infinite.
    NotFinite,
    /// A torque of the model is NaN or infinite.
    TorqueNotFinite,
    /// A number of the measured state is NaN or infinite.
    MeasuredNotFinite,
    /// Commanded position.
    Position,
    /// Position at rest after a stop from this command.
    StoppingPosition,
    /// Commanded velocity.
    Velocity,
    /// Velocity that the commanded acceleration leads to even if it is taken back from here on.
    VelocityAhead,
    /// Commanded acceleration.
    Acceleration,
    /// Commanded jerk.
    Jerk,
    /// The stated velocity is not the derivative of the positions.
    StatedVelocity,
    /// The stated acceleration is not the derivative of the positions.
    StatedAcceleration,
    /// Torque of the model: the feed-forward, or what the arm's own controller adds.
    Torque,
    /// Rate of the same.
    TorqueRate,
    /// End effector outside its box; the joint is the axis, x first.
    EndEffectorBox,
    /// End effector inside the sphere around the base.
    BaseSphere,
    /// Measured position away from the position sent last.
    Tracking,
    /// Measured torque.
    MeasuredTorque,
}

/// The first limit that a command or a state broke.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Violation {
    /// Which limit.
    pub limit: Limit,
    /// Joint (axis of the base frame for the box), counted from 0.
    pub joint: usize,
    /// Value found, in the limit's unit.
    pub value: f64,
    /// The limit's value.
    pub bound: f64,
}

impl Violation {
    /// Whether a torque, and so the model, is at fault.
    pub fn is_of_model(&self) -> bool {
        matches!(self.limit, Limit::TorqueNotFinite | Limit::Torque | Limit::TorqueRate)
    }
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Violation { value, bound, .. } = self;
        let joint = self.joint + 1;
        match self.limit {
            Limit::NotFinite => write!(f, "joint {joint}: the command is not a finite number ({value})"),
            Limit::TorqueNotFinite => {
                write!(f, "joint {joint}: the feed-forward torque is not a finite number ({value})")
            }
            Limit::MeasuredNotFinite => write!(f, "joint {joint}: the measured state is not a finite number ({value})"),
            Limit::Position => write!(f, "joint {joint}: commanded position {value:.6} rad, limit {bound:.6}"),
            Limit::StoppingPosition => {
                write!(f, "joint {joint}: would come to rest at {value:.6} rad at best, limit {bound:.6}")
            }
            Limit::Velocity => write!(f, "joint {joint}: commanded velocity {value:.6} rad/s, limit {bound:.6}"),
            Limit::VelocityAhead => write!(f, "joint {joint}: would reach {value:.6} rad/s at best, limit {bound:.6}"),
            Limit::Acceleration => {
                write!(f, "joint {joint}: commanded acceleration {value:.6} rad/s2, limit {bound:.6}")
            }
            Limit::Jerk => write!(f, "joint {joint}: commanded jerk {value:.4} rad/s3, limit {bound:.4}"),
            Limit::StatedVelocity => {
                write!(f, "joint {joint}: stated velocity {value:.6} rad/s, by the positions {bound:.6}")
            }
            Limit::StatedAcceleration => {
                write!(f, "joint {joint}: stated acceleration {value:.6} rad/s2, by the positions {bound:.6}")
            }
            Limit::Torque => write!(f, "joint {joint}: feed-forward torque {value:.4} Nm, limit {bound:.4}"),
            Limit::TorqueRate => write!(f, "joint {joint}: feed-forward torque rate {value:.3} Nm/s, limit {bound:.3}"),
            Limit::EndEffectorBox => {
                let axis = ["x", "y", "z"].get(self.joint).unwrap_or(&"?");
                write!(f, "end effector at {axis} = {value:.4} m, box edge {bound:.4}")
            }
            Limit::BaseSphere => write!(f, "end effector {value:.4} m from the base's origin, radius {bound:.4}"),
            Limit::Tracking => write!(f, "joint {joint}: {value:.6} rad away from its command, tolerance {bound:.6}"),
            Limit::MeasuredTorque => write!(f, "joint {joint}: measured torque {value:.4} Nm, limit {bound:.4}"),
        }
    }
}

/// Limits of the guard.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuardSettings {
    /// Joint limits.
    pub limits: Limits,
    /// Speed limits that depend on position, on top of those of `limits`.
    pub envelope: Option<SpeedEnvelope>,
    /// Workspace of the end effector. The braking distance is not part of it: choose it with room to stop.
    pub workspace: Option<Workspace>,
    /// Largest distance of the measured position from the position sent last \[rad\].
    pub tracking: JointVec,
}

/// Ratio by which a limit may be exceeded: rounding of positions and their differences is no violation.
const ROUNDING_RATIO: f64 = 1e-6;

/// Ratio to the jerk limit up to which stated derivatives agree with the positions: a motion slightly beyond the limit violates it by its
/// differences; only derivatives that need more jerk contradict the positions.
const MAX_JERK_RATIO: f64 = 1.5;

/// The guard: limits, and the history of sent commands.
pub struct Guard {
    joints: usize,
    settings: GuardSettings,
    brake: f64,
    kinematics: Option<Box<dyn Kinematics>>,
    history: History,
    /// The torques sent last; none before the first command.
    last: Option<Torques>,
}

impl Guard {
    /// A guard for an arm that rests at zero until [`start`](Guard::start). `brake` is the share of the acceleration
    /// and jerk limits that the controlled stop uses.
    pub fn new(
        joints: usize,
        mut settings: GuardSettings,
        brake: f64,
        kinematics: Option<Box<dyn Kinematics>>,
    ) -> Guard {
        let ddq = settings.limits.ddq.map(|ddq| brake * ddq);
        settings.envelope = settings.envelope.map(|envelope| envelope.braked_with(&ddq));
        Guard {
            joints: joints.min(MAX_JOINTS),
            settings,
            brake,
            kinematics,
            history: History::at_rest(JointVec::default(), PERIOD_S),
            last: None,
        }
    }

    /// The arm rests at `q` \[rad\].
    pub fn start(&mut self, q: JointVec) {
        self.history = History::at_rest(q, PERIOD_S);
        self.last = None;
    }

    /// Continues after the last three cycles, oldest first.
    pub fn restore(&mut self, last: &[Record; 3]) {
        let dt = |earlier: &Record, later: &Record| seconds(later.state.seq.saturating_sub(earlier.state.seq).max(1));
        self.history = History::at_rest(last[0].command.desired.q, PERIOD_S);
        self.history.push(last[1].command.desired.q, dt(&last[0], &last[1]));
        self.history.push(last[2].command.desired.q, dt(&last[1], &last[2]));
        self.last = Some(torques(&last[2].command));
    }

    /// Checks the command for `dt` \[s\] after the last one, its model torque, and the state that it answers. A command that passes becomes
    /// part of the history.
    pub fn check(&mut self, dt: f64, command: &Command, asked: &ModelTorques, state: &State) -> Result<(), Violation> {
        self.limits(dt, command, asked, state)?;
        if let (Some(space), Some(kinematics)) = (&self.settings.workspace, &self.kinematics) {
            inside(space, kinematics.end_effector(&command.desired.q))?;
        }
        self.sent(dt, command);
        Ok(())
    }

    /// All of [`check`](Guard::check) but the workspace.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn limits(&self, dt: f64, command: &Command, asked: &ModelTorques, state: &State) -> Result<(), Violation> {
        let desired = &command.desired;
        self.finite_command(desired)?;
        self.finite_state(state)?;
        self.measured(state)?;
        for j in self.own_joints() {
            self.position(j, desired.q[j])?;
            self.derivatives(j, desired, dt)?;
            self.can_stop(j, desired)?;
        }
        self.torques(&asked.now, asked.before.as_ref(), dt)?;
        self.torques(&torques(command), self.last.as_ref(), dt)
    }

    /// Checks a sample of the controlled stop, or of the rest after it: finite numbers, positions, torques and the rate of the torques that are
    /// sent. The other limits were just broken, or are kept by the plan of the stop. `state` is `None` where it began the stop.
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn check_brake(
        &mut self,
        dt: f64,
        command: &Command,
        asked: &ModelTorques,
        state: Option<&State>,
    ) -> Result<(), Violation> {
        self.finite_command(&command.desired)?;
        if let Some(state) = state {
            self.finite_state(state)?;
        }
        for j in self.own_joints() {
            self.position(j, command.desired.q[j])?;
        }
        self.torques(&asked.now, None, dt)?;
        self.torques(&torques(command), self.last.as_ref(), dt)?;
        self.sent(dt, command);
        Ok(())
    }

    #[cfg_attr(no_panic, no_panic::no_panic)]
    fn sent(&mut self, dt: f64, command: &Command) {
        self.history.push(command.desired.q, dt);
        self.last = Some(torques(command));
    }

    fn finite_command(&self, desired: &Setpoint) -> Result<(), Violation> {
        self.own_joints().try_for_each(|j| finite(Limit::NotFinite, j, [desired.q[j], desired.dq[j], desired.ddq[j]]))
    }

    fn finite_state(&self, state: &State) -> Result<(), Violation> {
        self.own_joints().try_for_each(|j| finite(Limit::MeasuredNotFinite, j, [state.q[j], state.dq[j], state.tau[j]]))
    }

    fn measured(&self, state: &State) -> Result<(), Violation> {
        for j in self.own_joints() {
            within(Limit::MeasuredTorque, j, state.tau[j], self.settings.limits.tau[j])?;
            within(Limit::Tracking, j, state.q[j] - self.history.last()[j], self.settings.tracking[j])?;
        }
        Ok(())
    }

    /// Checks the target of a motion \[rad\].
    #[cfg_attr(no_panic, no_panic::no_panic)]
    pub fn check_target(&self, target: &JointVec) -> Result<(), Violation> {
        self.own_joints().try_for_each(|j| self.position(j, target[j]))
    }

    fn position(&self, joint: usize, q: f64) -> Result<(), Violation> {
        self.between(Limit::Position, joint, q, q)
    }

    /// `low` and `high` against the position limits; a NaN fails.
    fn between(&self, limit: Limit, joint: usize, low: f64, high: f64) -> Result<(), Violation> {
        let (q_min, q_max) = (self.settings.limits.q_min[joint], self.settings.limits.q_max[joint]);
        if low.is_nan() || low < q_min - ROUNDING_RATIO {
            Err(Violation { limit, joint, value: low, bound: q_min })
        } else if high.is_nan() || high > q_max + ROUNDING_RATIO {
            Err(Violation { limit, joint, value: high, bound: q_max })
        } else {
            Ok(())
        }
    }

    /// Velocity, acceleration and jerk as the arm will see them, and as the setpoint states them.
    fn derivatives(&self, j: usize, desired: &Setpoint, dt: f64) -> Result<(), Violation> {
        let limits = &self.settings.limits;
        let (dq, ddq) = (desired.dq[j], desired.ddq[j]);
        let seen = self.history.differences(j, desired.q[j], dt);
        within(Limit::Velocity, j, seen.dq, self.speed(j, desired.q[j], seen.dq))?;
        within(Limit::Velocity, j, dq, self.speed(j, desired.q[j], dq))?;
        within(Limit::Acceleration, j, seen.ddq, limits.ddq[j])?;
        within(Limit::Acceleration, j, ddq, limits.ddq[j])?;
        within(Limit::Jerk, j, seen.jerk, limits.jerk[j])?;

        // The stop starts from the stated derivatives, so they must be ones that some motion inside the jerk limit has at these positions:
        // `|dq - seen - ddq dt / 2| <= jerk dt^2 / 6` and `|ddq - seen| <= jerk lag`, with the lag of the mean of three samples.
        let dq_seen = seen.dq + 0.5 * ddq * dt;
        if (dq - dq_seen).abs() > MAX_JERK_RATIO * limits.jerk[j] * dt * dt / 6.0 {
            return Err(Violation { limit: Limit::StatedVelocity, joint: j, value: dq, bound: dq_seen });
        }
        if (ddq - seen.ddq).abs() > MAX_JERK_RATIO * limits.jerk[j] * (dt + seen.span) / 3.0 {
            return Err(Violation { limit: Limit::StatedAcceleration, joint: j, value: ddq, bound: seen.ddq });
        }
        Ok(())
    }

    /// Highest speed of joint `j` at position `q` in the direction of `dq`. The stop brakes at least as hard as the envelope falls, and so stays
    /// under it.
    fn speed(&self, j: usize, q: f64, dq: f64) -> f64 {
        let limits = &self.settings.limits;
        let room = if dq > 0.0 { limits.q_max[j] - q } else { q - limits.q_min[j] };
        self.settings.envelope.map_or(limits.dq[j], |envelope| envelope.at(j, room, limits.dq[j]).0)
    }

    /// Whether a stop from here stays inside the limits: otherwise the brake itself would break them.
    fn can_stop(&self, j: usize, desired: &Setpoint) -> Result<(), Violation> {
        let limits = &self.settings.limits;
        let (q, dq, ddq) = (desired.q[j], desired.dq[j], desired.ddq[j]);
        let (ddq_brake, jerk_brake) = (self.brake * limits.ddq[j], self.brake * limits.jerk[j]);
        let ahead = dq + ddq * ddq.abs() / (2.0 * jerk_brake);
        // Until the stop has its full deceleration, the joint continues with at most that speed.
        let way = ahead * (ddq_brake + ddq.abs()) / jerk_brake;
        within(Limit::VelocityAhead, j, ahead, self.speed(j, q + way, ahead))?;
        let (up, down) = stop_distances(dq, ddq, ddq_brake, jerk_brake);
        self.between(Limit::StoppingPosition, j, q - down, q + up)
    }

    /// Both torques: finite, within the limit, and within the rate where `before` came `dt` \[s\] earlier.
    fn torques(&self, now: &Torques, before: Option<&Torques>, dt: f64) -> Result<(), Violation> {
        let limits = &self.settings.limits;
        for j in self.own_joints() {
            finite(Limit::TorqueNotFinite, j, [now.tau_ff.0[j], now.tau_vendor.0[j]])?;
            for tau in [now.tau_ff.0[j], now.tau_vendor.0[j]] {
                within(Limit::Torque, j, tau, limits.tau[j])?;
            }
            if let Some(before) = before {
                for change in [now.tau_ff.0[j] - before.tau_ff.0[j], now.tau_vendor.0[j] - before.tau_vendor.0[j]] {
                    within(Limit::TorqueRate, j, change / dt, limits.dtau[j])?;
                }
            }
        }
        Ok(())
    }

    /// The arm's own joints. The second bound lets the compiler prove that no index is out of bounds.
    fn own_joints(&self) -> Range<usize> {
        0..self.joints.min(MAX_JOINTS)
    }
}

fn torques(command: &Command) -> Torques {
    Torques { tau_ff: command.tau_ff, tau_vendor: command.tau_vendor }
}

/// Checks that an end effector at `x` in the base frame \[m\] is inside the workspace.
#[cfg_attr(no_panic, no_panic::no_panic)]
fn inside(space: &Workspace, x: [f64; 3]) -> Result<(), Violation> {
    for (axis, &value) in x.iter().enumerate() {
        let (low, high) = (space.box_min[axis], space.box_max[axis]);
        // Written so that a NaN fails too.
        if !(value >= low && value <= high) {
            let bound = if value > high { high } else { low };
            return Err(Violation { limit: Limit::EndEffectorBox, joint: axis, value, bound });
        }
    }
    let distance = x.iter().map(|c| c * c).sum::<f64>().sqrt();
    if distance < space.base_radius {
        return Err(Violation { limit: Limit::BaseSphere, joint: 0, value: distance, bound: space.base_radius });
    }
    Ok(())
}

fn finite<const N: usize>(limit: Limit, joint: usize, values: [f64; N]) -> Result<(), Violation> {
    match values.into_iter().find(|value| !value.is_finite()) {
        None => Ok(()),
        Some(value) => Err(Violation { limit, joint, value, bound: f64::MAX }),
    }
}

/// `|value| <= bound` but for rounding; a NaN fails.
fn within(limit: Limit, joint: usize, value: f64, bound: f64) -> Result<(), Violation> {
    if value.abs() <= bound * (1.0 + ROUNDING_RATIO) { Ok(()) } else { Err(Violation { limit, joint, value, bound }) }
}

#[cfg(test)]
mod tests;
