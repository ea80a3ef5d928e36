//! What a backend crate provides beside its [`Backend`]: how its arm is connected, limited, explained and recovered. Nothing here is called by the
//! real-time loop.

use crate::histogram::Distribution;
use crate::joint::{JointVec, Limits, SpeedEnvelope};
use crate::traits::{Backend, Fault};
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::net::IpAddr;
use std::sync::Arc;

/// Why an arm can't be connected or recovered. Its text contains the operator's next step.
pub type ArmError = Box<dyn Error + Send + Sync>;

/// Connector to one arm of one job: the backend's interface to the program, before and between connections.
pub trait ArmConnector: Send + Sync {
    /// Name of the physical arm for the lock against a second program: `franka/172.16.0.2`. `None` for a simulated arm.
    fn lock_name(&self) -> Option<String> {
        None
    }

    /// Address of the arm's controller, where it is reached over a network.
    fn address(&self) -> Option<IpAddr> {
        None
    }

    /// What is commanded.
    fn command_mode(&self) -> CommandMode {
        CommandMode::Motion
    }

    /// Reads the limits that the arm holds commands to, before anything is planned. Nothing moves. `None` where the robot file has them all.
    ///
    /// # Errors
    /// The arm can't be reached.
    fn read_limits(&self) -> Result<Option<ArmLimits>, ArmError> {
        Ok(None)
    }

    /// Connects to the arm. May block for seconds.
    ///
    /// # Errors
    /// The arm can't be reached or used.
    fn connect(&self, options: &ConnectOptions) -> Result<Connected, ArmError>;

    /// How often in one job a program may [recover](ArmConnector::recover) the arm from `fault` without an operator; 0: never.
    fn max_recoveries(&self, _fault: &Fault) -> u32 {
        0
    }

    /// Recovers an arm that stopped by itself. May block for seconds.
    ///
    /// # Errors
    /// The arm's own state does not allow a recovery without an operator, or the recovery failed.
    fn recover(&self) -> Result<(), ArmError> {
        Ok(())
    }
}

/// What an arm is connected for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// Reads states. A physical arm is sent nothing: its own controller holds it.
    Monitor,
    /// Moves the arm.
    Drive,
}

/// What the commands of a backend hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CommandMode {
    /// Positions or velocities: the arm's own controller follows them.
    #[default]
    Motion,
    /// Torques.
    Torque {
        /// The torque of the served model is part of them.
        feed_forward: bool,
    },
}

/// What a connection depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ConnectOptions {
    /// What for.
    pub purpose: Purpose,
    /// Gravity of the present mounting in the base frame \[m/s2\].
    pub gravity: [f64; 3],
    /// States that simulated time may be ahead of the consumer of the records.
    pub max_ahead: u64,
}

/// A connected arm.
pub struct Connected {
    /// The arm in the loop.
    pub backend: Box<dyn Backend>,
    /// Gravity in the base frame that the arm's own controller compensates \[m/s2\].
    pub compensates: [f64; 3],
    /// Pauses an arm in simulated time; `None` for one that keeps wall-clock time.
    pub gate: Option<Arc<dyn TimeGate>>,
    /// The arm as hardware; `None` for a simulated one.
    pub hardware: Option<Hardware>,
}

/// A physical arm at connection.
pub struct Hardware {
    /// Limits that its backend holds commands to.
    pub limits: ArmLimits,
    /// Measured joint position \[rad\].
    pub q: JointVec,
    /// Gravity by the arm's own accelerometers, where it has any and rested.
    pub accelerometers: Option<MeasuredGravity>,
    /// The running session.
    pub monitor: Box<dyn ArmMonitor>,
}

/// The session of a physical arm, seen from outside the loop.
pub trait ArmMonitor: Send {
    /// Robot, protocol and system image, in words.
    fn name(&self) -> String;

    /// A change of the arm's operating mode since the last call.
    fn mode_change(&mut self) -> Option<ModeChange>;

    /// What happened, why, and what the operator does next.
    fn explain(&self, fault: &Fault) -> Explanation;

    /// Statistics of the session so far; [`Link::fault`] is left to the caller.
    fn link(&self) -> Link;
}

/// A change of an arm's operating mode.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModeChange {
    /// The new mode, by the arm's own name.
    pub mode: String,
    /// What the operator does before a motion can start; `None` where one can.
    pub next: Option<String>,
}

/// A fault in words.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Explanation {
    /// What happened, with the arm's own names of its errors.
    pub what: String,
    /// Why, where the session's statistics show it.
    pub cause: Option<String>,
    /// What the operator does next.
    pub next: String,
}

