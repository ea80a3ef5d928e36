//! What the daemon is started with.

use crate::config::job::Job;
use plumbline_core::{ArmConnector, ArmLimits, CommandMode, JointVec};
use plumbline_model::Robot;
use std::sync::Arc;

/// What the daemon is started with. Nothing of it changes.
pub struct JobSetup {
    pub job: Job,
    pub robot: Robot,
    pub arm: Arc<dyn ArmConnector>,
    /// Limits of the connected arm that the programme was checked under; `None` for a simulated arm.
    pub arm_limits: Option<ArmLimits>,
    /// Where the arm starts and returns to \[rad\].
    pub rest: JointVec,
    pub names: Vec<(u32, String)>,
}

impl JobSetup {
    /// Whether another program controls the arm, which is then never commanded.
    pub fn listens(&self) -> bool {
        self.job.backend.guest().is_some()
    }

    pub fn commands_torques(&self) -> bool {
        matches!(self.arm.command_mode(), CommandMode::Torque { .. })
    }
}
