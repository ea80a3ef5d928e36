//! What the loop is built from, and what no loop can be built from.

use super::guard::GuardSettings;
use super::moves::MoveFactors;
use super::rights::Rights;
use plumbline_core::MAX_JOINTS;

/// What the loop is built from.
#[derive(Clone, Debug, PartialEq)]
pub struct CycleSettings {
    /// Limits of commands and states.
    pub guard: GuardSettings,
    /// Share of the limits that point-to-point motions and the stop use.
    pub moves: MoveFactors,
    /// Longest run of lost states after which a motion continues. An arm at rest holds after any.
    pub max_consecutive_lost: u64,
    /// Cycles of the arm without a [heartbeat](super::controls::Controls::heartbeat) after which a moving
    /// arm is braked; `None` where no supervisor is required.
    pub heartbeat_timeout: Option<u64>,
    /// Room for orders in the queue.
    pub queue: usize,
    /// Records kept for the outcome, whatever happens to the sink.
    pub flight: usize,
    /// Rights that the loop's thread requests.
    pub rights: Rights,
    /// Whether the loop ends before its first cycle when one of these is refused, instead of running degraded.
    pub must_be_realtime: bool,
}

impl CycleSettings {
    /// The usual loop: 10 lost states in a row (half of what the FCI tolerates), 64 orders, 200 records kept, real-time rights.
    pub fn new(guard: GuardSettings) -> CycleSettings {
        CycleSettings {
            guard,
            moves: MoveFactors::default(),
            max_consecutive_lost: 10,
            heartbeat_timeout: None,
            queue: 64,
            flight: 200,
            rights: Rights::default(),
            must_be_realtime: false,
        }
    }
}

/// Settings that no loop can be built from.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum SetupError {
    /// No joints, or more than fixed-size messages hold.
    #[error("the arm has {joints} joints, expected 1 to {MAX_JOINTS}")]
    Joints {
        /// Joints of the arm.
        joints: usize,
    },
    /// A limit is not a positive number, or the lower position limit is not below the upper one.
    #[error("limit {name} of joint {} is {value}, expected a finite number{expected}", .joint + 1)]
    Limit {
        /// Which limit.
        name: &'static str,
        /// Joint, counted from 0.
        joint: usize,
        /// Its value.
        value: f64,
        /// What more is expected of it.
        expected: &'static str,
    },
    /// A share of the limits is outside (0, 1].
    #[error("the share {name} of the limits is {value}, expected more than 0 and at most 1")]
    Factor {
        /// Which share.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// There is a workspace and no kinematics to hold it with.
    #[error("a workspace was given without kinematics")]
    NoKinematics,
}

impl CycleSettings {
    /// Whether a loop for an arm of `joints` joints can be built from these settings.
    pub(super) fn check(&self, joints: usize, has_kinematics: bool) -> Result<(), SetupError> {
        if joints == 0 || joints > MAX_JOINTS {
            return Err(SetupError::Joints { joints });
        }
        let GuardSettings { limits, workspace, tracking, .. } = &self.guard;
        for (j, &tolerance) in tracking.iter().enumerate().take(joints) {
            let positive = [
                ("dq", limits.dq[j]),
                ("ddq", limits.ddq[j]),
                ("jerk", limits.jerk[j]),
                ("tau", limits.tau[j]),
                ("dtau", limits.dtau[j]),
                ("tracking", tolerance),
            ];
            for (name, value) in positive {
                if !(value.is_finite() && value > 0.0) {
                    return Err(SetupError::Limit { name, joint: j, value, expected: " above 0" });
                }
            }
            for (name, value) in [("q_min", limits.q_min[j]), ("q_max", limits.q_max[j])] {
                if !value.is_finite() {
                    return Err(SetupError::Limit { name, joint: j, value, expected: "" });
                }
            }
            if limits.q_min[j] >= limits.q_max[j] {
                let value = limits.q_max[j];
                return Err(SetupError::Limit { name: "q_max", joint: j, value, expected: " above q_min" });
            }
        }
        let MoveFactors { velocity, acceleration, jerk, brake } = self.moves;
        for (name, value) in [("velocity", velocity), ("acceleration", acceleration), ("jerk", jerk), ("brake", brake)]
        {
            if !(value > 0.0 && value <= 1.0) {
                return Err(SetupError::Factor { name, value });
            }
        }
        if workspace.is_some() && !has_kinematics { Err(SetupError::NoKinematics) } else { Ok(()) }
    }
}
