//! Fixed-size per-joint values that the other crates exchange.
//!
//! All of them are `Copy` and `repr(C)`, hold no pointer, and have room for [`MAX_JOINTS`] joints; entries past the robot's
//! own joint count are zero. Angles are in rad (m for a prismatic joint), torques in Nm (N), times in s.

/// Maximum number of joints: the length of every per-joint array.
pub const MAX_JOINTS: usize = 8;

/// One number per joint; entries past the robot's joint count are zero.
pub type JointVec = [f64; MAX_JOINTS];

/// Torque that was commanded or computed by a model, as opposed to measured \[Nm\].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Torque(pub JointVec);

/// State that the arm reports in one cycle.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// Cycle counter of the arm. Consecutive states differ by one; a larger step means lost states.
    pub seq: u64,
    /// Time since connection, by the arm's clock \[s\].
    pub time: f64,
    /// Measured joint position \[rad\].
    pub q: JointVec,
    /// Measured joint velocity \[rad/s\].
    pub dq: JointVec,
    /// Measured joint torque, gravity included \[Nm\].
    pub tau: JointVec,
    /// Last desired joint position that the arm accepted \[rad\].
    pub q_d: JointVec,
}

/// Desired position, velocity and acceleration of one cycle.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Setpoint {
    /// Desired joint position \[rad\].
    pub q: JointVec,
    /// Desired joint velocity \[rad/s\].
    pub dq: JointVec,
    /// Desired joint acceleration \[rad/s2\].
    pub ddq: JointVec,
}

/// Command that is sent to the arm in response to one state.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// `seq` of the state that this command responds to.
    pub seq: u64,
    /// Desired motion; a position interface uses `desired.q` alone.
    pub desired: Setpoint,
    /// Feed-forward torque of the served model at `desired`, or a rate-limited transition to it; see [`Validity`] \[Nm\].
    pub tau_ff: Torque,
    /// Torque of the same model at rest at `desired.q` under the gravity that the arm's own controller compensates \[Nm\]. That controller
    /// adds this torque; such an arm is sent `tau_ff - tau_vendor`.
    pub tau_vendor: Torque,
}

/// Motion phase of a cycle.
#[repr(u32)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Phase {
    /// Holding the last desired position.
    #[default]
    Hold = 0,
    /// Moving to the start of a motion.
    Approach = 1,
    /// Following a periodic motion.
    Excite = 2,
    /// Moving back to the rest pose.
    Return = 3,
    /// Controlled stop after a guard violation or a request.
    Stop = 4,
    /// At rest after a stop. Motion starts again only on an operator's request.
    Stopped = 5,
}

impl Phase {
    /// The phase of a code from a message; `None` for an unknown code.
    pub fn from_u32(code: u32) -> Option<Phase> {
        [Phase::Hold, Phase::Approach, Phase::Excite, Phase::Return, Phase::Stop, Phase::Stopped]
            .into_iter()
            .find(|phase| *phase as u32 == code)
    }
}

/// Validity of the feed-forward torque of a cycle.
#[repr(u32)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Validity {
    /// No model has been served yet: the torque is zero and must not be used.
    #[default]
    None = 0,
    /// The served model's torque.
    Valid = 1,
    /// Rate-limited transition from another torque to the torque of the served model.
    HandOver = 2,
    /// The model was withdrawn or violated a limit, and no other is served: the torque is ramped to zero, or is zero.
    Withdrawn = 3,
    /// The served model's torque, which the measured one contradicts: something has changed, and no model has it yet.
    Doubtful = 4,
}

impl Validity {
    /// The validity of a code from a message; `None` for an unknown code.
    pub fn from_u32(code: u32) -> Option<Validity> {
        [Validity::None, Validity::Valid, Validity::HandOver, Validity::Withdrawn, Validity::Doubtful]
            .into_iter()
            .find(|validity| *validity as u32 == code)
    }

    /// Whether a model is served.
    pub fn is_served(self) -> bool {
        matches!(self, Validity::Valid | Validity::HandOver | Validity::Doubtful)
    }
}

/// Record of one cycle: state, command and timing.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Record {
    /// Number of this cycle since the loop started, without gaps.
    pub cycle: u64,
    /// The state read.
    pub state: State,
    /// The command written.
    pub command: Command,
    /// Motion phase.
    pub phase: Phase,
    /// Number of the motion that the cycle belongs to, from its motion request; 0 before the first.
    pub motion: u32,
    /// Sample of that motion, counted from 0.
    pub tick: u64,
    /// Identity of the served model, 0 while there is none.
    pub model: u64,
    /// Validity of the feed-forward torque.
    pub validity: Validity,
    /// Time at which the state had been read, `CLOCK_MONOTONIC` \[ns\].
    pub stamp_ns: u64,
    /// Wake-up latency: delay of the read after the state's deadline, 0 where the arm has no deadline \[ns\].
    pub wake_ns: u64,
    /// Execution time of the previous cycle, from state read to command written \[ns\].
    pub work_ns: u64,
}

/// Limits per joint. Every command is checked against them before it is sent.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Limits {
    /// Lowest position \[rad\].
    pub q_min: JointVec,
    /// Highest position \[rad\].
    pub q_max: JointVec,
    /// Highest speed \[rad/s\].
    pub dq: JointVec,
    /// Highest acceleration \[rad/s2\].
    pub ddq: JointVec,
    /// Highest jerk \[rad/s3\].
    pub jerk: JointVec,
    /// Highest torque \[Nm\].
    pub tau: JointVec,
    /// Highest torque rate \[Nm/s\].
    pub dtau: JointVec,
}

/// Position-dependent speed limit of a joint, as of the Franka Research 3:
/// `dq <= min(dq_max, max(0, sqrt(2 dec (q_max - q)) - offset))`, and mirrored at the lower end.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct SpeedEnvelope {
    /// Subtracted from the speed at which a joint can still brake before the end of its range \[rad/s\].
    pub offset: JointVec,
    /// Braking deceleration \[rad/s2\]; 0 for a joint whose speed limit does not depend on its position.
    pub deceleration: JointVec,
}

impl SpeedEnvelope {
    /// The envelope with each deceleration limited to `ddq` \[rad/s2\]: a stop with `ddq` that starts below the limit stays below it.
    pub fn braked_with(&self, ddq: &JointVec) -> SpeedEnvelope {
        let deceleration = std::array::from_fn(|j| self.deceleration[j].min(ddq[j]));
        SpeedEnvelope { deceleration, ..*self }
    }

    /// Highest speed of joint `j` (from 0) and its derivative with respect to `room`. `room` is the distance to the end of the range in the
    /// direction of motion \[rad\]. The speed is at most `dq_max` \[rad/s\].
    pub fn at(&self, j: usize, room: f64, dq_max: f64) -> (f64, f64) {
        let dec = self.deceleration[j];
        if dec == 0.0 {
            return (dq_max, 0.0);
        }
        let root = (2.0 * dec * room.max(0.0)).sqrt();
        let speed = root - self.offset[j];
        if speed >= dq_max {
            (dq_max, 0.0)
        } else if speed > 0.0 {
            (speed, dec / root)
        } else {
            (0.0, 0.0)
        }
    }
}

/// Allowed region of the end effector in the base frame, paper eq. 14.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Workspace {
    /// Lower corner of the box around the arm \[m\].
    pub box_min: [f64; 3],
    /// Upper corner of that box \[m\].
    pub box_max: [f64; 3],
    /// Radius of the forbidden sphere around the base frame's origin \[m\].
    pub base_radius: f64,
}
