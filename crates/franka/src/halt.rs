//! The end of a motion by us: brake, finish as the protocol wants it, and leave within a second whatever happens.

// The walls of the real-time loop: clippy.toml.
#![deny(clippy::disallowed_methods, clippy::disallowed_macros)]
#![deny(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    clippy::unreachable,
    clippy::todo,
    clippy::unimplemented
)]

use super::arm::{FrankaArm, Phase};
use super::motion::Answer;
use super::settings::{Interface, Purpose};
use super::torque::Tracking;
use super::wire::{ControllerMode, MotionGeneratorMode, Request};
use plumbline_core::Fault;
use plumbline_rt::os::now_ns;
use std::time::Duration;

const MS: u64 = 1_000_000;
/// The whole of it.
const ALL_NS: u64 = 950 * MS;
/// Braking and finishing; what is left is for StopMove.
const FINISH_NS: u64 = 700 * MS;
/// Silence after which nothing more is expected.
const SILENCE: Duration = Duration::from_millis(60);
/// Wait for the arm's last word once it stands.
const LAST_WORD_NS: u64 = 100 * MS;

impl FrankaArm {
    /// Ends whatever runs. Idempotent, silent, and done within a second.
    pub(super) fn halt(&mut self) {
        let begin = now_ns();
        match self.phase {
            Phase::Moving => {
                if !self.finish(begin + FINISH_NS) {
                    self.abort(begin + ALL_NS);
                }
            }
            // Over by a fault: unless the arm has said so itself, it may still move.
            Phase::Over(_) if self.motion.call.is_some() && self.settings.purpose == Purpose::Drive => {
                if self.changed.is_some() || self.motion.is_over() {
                    self.await_last_word(begin + LAST_WORD_NS);
                } else {
                    self.abort(begin + ALL_NS);
                }
            }
            Phase::Over(_) | Phase::Ready | Phase::Stopped => {}
        }
        self.phase = Phase::Stopped;
    }

    /// Brakes, says that the motion is finished until states show it, and reads the last word; `false` when that did not come about.
    fn finish(&mut self, deadline_ns: u64) -> bool {
        let mut resting = false;
        while now_ns() < deadline_ns {
            if self.take_newest(SILENCE).is_err() || self.hear().is_err() {
                return false;
            }
            if self.changed.is_some() || self.motion.is_over() {
                self.await_last_word(now_ns() + LAST_WORD_NS);
                return true;
            }
            self.follow();
            if self.brake_on(resting).is_err() {
                return false;
            }
            resting = self.motion.rests();
        }
        false
    }

    /// One command of the brake; at rest it carries the word that the motion is finished.
    fn brake_on(&mut self, finished: bool) -> Result<(), Fault> {
        let from = self.followed.point;
        let point = if self.motion.is_unanswered() {
            super::reference::Point::at_rest(from.q)
        } else {
            self.motion.brake(&from)
        };
        let mut tau = [0.0; 7];
        if self.settings.interface == Interface::Torque {
            let tracking = Tracking::of(point.q, point.dq, &self.state);
            (tau, _) = self.motion.torque.torque(&tracking, &[0.0; 7]);
        }
        self.send(&Answer { point, tau, finished, ..Answer::default() })
    }

    /// Asks the arm to stop by itself and waits until it shows that it has.
    fn abort(&mut self, deadline_ns: u64) {
        if self.commands.post(self.protocol(), &Request::StopMove).is_err() {
            return;
        }
        while now_ns() < deadline_ns {
            let idle = self.state.motion_generator_mode == MotionGeneratorMode::Idle
                && self.state.controller_mode == ControllerMode::Other;
            if idle || self.changed.is_some() {
                self.await_last_word(deadline_ns.min(now_ns() + LAST_WORD_NS));
                return;
            }
            if self.take_newest(SILENCE).is_err() || self.hear().is_err() {
                return;
            }
        }
    }

    /// The arm always ends Move with a word; it is read, but not waited for beyond the deadline.
    fn await_last_word(&mut self, deadline_ns: u64) {
        while !self.motion.is_over() && now_ns() < deadline_ns {
            if self.hear().is_err() || self.take_newest(SILENCE).is_err() {
                return;
            }
        }
    }
}
