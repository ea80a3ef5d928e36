//! The two datagrams of a cycle: the state that the arm sends each millisecond, and the command that answers it.

use super::codes::{ControllerMode, MotionGeneratorMode, RobotMode};
use super::errors::Errors;

/// Length of the longest state of any version \[bytes\]. Receive into one byte more, or a longer datagram looks like a good one.
pub const MAX_STATE: usize = 2373;

/// Everything that the arm reports in a cycle, names as in libfranka's headers in lower case.
///
/// Frames: `O` base, `F` flange, `NE` nominal end effector, `EE` end effector, `K` stiffness. `A_T_B` is the pose of frame B in
/// frame A as a 4x4 matrix, column-major, translations in m. `_d` desired, `_c` commanded. Numbers are as they came, finite or not.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotState {
    /// Counts the states, and is the arm's clock in ms: a step of more than one means lost states.
    pub message_id: u64,
    /// Measured pose of the end effector.
    pub o_t_ee: [f64; 16],
    /// Last desired pose of the end effector.
    pub o_t_ee_d: [f64; 16],
    /// End effector in the flange.
    pub f_t_ee: [f64; 16],
    /// Stiffness frame in the end effector.
    pub ee_t_k: [f64; 16],
    /// Nominal end effector in the flange, as configured in the arm.
    pub f_t_ne: [f64; 16],
    /// End effector in the nominal one.
    pub ne_t_ee: [f64; 16],
    /// Mass of the configured end effector \[kg\].
    pub m_ee: f64,
    /// Inertia of the configured end effector about its centre of mass, column-major \[kg m2\].
    pub i_ee: [f64; 9],
    /// Centre of mass of the configured end effector in the flange \[m\].
    pub f_x_cee: [f64; 3],
    /// Mass of the load set by the client \[kg\].
    pub m_load: f64,
    /// Inertia of the load about its centre of mass, column-major \[kg m2\].
    pub i_load: [f64; 9],
    /// Centre of mass of the load in the flange \[m\].
    pub f_x_cload: [f64; 3],
    /// Position of joint 3 \[rad\], and sign of joint 4.
    pub elbow: [f64; 2],
    /// Desired elbow.
    pub elbow_d: [f64; 2],
    /// Measured torque at the link side, gravity included \[Nm\].
    pub tau_j: [f64; 7],
    /// Desired torque, without gravity \[Nm\].
    pub tau_j_d: [f64; 7],
    /// Derivative of the measured torque \[Nm/s\].
    pub dtau_j: [f64; 7],
    /// Measured joint position \[rad\].
    pub q: [f64; 7],
    /// Desired joint position \[rad\].
    pub q_d: [f64; 7],
    /// Measured joint velocity \[rad/s\].
    pub dq: [f64; 7],
    /// Desired joint velocity \[rad/s\].
    pub dq_d: [f64; 7],
    /// Desired joint acceleration \[rad/s2\].
    pub ddq_d: [f64; 7],
    /// Contact level per joint: 1 while above the lower torque threshold.
    pub joint_contact: [f64; 7],
    /// Contact level per direction x, y, z, R, P, Y.
    pub cartesian_contact: [f64; 6],
    /// Collision level per joint: 1 once above the upper torque threshold, until recovered.
    pub joint_collision: [f64; 7],
    /// Collision level per direction x, y, z, R, P, Y.
    pub cartesian_collision: [f64; 6],
    /// Estimated external torque, low-pass filtered \[Nm\].
    pub tau_ext_hat_filtered: [f64; 7],
    /// Estimated external wrench on the stiffness frame, in the base \[N, Nm\].
    pub o_f_ext_hat_k: [f64; 6],
    /// The same in the stiffness frame \[N, Nm\].
    pub k_f_ext_hat_k: [f64; 6],
    /// Desired twist of the end effector in the base \[m/s, rad/s\].
    pub o_dp_ee_d: [f64; 6],
    /// Linear acceleration of the base that gravity amounts to, in the base \[m/s2\].
    pub o_ddp_o: [f64; 3],
    /// Commanded elbow.
    pub elbow_c: [f64; 2],
    /// Velocity of the commanded elbow.
    pub delbow_c: [f64; 2],
    /// Acceleration of the commanded elbow.
    pub ddelbow_c: [f64; 2],
    /// Last commanded pose of the end effector.
    pub o_t_ee_c: [f64; 16],
    /// Last commanded twist of the end effector \[m/s, rad/s\].
    pub o_dp_ee_c: [f64; 6],
    /// Last commanded acceleration of the end effector \[m/s2, rad/s2\].
    pub o_ddp_ee_c: [f64; 6],
    /// Motor position \[rad\].
    pub theta: [f64; 7],
    /// Motor velocity \[rad/s\].
    pub dtheta: [f64; 7],
    /// Acceleration of six links at their upper sensor, x, y, z each \[m/s2\]; zero before version 10.
    pub accelerometer_top: [[f64; 3]; 6],
    /// The same at their lower sensor; zero before version 10.
    pub accelerometer_bottom: [[f64; 3]; 6],
    /// Motion generator that runs. [`MotionGeneratorMode::None`] goes out as joint velocity at version 5.
    pub motion_generator_mode: MotionGeneratorMode,
    /// Controller that runs.
    pub controller_mode: ControllerMode,
    /// Errors that hold now.
    pub errors: Errors,
    /// Errors that ended the last motion.
    pub reflex_reason: Errors,
    /// What the arm is doing.
    pub robot_mode: RobotMode,
    /// Share of the last 100 commands that came in time, 0 to 1; 0 while no motion runs.
    pub control_command_success_rate: f64,
}

/// Length of the longest command of any version \[bytes\]. Receive into one byte more, or a longer datagram looks like a good one.
pub const MAX_COMMAND: usize = 371;

/// What the client commands for one cycle; what the running motion has no use for is zero. Always in double precision.
///
/// Numbers are decoded as they come, finite or not: the arm checks them.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotCommand {
    /// [`super::RobotState::message_id`] of the newest state seen.
    pub message_id: u64,
    /// Joint position \[rad\].
    pub q_c: [f64; 7],
    /// Joint velocity \[rad/s\].
    pub dq_c: [f64; 7],
    /// Pose of the end effector in the base, column-major.
    pub o_t_ee_c: [f64; 16],
    /// Twist of the end effector in the base \[m/s, rad/s\].
    pub o_dp_ee_c: [f64; 6],
    /// Position of joint 3 \[rad\], and sign of joint 4.
    pub elbow_c: [f64; 2],
    /// Whether the elbow counts.
    pub valid_elbow: bool,
    /// Asks for the end of the motion; repeated until states show that it has ended.
    pub motion_generation_finished: bool,
    /// Joint torque, without gravity \[Nm\].
    pub tau_j_d: [f64; 7],
    /// Asks for the end of a motion of torques alone; from version 7 on, not on the wire before.
    pub torque_command_finished: bool,
}