impl std::fmt::Display for Explanation {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(out, "{}.", self.what)?;
        if let Some(cause) = &self.cause {
            write!(out, " {cause}.")?;
        }
        write!(out, " Next: {}", self.next)
    }
}

/// Gravity as sensors show it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeasuredGravity {
    /// Direction in the base frame, a unit vector.
    pub direction: [f64; 3],
    /// Standard deviation of the direction \[rad\].
    pub std: f64,
}

/// Pauses simulated time.
pub trait TimeGate: Send + Sync {
    /// Resumes simulated time.
    fn open(&self);

    /// Pauses simulated time before the next state.
    fn shut(&self);

    /// Reports that the consumer has taken `records` more records.
    fn consumed(&self, records: u64);

    /// States delivered whose records were not taken yet. None are once it is 0 while the gate is shut.
    fn under_way(&self) -> u64;
}

/// Limits that a connected arm holds commands to, its margin included.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ArmLimits {
    /// Joints that have limits here, the first ones.
    pub joints: usize,
    /// Limits of those joints.
    pub limits: Limits,
    /// Their position-dependent speed limit, where there is one.
    pub envelope: Option<SpeedEnvelope>,
}

impl ArmLimits {
    /// The stricter of these limits and those of a job, joint by joint. Joints that the arm does not have keep the job's.
    pub fn within(&self, job: &Limits) -> Limits {
        let (mut limits, arm) = (*job, &self.limits);
        for j in 0..self.joints {
            limits.q_min[j] = limits.q_min[j].max(arm.q_min[j]);
            limits.q_max[j] = limits.q_max[j].min(arm.q_max[j]);
            limits.dq[j] = limits.dq[j].min(arm.dq[j]);
            limits.ddq[j] = limits.ddq[j].min(arm.ddq[j]);
            limits.jerk[j] = limits.jerk[j].min(arm.jerk[j]);
            limits.tau[j] = limits.tau[j].min(arm.tau[j]);
            limits.dtau[j] = limits.dtau[j].min(arm.dtau[j]);
        }
        limits
    }

    /// An envelope below both this one and that of a job: of two joint envelopes the larger offset and the smaller deceleration.
    pub fn envelope_within(&self, job: Option<&SpeedEnvelope>) -> Option<SpeedEnvelope> {
        let none = SpeedEnvelope { offset: JointVec::default(), deceleration: JointVec::default() };
        let mut envelope = job.copied().unwrap_or(none);
        let arm = self.envelope.unwrap_or(none);
        for j in 0..self.joints {
            // A deceleration of 0 is a joint without an envelope.
            if arm.deceleration[j] == 0.0 {
                continue;
            }
            if envelope.deceleration[j] == 0.0 {
                (envelope.offset[j], envelope.deceleration[j]) = (arm.offset[j], arm.deceleration[j]);
            } else {
                envelope.offset[j] = envelope.offset[j].max(arm.offset[j]);
                envelope.deceleration[j] = envelope.deceleration[j].min(arm.deceleration[j]);
            }
        }
        envelope.deceleration.iter().any(|dec| *dec != 0.0).then_some(envelope)
    }
}

/// Statistics of the network link to a robot in one session.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Link {
    /// Robot, protocol version and system image, in words.
    pub robot: String,
    /// States received.
    pub states: u64,
    /// States that never arrived.
    pub lost: u64,
    /// States that arrived and were skipped because a newer one was available at the read.
    pub passed_over: u64,
    /// Packets that came out of order, twice or damaged.
    pub odd: u64,
    /// Commands that left late for the robot's next cycle.
    pub late: u64,
    /// Commands that the rate limiter changed.
    pub limited: u64,
    /// The robot's own share of commands that reached it in time, of the last 100 at a time: least and mean.
    pub success: Option<[f64; 2]>,
    /// From the read of a state to the send of its command.
    pub turnaround: Distribution,
    /// From the arrival of a state at this machine to its read.
    pub wake: Distribution,
    /// From the send of a command to the first state that contains it.
    pub round_trip: Distribution,
    /// From one state's arrival to the next one's.
    pub interval: Distribution,
    /// Direction of gravity in the base frame by the robot's sensors, or the robot's constant where it has none; a unit vector.
    pub gravity: Option<[f64; 3]>,
    /// Gravity in the base frame that the robot's own controller compensates \[m/s2\].
    #[serde(default)]
    pub compensates: Option<[f64; 3]>,
    /// Error that the robot stopped for by its own name, the cause, and the operator's next step.
    pub fault: Option<String>,
}
