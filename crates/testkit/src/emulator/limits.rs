//! What a Franka arm allows its commands: the numbers of Franka's documentation, and the judgement over a commanded step.
//!
//! This is the emulator's own reading of the limits; nothing here comes from the client under test. Source: Franka Control Interface
//! documentation, "Robot and interface specifications" (github.com/frankarobotics/docs) for the Panda and for the FR3 before and from
//! system image 5.9, and its chapter on errors for which violation has which name.

use plumbline_franka::wire::{ErrorBit, Errors, Protocol};

pub const JOINTS: usize = 7;
/// Time between commands \[s\].
pub const TICK: f64 = 1e-3;
/// Numbers this close above a limit are rounding, relative to the limit.
const ROUNDING: f64 = 1e-6;
/// A client of version 10 receives the desired position in single precision only: repeating it is a velocity of up to so much \[rad/s\].
const SINGLE_PRECISION: f64 = 3e-4;
/// How far from the desired position a motion may begin \[rad\]. Franka publishes none; nearer starts past [`START_AT_MEASURED`] fail as
/// discontinuities.
pub const START_POSE: f64 = 0.1;
/// A first position this close to the desired one is the start of the motion, not a step \[rad\]. Franka publishes none. libfranka's examples
/// since 0.21 begin at the measured position, and run on real arms: an arm at rest is off its desired position by the friction of a joint
/// over the stiffness of its controller, some 2 Nm over 2000 Nm/rad, 1 mrad; this is twice that.
pub const START_AT_MEASURED: f64 = 2e-3;
/// Measured positions are noisy: this far outside is still inside \[rad\].
const MEASURED_POSITION: f64 = 1e-3;
/// The same for measured velocities, as share of the limit and absolutely \[rad/s\].
const MEASURED_VELOCITY: (f64, f64) = (0.02, 0.1);

pub type Joints = [f64; JOINTS];

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RobotKind {
    /// Panda, also called FER.
    Panda,
    /// Franka Research 3.
    Fr3,
}

impl RobotKind {
    pub const fn of(protocol: Protocol) -> RobotKind {
        match protocol {
            Protocol::V5 => RobotKind::Panda,
            Protocol::V9 | Protocol::V10 => RobotKind::Fr3,
        }
    }

    pub const fn name(self) -> &'static str {
        match self {
            RobotKind::Panda => "panda",
            RobotKind::Fr3 => "fr3",
        }
    }
}

/// A speed limit that falls towards the ends of a range: `sqrt(2 deceleration distance) - offset`, never below zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Envelope {
    /// Lower end from which the distance counts \[rad\].
    pub lower: Joints,
    /// Upper end from which the distance counts \[rad\].
    pub upper: Joints,
    /// Taken off the speed \[rad/s\].
    pub offset: Joints,
    /// \[rad/s2\]
    pub deceleration: Joints,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Lowest position \[rad\].
    pub q_min: Joints,
    /// Highest position \[rad\].
    pub q_max: Joints,
    /// Highest speed \[rad/s\].
    pub dq: Joints,
    pub envelope: Option<Envelope>,
    /// Highest acceleration \[rad/s2\].
    pub ddq: Joints,
    /// Highest jerk \[rad/s3\].
    pub jerk: Joints,
    /// Highest torque \[Nm\].
    pub tau: Joints,
    /// Highest torque rate \[Nm/s\].
    pub dtau: Joints,
}

const TAU: Joints = [87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0];
const FR3_DQ: Joints = [2.62, 2.62, 2.62, 2.62, 5.26, 4.18, 5.26];
const FR3_DECELERATION: Joints = [6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0];

impl Limits {
    /// The limits of an arm whose system image has `protocol`.
    pub fn of(robot: RobotKind, protocol: Protocol) -> Limits {
        match (robot, protocol) {
            (RobotKind::Panda, _) => Limits::panda(),
            (RobotKind::Fr3, Protocol::V5 | Protocol::V9) => Limits::fr3_before_5_9(),
            (RobotKind::Fr3, Protocol::V10) => Limits::fr3(),
        }
    }

    fn panda() -> Limits {
        Limits {
            q_min: [-2.8973, -1.7628, -2.8973, -3.0718, -2.8973, -0.0175, -2.8973],
            q_max: [2.8973, 1.7628, 2.8973, -0.0698, 2.8973, 3.7525, 2.8973],
            dq: [2.175, 2.175, 2.175, 2.175, 2.61, 2.61, 2.61],
            envelope: None,
            ddq: [15.0, 7.5, 10.0, 12.5, 15.0, 20.0, 20.0],
            jerk: [7500.0, 3750.0, 5000.0, 6250.0, 7500.0, 10000.0, 10000.0],
            tau: TAU,
            dtau: [1000.0; JOINTS],
        }
    }

