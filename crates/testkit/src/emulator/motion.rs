//! A running motion: its request, and the timing of its commands.

use super::body::Drive;
use super::limits::{Commanded, Joints, Step};
use plumbline_franka::wire::{Move, MoveController, MoveGenerator, RobotCommand};

const WINDOW: u32 = 100;
/// A joint that is measured slower than this does not move \[rad/s\].
const STILL: f64 = 5e-3;
/// How long an arm has to be still for its motion to have ended \[ms\].
const SETTLED: u32 = 10;
/// How long that is waited for \[ms\].
const RESTLESS: u32 = 500;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Call that started it, which its end answers, too.
    pub id: u32,
    pub request: Move,
    pub shown: bool,
    pub begun: bool,
    /// The desired motion where the first position is the start of the motion, at rest, while the commands fit that, too.
    pub start: Option<Step>,
    pub missing: u32,
    /// Torques commanded last, where they are commanded \[Nm\].
    pub tau: Option<Joints>,
    /// Which of the last commands came, the newest at bit 0.
    came: u128,
    counted: u32,
}

/// The end of a motion, from its cause to the arm's rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ending {
    pub stop: Option<u32>,
    /// How long nothing has moved \[ms\].
    pub still: u32,
    /// How long it has taken \[ms\].
    pub since: u32,
}

impl Ending {
    /// An end that begins now; `stop` is the call of StopMove, where that is the cause.
    pub fn new(stop: Option<u32>) -> Ending {
        Ending { stop, still: 0, since: 0 }
    }

    /// Counts a millisecond, and whether the arm rests by now: for 10 ms, or because it never will.
    pub fn rests(&mut self, desired: &Step, dq: &Joints) -> bool {
        let still = desired.still() && dq.iter().all(|dq| dq.abs() < STILL);
        self.still = if still { self.still + 1 } else { 0 };
        self.since += 1;
        self.still >= SETTLED || (desired.still() && self.since >= RESTLESS)
    }
}

impl Motion {
    /// A motion that no state has shown yet; `tau` is the desired torque of the state before.
    pub fn new(id: u32, request: &Move, tau: &Joints) -> Motion {
        let external = request.controller == MoveController::External;
        Motion {
            id,
            request: *request,
            shown: false,
            begun: false,
            start: None,
            missing: 0,
            tau: external.then_some(*tau),
            came: 0,
            counted: 0,
        }
    }

    /// Whether a motion is one of the end effector.
    pub fn is_cartesian(request: &Move) -> bool {
        matches!(request.generator, MoveGenerator::CartesianPose | MoveGenerator::CartesianVelocity)
    }

    /// What commands hold for the motion generator, if there is one.
    pub fn commanded(&self) -> Option<Commanded> {
        match self.request.generator {
            MoveGenerator::JointPosition => Some(Commanded::Position),
            MoveGenerator::JointVelocity => Some(Commanded::Velocity),
            MoveGenerator::CartesianPose | MoveGenerator::CartesianVelocity | MoveGenerator::None => None,
        }
    }

    pub fn drive(&self) -> Drive {
        self.tau.map_or(Drive::Track, Drive::Torque)
    }

    /// Counts a command that came, or one that did not.
    pub fn count(&mut self, came: bool) {
        self.came = (self.came << 1) | u128::from(came);
        self.counted = (self.counted + 1).min(WINDOW);
        self.missing = if came { 0 } else { self.missing + 1 };
    }

    /// Share of the last 100 commands that came, 0 to 1; of all while there were fewer.
    pub fn success_rate(&self) -> f64 {
        let window = self.came & ((1 << WINDOW) - 1);
        if self.counted == 0 { 0.0 } else { f64::from(window.count_ones()) / f64::from(self.counted) }
    }

    /// Whether everything that this motion uses of a command is a number.
    pub fn is_finite(&self, command: &RobotCommand) -> bool {
        let generator = match self.commanded() {
            Some(Commanded::Position) => command.q_c,
            Some(Commanded::Velocity) => command.dq_c,
            None => [0.0; 7],
        };
        let tau = self.tau.map_or([0.0; 7], |_| command.tau_j_d);
        generator.iter().chain(&tau).all(|value| value.is_finite())
    }

    pub fn is_finished_by(&self, command: &RobotCommand) -> bool {
        match self.request.generator {
            MoveGenerator::None => command.torque_command_finished,
            _ => command.motion_generation_finished,
        }
    }
}
