//! What the robot answers to requests: motions that start, setters, recovery, models.

use super::geometry::IDENTITY;
use super::limits::{JOINTS, Step, judge_measured};
use super::motion::Motion;
use super::robot::{Phase, RECOVERY, Robot};
use super::setters;
use plumbline_franka::wire::{
    Architecture, CartesianLimit, ErrorBit, Errors, LoadModelStatus, MAX_FIXED_RESPONSE, Move, MoveController,
    MoveGenerator, MoveStatus, RecoveryStatus, Request, Response, RobotModelStatus, SetterStatus, StopStatus, System,
};

impl Robot {
    /// Answers a request, now or when it is done. Connect is not the robot's business.
    pub fn request(&mut self, id: u32, request: &Request) {
        let idle = self.phase == Phase::Idle;
        match request {
            Request::Connect(_) => {}
            Request::Move(wanted) => self.start(id, wanted),
            Request::StopMove => match &mut self.phase {
                Phase::Moving(motion) => {
                    let motion = *motion;
                    self.end(motion, Some(id));
                }
                Phase::Ending(_, ending) if ending.stop.is_none() => ending.stop = Some(id),
                // libfranka's Python examples ask for it behind a motion that has ended by itself.
                Phase::Idle => self.reply(id, &Response::StopMove(StopStatus::Success)),
                _ => self.reply(id, &Response::StopMove(StopStatus::NotPossible)),
            },
            Request::AutomaticErrorRecovery => self.recover(id),
            Request::GetCartesianLimit(_) => {
                let none =
                    CartesianLimit { status: SetterStatus::Success, size: [0.0; 3], frame: IDENTITY, active: false };
                self.reply(id, &Response::GetCartesianLimit(none));
            }
            Request::LoadModelLibrary(target) => {
                let mine = target.architecture == Architecture::X64 && target.system == System::Linux;
                let library = self.served.model_library.clone().filter(|_| mine);
                let (status, library) = match &library {
                    Some(library) => (LoadModelStatus::Success, library.as_slice()),
                    None => (LoadModelStatus::Error, [].as_slice()),
                };
                self.reply(id, &Response::LoadModelLibrary { status, library });
            }
            Request::GetRobotModel => {
                // It reads and changes nothing, so a running motion is no reason to refuse it: libfranka's example of a joint impedance loads
                // the model after its motion has begun.
                let urdf = self.served.urdf.clone();
                self.reply(id, &Response::GetRobotModel { status: RobotModelStatus::Success, urdf: &urdf });
            }
            setter => {
                let status = match (idle, setters::is_valid(setter)) {
                    (false, _) => SetterStatus::NotPossible,
                    (true, false) => SetterStatus::InvalidArgument,
                    (true, true) => {
                        self.set(setter);
                        SetterStatus::Success
                    }
                };
                self.events.push(format!("{}: {status}", setter.kind()));
                self.reply(id, &Response::Setter(setter.kind(), status));
            }
        }
    }

    fn set(&mut self, setter: &Request) {
        match setter {
            Request::SetCollisionBehavior(behavior) => self.collision = *behavior,
            Request::SetEeToK(pose) => self.body.tool.ee_t_k = *pose,
            Request::SetNeToEe(pose) => self.body.tool.ne_t_ee = *pose,
            Request::SetLoad(load) => self.body.tool.load = *load,
            // The simulated arm keeps the impedance of its truth, and filters nothing.
            _ => {}
        }
    }

    /// A request that can't be decoded, of a call with this number.
    pub fn malformed_move(&mut self, id: u32) {
        self.reply(id, &Response::Move(MoveStatus::InvalidArgument));
    }

    fn start(&mut self, id: u32, wanted: &Move) {
        let status = if self.phase != Phase::Idle || self.body_outside() {
            MoveStatus::NotPossible
        } else if !valid(wanted) {
            MoveStatus::InvalidArgument
        } else if wanted.use_async || Motion::is_cartesian(wanted) {
            // A robot has these; this emulator does not.
            MoveStatus::NotPossible
        } else {
            MoveStatus::MotionStarted
        };
        self.reply(id, &Response::Move(status));
        self.events.push(format!("Move ({}, {}): {status}", wanted.controller, wanted.generator));
        if status == MoveStatus::MotionStarted {
            self.reflex_reason = Errors::NONE;
            self.desired = Step::at_rest(&self.desired.q);
            self.phase = Phase::Moving(Motion::new(id, wanted, &self.body.tau_d()));
        }
    }

    fn body_outside(&self) -> bool {
        let q = self.body.q();
        let errors = judge_measured(&self.limits, &q, &[0.0; JOINTS], &[0.0; JOINTS]);
        errors.contains(ErrorBit::JointPositionLimitsViolation)
    }

    fn recover(&mut self, id: u32) {
        let status = match self.phase {
            Phase::Reflex { .. } if self.body_outside() => RecoveryStatus::ManualRequired,
            Phase::Reflex { .. } => {
                self.phase = Phase::Recovering { id, left: RECOVERY };
                self.errors = Errors::NONE;
                return;
            }
            // Nothing to do, which is not an error: programs call it before they begin.
            Phase::Idle => {
                self.reflex_reason = Errors::NONE;
                RecoveryStatus::Success
            }
            _ => RecoveryStatus::NotPossible,
        };
        self.events.push(format!("AutomaticErrorRecovery: {status}"));
        self.reply(id, &Response::AutomaticErrorRecovery(status));
    }

    pub fn reply(&mut self, id: u32, response: &Response) {
        let mut message = vec![0; response.bytes().max(MAX_FIXED_RESPONSE)];
        match response.encode(self.protocol, id, &mut message) {
            Ok(length) => {
                message.truncate(length);
                self.outbox.push(message);
            }
            Err(error) => self.events.push(format!("an answer could not be written: {error}")),
        }
    }
}

/// Whether the arguments of a motion make sense together.
fn valid(wanted: &Move) -> bool {
    let alone = wanted.generator == MoveGenerator::None && wanted.controller != MoveController::External;
    let deviations = [wanted.max_path_deviation, wanted.max_goal_pose_deviation];
    let positive = |value: f64| value.is_finite() && value >= 0.0;
    let sound = deviations
        .iter()
        .all(|deviation| positive(deviation.translation) && positive(deviation.rotation) && positive(deviation.elbow));
    !alone && sound
}