    fn fr3() -> Limits {
        let q_min = [-2.9007, -1.8361, -2.9007, -3.0770, -2.8763, 0.4398, -3.0508];
        let q_max = [2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508];
        let offset = [0.6599, 0.2517, 0.2000, 0.3533, 0.5757, 0.4878, 0.4628];
        Limits {
            q_min,
            q_max,
            dq: FR3_DQ,
            envelope: Some(Envelope { lower: q_min, upper: q_max, offset, deceleration: FR3_DECELERATION }),
            ddq: [10.0; JOINTS],
            jerk: [5000.0; JOINTS],
            tau: TAU,
            dtau: [1000.0; JOINTS],
        }
    }

    fn fr3_before_5_9() -> Limits {
        Limits {
            q_min: [-2.7437, -1.7837, -2.9007, -3.0421, -2.8065, 0.5445, -3.0159],
            q_max: [2.7437, 1.7837, 2.9007, -0.1518, 2.8065, 4.5169, 3.0159],
            envelope: Some(Envelope {
                lower: [-2.75010, -1.79180, -2.90650, -3.0481, -2.81010, 0.54092, -3.01960],
                upper: [2.75010, 1.79180, 2.90650, -0.1458, 2.81010, 4.52050, 3.01960],
                offset: [0.30, 0.20, 0.20, 0.30, 0.35, 0.35, 0.35],
                deceleration: FR3_DECELERATION,
            }),
            ..Limits::fr3()
        }
    }

    /// Lowest and highest velocity of joint `j` (from 0) at `q` \[rad/s\].
    pub fn speeds(&self, j: usize, q: f64) -> (f64, f64) {
        let most = self.dq[j];
        let Some(envelope) = &self.envelope else { return (-most, most) };
        let towards = |room: f64| {
            let braking = (2.0 * envelope.deceleration[j] * room.max(0.0)).sqrt() - envelope.offset[j];
            braking.clamp(0.0, most)
        };
        (-towards(q - envelope.lower[j]), towards(envelope.upper[j] - q))
    }

    /// Whether joint `j` may be at `q`.
    pub fn inside(&self, j: usize, q: f64) -> bool {
        (self.q_min[j]..=self.q_max[j]).contains(&q)
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Commanded {
    Position,
    Velocity,
}

/// Desired motion of an instant, and how it came about.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Step {
    /// \[rad\]
    pub q: Joints,
    /// \[rad/s\]
    pub dq: Joints,
    /// \[rad/s2\]
    pub ddq: Joints,
    /// \[rad/s3\]
    pub jerk: Joints,
}

impl Step {
    pub fn at_rest(q: &Joints) -> Step {
        Step { q: *q, ..Step::default() }
    }

    /// The step from here to position `q`, by backward Euler.
    pub fn to_position(self, q: &Joints) -> Step {
        self.to_velocity(&std::array::from_fn(|j| (q[j] - self.q[j]) / TICK), q)
    }

    /// The step from here with velocity `dq`, by backward Euler.
    pub fn with_velocity(&self, dq: &Joints) -> Step {
        self.to_velocity(dq, &std::array::from_fn(|j| self.q[j] + dq[j] * TICK))
    }

    fn to_velocity(self, dq: &Joints, q: &Joints) -> Step {
        let ddq = std::array::from_fn(|j| (dq[j] - self.dq[j]) / TICK);
        Step { q: *q, dq: *dq, ddq, jerk: std::array::from_fn(|j| (ddq[j] - self.ddq[j]) / TICK) }
    }

    /// The step that is taken when a command is missing: constant acceleration.
    pub fn extrapolated(&self) -> Step {
        self.with_velocity(&std::array::from_fn(|j| self.dq[j] + self.ddq[j] * TICK))
    }

    /// The step of a brake: every joint by itself, as fast as it may, and as fast as the speed limits before its ends take for granted.
    pub fn braked(&self, limits: &Limits) -> Step {
        self.with_velocity(&std::array::from_fn(|j| {
            let taken_for_granted = limits.envelope.map_or(0.0, |envelope| envelope.deceleration[j]);
            let most = limits.ddq[j].max(taken_for_granted) * TICK;
            self.dq[j] - self.dq[j].clamp(-most, most)
        }))
    }

