//! The 41 errors of the arm, as a set. Each state has them twice: those that hold, and those that led to the reflex.

use super::protocol::WireError;

/// One enumeration, its names on libfranka's side, and what each error means.
macro_rules! error_bits {
    ($($(#[doc = $doc:literal])+ $bit:literal $variant:ident $name:literal,)+) => {
        /// One error of the arm; the number is its place in the two arrays of a state.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(u8)]
        pub enum ErrorBit {
            $($(#[doc = $doc])+ $variant = $bit,)+
        }

        impl ErrorBit {
            /// All errors by their number.
            pub const ALL: [ErrorBit; ERROR_BITS] = [$(ErrorBit::$variant,)+];

            /// The name that libfranka prints.
            pub const fn name(self) -> &'static str {
                match self {
                    $(ErrorBit::$variant => $name,)+
                }
            }
        }
    };
}

/// Errors that versions 5 to 10 know; a state holds one byte for each.
pub const ERROR_BITS: usize = 41;

error_bits! {
    /// A joint came too close to its end.
    0 JointPositionLimitsViolation "joint_position_limits_violation",
    /// The end effector left the space that it is allowed.
    1 CartesianPositionLimitsViolation "cartesian_position_limits_violation",
    /// The arm came too close to itself.
    2 SelfCollisionAvoidanceViolation "self_collision_avoidance_violation",
    /// A joint was too fast.
    3 JointVelocityViolation "joint_velocity_violation",
    /// The end effector was too fast.
    4 CartesianVelocityViolation "cartesian_velocity_violation",
    /// The force controller was outside its safe range.
    5 ForceControlSafetyViolation "force_control_safety_violation",
    /// A collision was seen in a joint's torque.
    6 JointReflex "joint_reflex",
    /// A collision was seen in the force at the end effector.
    7 CartesianReflex "cartesian_reflex",
    /// The internal motion generator did not reach its goal.
    8 MaxGoalPoseDeviationViolation "max_goal_pose_deviation_violation",
    /// The internal motion generator left its path.
    9 MaxPathPoseDeviationViolation "max_path_pose_deviation_violation",
    /// The end effector's velocity profile was not safe.
    10 CartesianVelocityProfileSafetyViolation "cartesian_velocity_profile_safety_violation",
    /// A joint motion did not begin at the desired position of the state.
    11 JointPositionMotionGeneratorStartPoseInvalid "joint_position_motion_generator_start_pose_invalid",
    /// A commanded joint position is outside the limits.
    12 JointMotionGeneratorPositionLimitsViolation "joint_motion_generator_position_limits_violation",
    /// A commanded joint velocity is outside the limits.
    13 JointMotionGeneratorVelocityLimitsViolation "joint_motion_generator_velocity_limits_violation",
    /// The commanded joint velocity jumps: the acceleration is outside the limits.
    14 JointMotionGeneratorVelocityDiscontinuity "joint_motion_generator_velocity_discontinuity",
    /// The commanded joint acceleration jumps: the jerk is outside the limits.
    15 JointMotionGeneratorAccelerationDiscontinuity "joint_motion_generator_acceleration_discontinuity",
    /// A pose motion did not begin at the commanded pose of the state.
    16 CartesianPositionMotionGeneratorStartPoseInvalid "cartesian_position_motion_generator_start_pose_invalid",
    /// A commanded pose puts the elbow outside its limits.
    17 CartesianMotionGeneratorElbowLimitViolation "cartesian_motion_generator_elbow_limit_violation",
    /// A commanded Cartesian velocity is outside the limits.
    18 CartesianMotionGeneratorVelocityLimitsViolation "cartesian_motion_generator_velocity_limits_violation",
    /// The commanded Cartesian velocity jumps.
    19 CartesianMotionGeneratorVelocityDiscontinuity "cartesian_motion_generator_velocity_discontinuity",
    /// The commanded Cartesian acceleration jumps.
    20 CartesianMotionGeneratorAccelerationDiscontinuity "cartesian_motion_generator_acceleration_discontinuity",
    /// The commanded elbow changes its side.
    21 CartesianMotionGeneratorElbowSignInconsistent "cartesian_motion_generator_elbow_sign_inconsistent",
    /// A Cartesian motion did not begin at the elbow of the state.
    22 CartesianMotionGeneratorStartElbowInvalid "cartesian_motion_generator_start_elbow_invalid",
    /// The desired force was not kept.
    23 ForceControllerDesiredForceToleranceViolation "force_controller_desired_force_tolerance_violation",
    /// The elbow at the start lies on the other side.
    24 StartElbowSignInconsistent "start_elbow_sign_inconsistent",
    /// Too many commands in a row were lost or late.
    25 CommunicationConstraintsViolation "communication_constraints_violation",
    /// The commanded motion needs too much power.
    26 PowerLimitViolation "power_limit_violation",
    /// A Cartesian motion leads to a joint position outside the limits.
    27 CartesianMotionGeneratorJointPositionLimitsViolation "cartesian_motion_generator_joint_position_limits_violation",
    /// A Cartesian motion leads to a joint velocity outside the limits.
    28 CartesianMotionGeneratorJointVelocityLimitsViolation "cartesian_motion_generator_joint_velocity_limits_violation",
    /// A Cartesian motion leads to a jump of a joint velocity.
    29 CartesianMotionGeneratorJointVelocityDiscontinuity "cartesian_motion_generator_joint_velocity_discontinuity",
    /// A Cartesian motion leads to a jump of a joint acceleration.
    30 CartesianMotionGeneratorJointAccelerationDiscontinuity "cartesian_motion_generator_joint_acceleration_discontinuity",
    /// A commanded pose is not a rigid transformation.
    31 CartesianPositionMotionGeneratorInvalidFrameFlag "cartesian_position_motion_generator_invalid_frame_flag",
    /// The commanded torque jumps: its rate is outside the limits.
    32 ControllerTorqueDiscontinuity "controller_torque_discontinuity",
    /// A point-to-point motion can't be planned with the torques there are.
    33 JointP2pInsufficientTorqueForPlanning "joint_p2p_insufficient_torque_for_planning",
    /// A measured torque left the range of its sensor.
    34 TauJRangeViolation "tau_J_range_violation",
    /// The controller was seen to be unstable.
    35 InstabilityDetected "instability_detected",
    /// A joint at its end was moved further outwards.
    36 JointMoveInWrongDirection "joint_move_in_wrong_direction",
    /// A Cartesian spline of the internal motion generator was broken off.
    37 CartesianSplineMotionGeneratorViolation "cartesian_spline_motion_generator_violation",
    /// The internal motion generator's plan through joint positions leaves the limits.
    38 JointViaMotionGeneratorPlanningJointLimitViolation "joint_via_motion_generator_planning_joint_limit_violation",
    /// The direction of gravity at the base was not measured in time.
    39 BaseAccelerationInitializationTimeout "base_acceleration_initialization_timeout",
    /// The sensor of gravity at the base has an impossible reading.
    40 BaseAccelerationInvalidReading "base_acceleration_invalid_reading",
}

impl ErrorBit {
    /// The error of a number; `None` from 41 on.
    pub fn from_index(index: u8) -> Option<ErrorBit> {
        ErrorBit::ALL.get(usize::from(index)).copied()
    }

    const fn mask(self) -> u64 {
        1 << self as u8
    }
}

impl std::fmt::Display for ErrorBit {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(self.name())
    }
}

/// A set of errors. On the wire it is one byte per error, 0 or 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Errors(u64);

impl Errors {
    /// No error.
    pub const NONE: Errors = Errors(0);

    /// The set of a mask, bit `i` for error `i`; `None` when it holds a bit that is no error.
    pub fn from_bits(bits: u64) -> Option<Errors> {
        (bits >> ERROR_BITS == 0).then_some(Errors(bits))
    }

    /// The mask of the set, bit `i` for error `i`.
    pub const fn bits(self) -> u64 {
        self.0
    }

    /// Whether no error is set.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Number of errors set.
    pub const fn len(self) -> usize {
        self.0.count_ones() as usize
    }

    /// Whether `bit` is set.
    pub const fn contains(self, bit: ErrorBit) -> bool {
        self.0 & bit.mask() != 0
    }

    /// Sets `bit`.
    pub fn set(&mut self, bit: ErrorBit) {
        self.0 |= bit.mask();
    }

    /// Clears `bit`.
    pub fn clear(&mut self, bit: ErrorBit) {
        self.0 &= !bit.mask();
    }

    /// The set with `bit` in it.
    #[must_use]
    pub const fn with(self, bit: ErrorBit) -> Errors {
        Errors(self.0 | bit.mask())
    }

    /// The errors set, by rising number.
    pub fn iter(self) -> impl Iterator<Item = ErrorBit> {
        ErrorBit::ALL.into_iter().filter(move |bit| self.contains(*bit))
    }

    /// The set of one byte per error; `what` is the field that an error names.
    pub(super) fn from_flags(what: &'static str, flags: &[u8]) -> Result<Errors, WireError> {
        let mut errors = Errors::NONE;
        for (index, (bit, flag)) in ErrorBit::ALL.into_iter().zip(flags).enumerate() {
            match flag {
                0 => {}
                1 => errors.set(bit),
                found => return Err(WireError::Flag { what, index, found: *found }),
            }
        }
        Ok(errors)
    }

    pub(super) fn to_flags(self, flags: &mut [u8]) {
        for (bit, flag) in ErrorBit::ALL.into_iter().zip(flags) {
            *flag = u8::from(self.contains(bit));
        }
    }
}

impl FromIterator<ErrorBit> for Errors {
    fn from_iter<I: IntoIterator<Item = ErrorBit>>(bits: I) -> Errors {
        bits.into_iter().fold(Errors::NONE, Errors::with)
    }
}

/// The names, separated by commas; `none` for the empty set.
impl std::fmt::Display for Errors {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        if self.is_empty() {
            return out.write_str("none");
        }
        for (place, bit) in self.iter().enumerate() {
            if place > 0 {
                out.write_str(", ")?;
            }
            out.write_str(bit.name())?;
        }
        Ok(())
    }
}
