//! The fixed-size values that every other part of plumbline exchanges.
//!
//! All of them are `Copy` and `repr(C)`, hold no pointer, and have room for [`MAX_JOINTS`] joints; entries past the robot's
//! own joint count are zero. Angles are in rad (m for a prismatic joint), torques in Nm (N), times in s.

/// Room for joints in every fixed-size message.
pub const MAX_JOINTS: usize = 8;

/// One number per joint; entries past the robot's joint count are zero.
pub type JointVec = [f64; MAX_JOINTS];

/// A torque that was commanded or computed by a model, as opposed to measured \[Nm\].
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Torque(pub JointVec);

/// What the arm reported in one cycle.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct State {
    /// The arm's own cycle counter: consecutive states differ by one, a larger step means lost states.
    pub seq: u64,
    /// The arm's own clock since it was connected \[s\].
    pub time: f64,
    /// Measured joint position \[rad\].
    pub q: JointVec,
    /// Measured joint velocity \[rad/s\].
    pub dq: JointVec,
    /// Measured joint torque, gravity included \[Nm\].
    pub tau: JointVec,
    /// The position that the arm last accepted as desired \[rad\].
    pub q_d: JointVec,
}

/// One desired point of a motion.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Setpoint {
    /// Desired joint position \[rad\].
    pub q: JointVec,
    /// Desired joint velocity \[rad/s\].
    pub dq: JointVec,
    /// Desired joint acceleration \[rad/s2\].
    pub ddq: JointVec,
}

/// What is sent to the arm in answer to one state.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Command {
    /// `seq` of the state that this command answers.
    pub seq: u64,
    /// Desired motion; a position interface uses `desired.q` alone.
    pub desired: Setpoint,
    /// Feed-forward torque of the served model at `desired`, or on its way there; see [`Validity`] \[Nm\].
    pub tau_ff: Torque,
    /// The same model at rest at `desired.q`, under the gravity that the arm's own controller compensates: what that controller adds by
    /// itself. Such an arm is sent `tau_ff - tau_vendor` \[Nm\].
    pub tau_vendor: Torque,
}

/// What the loop was doing in a cycle.
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
    /// Braking after a guard's decision or a request; the arm ends at rest.
    Stop = 4,
    /// At rest after a stop; nothing moves before an operator says so.
    Stopped = 5,
}

impl Phase {
    /// The phase of a number that crossed shared memory; `None` when the number is none of them.
    pub fn from_u32(code: u32) -> Option<Phase> {
        [Phase::Hold, Phase::Approach, Phase::Excite, Phase::Return, Phase::Stop, Phase::Stopped]
            .into_iter()
            .find(|phase| *phase as u32 == code)
    }
}

/// What stands behind the feed-forward torque of a cycle.
#[repr(u32)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Validity {
    /// No model has served yet: the torque is zero and means nothing.
    #[default]
    None = 0,
    /// The served model's torque.
    Valid = 1,
    /// On the way from another torque to the served model's, within the torque-rate limit.
    HandOver = 2,
    /// The model was withdrawn or broke a limit, and none serves in its place: the torque is on its way to zero, or there.
    Withdrawn = 3,
}

impl Validity {
    /// The validity of a number that crossed shared memory; `None` when the number is none of them.
    pub fn from_u32(code: u32) -> Option<Validity> {
        [Validity::None, Validity::Valid, Validity::HandOver, Validity::Withdrawn]
            .into_iter()
            .find(|validity| *validity as u32 == code)
    }

    /// Whether a model serves.
    pub fn is_served(self) -> bool {
        matches!(self, Validity::Valid | Validity::HandOver)
    }
}

/// Everything about one cycle: what came in, what went out, and how long it took.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Record {
    /// Number of this cycle since the loop started, without gaps.
    pub cycle: u64,
    /// The state read.
    pub state: State,
    /// The command written.
    pub command: Command,
    /// What the loop was doing.
    pub phase: Phase,
    /// The motion that the cycle belongs to: the number its order carried, 0 before the first.
    pub motion: u32,
    /// Sample of that motion, counted from 0.
    pub tick: u64,
    /// Identity of the served model, 0 while there is none.
    pub model: u64,
    /// What stands behind the torque.
    pub validity: Validity,
    /// `CLOCK_MONOTONIC` when the state had been read \[ns\].
    pub stamp_ns: u64,
    /// Wake-up latency: how late the state was read after its deadline, 0 where the arm has no deadline \[ns\].
    pub wake_ns: u64,
    /// Work of the previous cycle, from state read to command written \[ns\].
    pub work_ns: u64,
}

/// Limits per joint. Every command is checked against them before it leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
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

/// A speed limit that falls towards the ends of a joint's range, as the Franka Research 3 has it:
/// `dq <= min(dq_max, max(0, sqrt(2 dec (q_max - q)) - offset))`, and its mirror image at the lower end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedEnvelope {
    /// Taken off the speed from which a joint can still brake before the end of its range \[rad/s\].
    pub offset: JointVec,
    /// Deceleration that it brakes with \[rad/s2\]; 0 for a joint whose speed limit does not depend on its position.
    pub deceleration: JointVec,
}

impl SpeedEnvelope {
    /// The envelope, where it falls faster than a stop with `ddq` \[rad/s2\], brought down to that: from under it such a stop stays under it.
    pub fn braked_with(&self, ddq: &JointVec) -> SpeedEnvelope {
        let deceleration = std::array::from_fn(|j| self.deceleration[j].min(ddq[j]));
        SpeedEnvelope { deceleration, ..*self }
    }

    /// Highest speed of joint `j` (from 0) at `room` \[rad\] before the end of its range that it moves towards, at most `dq_max`, and
    /// its derivative with respect to `room`.
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

/// Where the end effector may be, in the base frame: paper eq. 14.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Workspace {
    /// Lower corner of the box around the arm \[m\].
    pub box_min: [f64; 3],
    /// Upper corner of that box \[m\].
    pub box_max: [f64; 3],
    /// Radius of the sphere around the base frame's origin that the end effector stays out of \[m\].
    pub base_radius: f64,
}