    pub fn still(&self) -> bool {
        self.dq == [0.0; JOINTS]
    }
}

/// `value` within `limit`, rounding aside; NaN is not.
fn within(value: f64, limit: f64) -> bool {
    value.abs() <= limit * (1.0 + ROUNDING)
}

/// The error of a position outside the range: from system image 5.7.2 on the generator's own error is not used any more.
pub const fn position_error(protocol: Protocol) -> ErrorBit {
    match protocol {
        Protocol::V5 => ErrorBit::JointMotionGeneratorPositionLimitsViolation,
        Protocol::V9 | Protocol::V10 => ErrorBit::JointPositionLimitsViolation,
    }
}

/// Errors of a robot at the command `next` after `last`.
pub fn judge(limits: &Limits, protocol: Protocol, commanded: Commanded, last: &Step, next: &Step) -> Errors {
    let mut errors = judge_place(limits, protocol, last, next);
    for j in 0..JOINTS {
        if !within(next.ddq[j], limits.ddq[j]) {
            errors.set(ErrorBit::JointMotionGeneratorVelocityDiscontinuity);
            // Franka's names are about the commanded quantity: of a velocity, the acceleration is its derivative.
            if commanded == Commanded::Velocity {
                errors.set(ErrorBit::JointMotionGeneratorAccelerationDiscontinuity);
            }
        }
        if !within(next.jerk[j], limits.jerk[j]) {
            errors.set(ErrorBit::JointMotionGeneratorAccelerationDiscontinuity);
        }
    }
    errors
}

/// The same without the discontinuities: what holds for extrapolated steps, too. The speed limit is that of the position before the
/// step, where the client could know it.
pub fn judge_place(limits: &Limits, protocol: Protocol, last: &Step, next: &Step) -> Errors {
    let mut errors = Errors::NONE;
    for j in 0..JOINTS {
        if !limits.inside(j, next.q[j]) {
            errors.set(position_error(protocol));
        }
        let (least, most) = limits.speeds(j, last.q[j]);
        let single = if protocol == Protocol::V10 { SINGLE_PRECISION } else { 0.0 };
        let slack = ROUNDING * limits.dq[j] + single;
        if !(least - slack..=most + slack).contains(&next.dq[j]) {
            errors.set(ErrorBit::JointMotionGeneratorVelocityLimitsViolation);
        }
    }
    errors
}

/// Whether a first position can be the start of a motion instead of a step from the desired one.
pub fn is_start(desired: &Joints, commanded: &Joints) -> bool {
    (0..JOINTS).all(|j| (desired[j] - commanded[j]).abs() <= START_AT_MEASURED)
}

/// Errors of a robot at the first position of a motion.
pub fn judge_start(desired: &Joints, commanded: &Joints) -> Errors {
    let near = (0..JOINTS).all(|j| (desired[j] - commanded[j]).abs() <= START_POSE);
    if near { Errors::NONE } else { Errors::NONE.with(ErrorBit::JointPositionMotionGeneratorStartPoseInvalid) }
}

/// Errors of a robot at torques `next` after `last` \[Nm\].
pub fn judge_torque(limits: &Limits, last: &Joints, next: &Joints) -> Errors {
    let mut errors = Errors::NONE;
    for j in 0..JOINTS {
        if !within((next[j] - last[j]) / TICK, limits.dtau[j]) {
            errors.set(ErrorBit::ControllerTorqueDiscontinuity);
        }
        if !within(next[j], limits.tau[j]) {
            errors.set(ErrorBit::TauJRangeViolation);
        }
    }
    errors
}

/// Errors of a robot at the motion that it measures.
pub fn judge_measured(limits: &Limits, q: &Joints, dq: &Joints, tau: &Joints) -> Errors {
    let mut errors = Errors::NONE;
    for j in 0..JOINTS {
        if q[j] < limits.q_min[j] - MEASURED_POSITION || q[j] > limits.q_max[j] + MEASURED_POSITION {
            errors.set(ErrorBit::JointPositionLimitsViolation);
        }
        let (least, most) = limits.speeds(j, q[j]);
        let (share, slack) = MEASURED_VELOCITY;
        if dq[j] < least * (1.0 + share) - slack || dq[j] > most * (1.0 + share) + slack {
            errors.set(ErrorBit::JointVelocityViolation);
        }
        if tau[j].abs() > limits.tau[j] {
            errors.set(ErrorBit::TauJRangeViolation);
        }
    }
    errors
}

#[cfg(test)]
mod tests {
    use super::*;

    const POSE: Joints = [0.0, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5];

    fn bits(errors: Errors) -> Vec<u8> {
        errors.iter().map(|bit| bit as u8).collect()
    }

    fn judged(limits: &Limits, protocol: Protocol, last: &Step, q: &Joints) -> Vec<u8> {
        bits(judge(limits, protocol, Commanded::Position, last, &last.to_position(q)))
    }

    #[test]
    fn each_limit_has_its_name_and_holds_to_the_digit() {
        for protocol in Protocol::ALL {
            let limits = Limits::of(RobotKind::of(protocol), protocol);
            for j in 0..JOINTS {
                let at_rest = Step::at_rest(&POSE);
                let moved = |by: f64| {
                    let mut q = POSE;
                    q[j] += by;
                    q
                };
                // From rest the first step of one tick holds the jerk limit, and a little more does not.
                let jerk = limits.jerk[j] * 1e-9;
                assert!(judged(&limits, protocol, &at_rest, &moved(jerk)).is_empty());
                assert_eq!(judged(&limits, protocol, &at_rest, &moved(1.01 * jerk)), [15]);
                // Constant acceleration at its limit.
                let mut pushed = at_rest;
                pushed.ddq[j] = limits.ddq[j];
                assert!(judged(&limits, protocol, &pushed, &moved(limits.ddq[j] * 1e-6)).is_empty());
                assert_eq!(judged(&limits, protocol, &pushed, &moved(1.01 * limits.ddq[j] * 1e-6)), [14]);
                // Constant velocity at its limit.
                let most = limits.speeds(j, POSE[j]).1;
                let mut fast = at_rest;
                fast.dq[j] = most;
                assert!(judged(&limits, protocol, &fast, &moved(most * 1e-3)).is_empty());
                let past = if protocol == Protocol::V10 { 4e-7 } else { 1e-8 };
                assert_eq!(judged(&limits, protocol, &fast, &moved(most * 1e-3 + past)), [13]);
                // Out of the range.
                let mut at_end = at_rest;
                at_end.q[j] = limits.q_max[j];
                let mut out = at_end.q;
                out[j] += 1e-9;
                let expected = if protocol == Protocol::V5 { vec![12] } else { vec![0, 13] };
                let found = judged(&limits, protocol, &at_end, &out);
                assert!(found.contains(&expected[0]), "{protocol} joint {j}: {found:?}");
                assert!(!judged(&limits, protocol, &at_rest, &moved(f64::NAN)).is_empty());
            }
        }
    }

    #[test]
    fn the_fr3s_speed_falls_towards_its_ends() {
        let limits = Limits::of(RobotKind::Fr3, Protocol::V10);
        // By hand: sqrt(2 6.0 0.4) - 0.6599.
        assert!((limits.speeds(0, 2.5007).1 - (4.8f64.sqrt() - 0.6599)).abs() < 1e-12);
        assert_eq!(limits.speeds(0, 2.5007).0, -2.62);
        assert_eq!(limits.speeds(3, -0.1169).1, 0.0);
        let older = Limits::of(RobotKind::Fr3, Protocol::V9);
        assert!((older.speeds(3, -3.0421).0 - (0.30 - (8.0f64 * 0.006).sqrt()).min(0.0)).abs() < 1e-12);
    }

    #[test]
    fn a_brake_stays_inside_the_range_that_the_envelope_leaves() {
        let limits = Limits::of(RobotKind::Fr3, Protocol::V10);
        for j in 0..JOINTS {
            let mut q = POSE;
            q[j] = limits.q_max[j] - 0.2;
            let mut step = Step::at_rest(&q);
            step.dq[j] = limits.speeds(j, q[j]).1;
            while !step.still() {
                step = step.braked(&limits);
                assert!(limits.inside(j, step.q[j]), "joint {j}");
            }
        }
    }

    #[test]
    fn torques_have_a_rate_and_a_range() {
        let limits = Limits::of(RobotKind::Fr3, Protocol::V10);
        let zero = [0.0; JOINTS];
        assert!(judge_torque(&limits, &zero, &[1.0; JOINTS]).is_empty());
        assert_eq!(bits(judge_torque(&limits, &zero, &[1.01; JOINTS])), [32]);
        assert_eq!(bits(judge_torque(&limits, &[12.0; JOINTS], &[12.5; JOINTS])), [34]);
        assert_eq!(bits(judge_torque(&limits, &zero, &[f64::NAN; JOINTS])), [32, 34]);
    }
}
