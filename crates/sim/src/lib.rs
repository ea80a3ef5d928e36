//! The simulated arm: articulated-body dynamics, an inner impedance controller behind a joint-position interface like the FCI's,
//! friction, effects, noise, quantisation and lost states.
//!
//! | file | what |
//! |---|---|
//! | `truth`, `truth_file` | the arm's masses, friction, controller, sensors and effects; their file |
//! | `spatial`, `aba` | rigid-body dynamics, independent of the model's |
//! | `effect` | effects that a rigid-body model lacks |
//! | `commands`, `plant` | the controller's smooth target; the integration |
//! | `stability` | whether the step is short enough for gains, friction and inertia |
//! | `typical` | an arm of which only bodies and limits are known |
//! | `sensors`, `gate` | noise, faults and loss; back-pressure at full speed |
//! | `response` | a periodic motion without a loop |
//! | `connector` | the arm as a backend of the daemon |
//! | `hardware` | the arm alone, for an emulator of a robot |
//!
//! It uses `desired.q` of a command only. A motion begins with the first command, which must be at the arm's position.
//! A missing command is extrapolated with constant acceleration. 20 in a row cause a reflex, which only `stop` ends;
//! [`SimArm::with_max_missed`] changes that number. After a stop the arm brakes, keeps reporting, and refuses commands.
//!
//! The same truth, seed and commands give the same states bit by bit.
//!
//! ```
//! use plumbline_core::Backend;
//! use plumbline_model::{Mounting, Robot};
//! use plumbline_sim::{Gate, Pace, SimArm, Truth};
//! use std::sync::Arc;
//!
//! let truth = Truth::parse("sim-panda.toml", include_str!("../../../config/arms/sim-panda.toml"))?;
//! let chain = Robot::load(&truth.robot, None)?.chain;
//! let start = [0.0, -0.4, 0.0, -2.0, 0.3, 1.8, 0.5, 0.0];
//! let pace = Pace::Fast(Arc::new(Gate::unlimited()));
//! let mut arm = SimArm::new(&chain, &truth, Mounting::WALL, start, 1, pace)?;
//! let state = arm.read()?;
//! assert!((state.q[3] + 2.0).abs() < 1e-3);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#![forbid(unsafe_code)]
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

mod aba;
mod commands;
mod connector;
mod effect;
mod gate;
mod hardware;
mod plant;
mod response;
mod sensors;
mod spatial;
mod stability;
mod truth;
mod truth_file;
mod typical;

pub use connector::SimConnector;
pub use effect::Reading;
pub use gate::Gate;
pub use hardware::Hardware;
pub use plant::Exact;
pub use response::Response;
pub use truth::{JointTruth, Truth};
pub use truth_file::TruthFile;
pub use typical::Known;

use commands::{Commands, Refusal, TICK_S};
use effect::Effect;
use nalgebra::Vector3;
use plant::{MAX_STATES, Plant};
use plumbline_core::{Backend, BadInput, Clock, Command, Fault, JointVec, MAX_MISSED_COMMANDS, State};
use plumbline_model::{Chain, Mounting};
use sensors::{Faults, Losses, Sensors};
use std::sync::Arc;

/// `Fault::Refused`: a commanded position was not a number.
pub const REFUSED_NOT_FINITE: u32 = 1;
/// `Fault::Refused`: the commanded position stepped by more than 10 rad/s, or its velocity by more than 0.5 rad/s, in one millisecond.
pub const REFUSED_JUMP: u32 = 2;
/// `Fault::Refused`: the arm was stopped, or its reflex stopped it.
pub const REFUSED_STOPPED: u32 = 3;
/// `Fault::Reflex`: 20 commands in a row were missing (`communication_constraints_violation` of the FCI).
pub const REFLEX_COMMUNICATION: u32 = 25;

/// Number of simulated ticks after which the simulation speed is checked.
const MIN_CHASED_TICKS: u64 = 20;
/// Longest time to catch up after a late read; then simulated time pauses \[ns\].
const MAX_CHASE_NS: u64 = 1_000_000_000;

/// Pace of a simulated arm.
pub enum Pace {
    /// One state per millisecond of this clock, on absolute deadlines. A late read returns the newest due state; earlier states are lost.
    /// If the host cannot simulate in real time, simulated time pauses.
    WallClock(Box<dyn Clock>),
    /// As fast as the gate lets states through.
    Fast(Arc<Gate>),
}

/// Why a simulated arm could not be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimError {
    /// The truth describes another number of joints.
    #[error("the simulated arm has {truth} links, the robot {chain} joints")]
    Joints {
        /// Links in the truth.
        truth: usize,
        /// Joints of the robot.
        chain: usize,
    },
    /// The start pose or the mounting is not finite.
    #[error("the simulated arm cannot start at {value} in {what}")]
    NotFinite {
        /// `joint 3`, `gravity`.
        what: String,
        /// The value given.
        value: f64,
    },
    /// Too many continuous states of effects.
    #[error("the effects have {states} continuous states, the simulated arm has room for {MAX_STATES}")]
    TooManyStates {
        /// States of all effects together.
        states: usize,
    },
    /// The truth file is wrong.
    #[error(transparent)]
    Truth(#[from] BadInput),
}

/// Checks the parts of an arm.
fn check(
    chain: &Chain,
    truth: &Truth,
    gravity: &Vector3<f64>,
    start: &JointVec,
    effects: &[Box<dyn Effect>],
) -> Result<(), SimError> {
    let n = chain.len();
    if truth.joints() != n {
        return Err(SimError::Joints { truth: truth.joints(), chain: n });
    }
    if let Some(&value) = gravity.iter().find(|value| !value.is_finite()) {
        return Err(SimError::NotFinite { what: "gravity".into(), value });
    }
    if let Some(j) = (0..n).find(|&j| !start[j].is_finite()) {
        return Err(SimError::NotFinite { what: format!("joint {}", j + 1), value: start[j] });
    }
    let states = effects.iter().map(|effect| effect.states()).sum();
    if states > MAX_STATES {
        return Err(SimError::TooManyStates { states });
    }
    Ok(())
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    /// No command yet.
    Idle,
    Moving,
    /// Braked by its own reflex; reported until it is stopped.
    Reflex,
    Stopped,
}

/// A simulated arm.
pub struct SimArm {
    joints: usize,
    plant: Plant,
    commands: Commands,
    sensors: Sensors,
    faults: Faults,
    losses: Losses,
    pace: Pace,
    mode: Mode,
    pending: Option<JointVec>,
    missing: u32,
    max_missed: u32,
    seq: u64,
    exact: Exact,
    /// Deadline of state 0 on the wall clock; known from the first read on \[ns\].
    origin_ns: Option<u64>,
}

impl SimArm {
    /// An arm with the kinematics of `chain`, at rest at `start` \[rad\].
    ///
    /// `seed` decides its noise and losses.
    ///
    /// # Errors
    /// [`SimError`] when truth and chain do not fit, or a number is not finite.
    pub fn new(
        chain: &Chain,
        truth: &Truth,
        mounting: Mounting,
        start: JointVec,
        seed: u64,
        pace: Pace,
    ) -> Result<SimArm, SimError> {
        SimArm::under(chain, truth, mounting.gravity(), start, seed, pace)
    }

    /// As [`SimArm::new`], under gravity in the base frame \[m/s2\].
    fn under(
        chain: &Chain,
        truth: &Truth,
        gravity: Vector3<f64>,
        start: JointVec,
        seed: u64,
        pace: Pace,
    ) -> Result<SimArm, SimError> {
        let (n, effects) = (chain.len(), truth.build_effects());
        check(chain, truth, &gravity, &start, &effects)?;
        Ok(SimArm {
            joints: n,
            plant: Plant::new(chain, truth, gravity, &start, effects),
            commands: Commands::at_rest(n, &start),
            sensors: Sensors::new(truth, seed),
            faults: Faults::new(truth, seed),
            losses: Losses::new(truth, seed),
            pace,
            mode: Mode::Idle,
            pending: None,
            missing: 0,
            max_missed: MAX_MISSED_COMMANDS,
            seq: 0,
            exact: Exact::default(),
            origin_ns: None,
        })
    }

    /// An arm that ends a motion after so many missing commands in a row. Above 20, for hosts that stall, it accepts the next command at any
    /// place of the motion, with a mean velocity of at most 10 rad/s. No real arm does.
    pub fn with_max_missed(self, missing: u32) -> SimArm {
        SimArm { max_missed: missing.max(1), ..self }
    }

    /// Whether it has missed commands and tolerates that.
    fn tolerates_gap(&self) -> bool {
        self.max_missed > MAX_MISSED_COMMANDS && self.missing > 0 && self.mode == Mode::Moving
    }

    /// The arm's exact motion at the state read last, for comparisons.
    pub fn exact(&self) -> &Exact {
        &self.exact
    }

    /// One simulated millisecond.
    fn tick(&mut self) -> State {
        match (self.mode, self.pending.take()) {
            (Mode::Moving, Some(q)) => {
                match self.tolerates_gap() {
                    true => self.commands.join(&q, self.missing + 1),
                    false => self.commands.push(&q),
                }
                self.missing = 0;
            }
            (Mode::Moving, None) => {
                self.missing += 1;
                if self.missing < self.max_missed {
                    self.commands.extrapolate();
                } else {
                    self.mode = Mode::Reflex;
                    self.commands.brake();
                }
            }
            (Mode::Idle | Mode::Reflex | Mode::Stopped, _) => self.commands.brake(),
        }
        self.plant.advance(&self.commands);
        self.seq += 1;
        let (mut reading, exact) = self.plant.sense();
        let mut time = self.seq as f64 * TICK_S;
        self.sensors.add_noise(&mut reading);
        self.faults.apply(&mut reading, &mut time);
        self.exact = exact;
        State { seq: self.seq, time, q: reading.q, dq: reading.dq, tau: reading.tau, q_d: *self.commands.newest() }
    }

    /// Whether the next state is due already, so that the present one was not read in time.
    fn is_overdue(&self) -> bool {
        self.origin_ns.is_some_and(|origin| self.now_ns() >= origin.saturating_add((self.seq + 1) * 1_000_000))
    }

    /// Simulates states that were not read in time and states that are lost; returns the one that is due now.
    ///
    /// A host that stalls while it catches up may do so. Simulated time pauses where each simulated millisecond takes longer than one.
    fn catch_up(&mut self, mut state: State) -> State {
        let (first, begin) = (self.seq, self.now_ns());
        let (mut before, mut shortest) = (begin, u64::MAX);
        while self.losses.next() || self.is_overdue() {
            state = self.tick();
            let now = self.now_ns();
            shortest = shortest.min(now.saturating_sub(before));
            before = now;
            let (lived, took) = (self.seq - first, now.saturating_sub(begin));
            let behind = lived >= MIN_CHASED_TICKS && took > lived * 1_000_000;
            if behind && (shortest > 1_000_000 || took > MAX_CHASE_NS) {
                self.origin_ns = Some(now.saturating_sub(self.seq * 1_000_000));
                break;
            }
        }
        state
    }

    /// Time of the arm's clock, 0 without one.
    fn now_ns(&self) -> u64 {
        match &self.pace {
            Pace::WallClock(clock) => clock.now_ns(),
            Pace::Fast(_) => 0,
        }
    }

    /// Waits until the present state is due.
    fn keep_pace(&mut self) {
        if let Pace::WallClock(clock) = &self.pace {
            let now = clock.now_ns();
            let origin = *self.origin_ns.get_or_insert(now.saturating_sub((self.seq - 1) * 1_000_000));
            clock.sleep_until(origin + self.seq * 1_000_000);
        }
    }
}

impl Backend for SimArm {
    fn joints(&self) -> usize {
        self.joints
    }

    fn read(&mut self) -> Result<State, Fault> {
        if let Pace::Fast(gate) = &self.pace {
            gate.pass().map_err(|_| Fault::Disconnected)?;
        }
        let state = self.tick();
        let state = self.catch_up(state);
        self.keep_pace();
        match self.mode {
            Mode::Reflex => {
                // Without a state there is no record.
                if let Pace::Fast(gate) = &self.pace {
                    gate.consumed(1);
                }
                Err(Fault::Reflex { code: REFLEX_COMMUNICATION })
            }
            Mode::Idle | Mode::Moving | Mode::Stopped => Ok(state),
        }
    }

    fn write(&mut self, command: &Command) -> Result<(), Fault> {
        if matches!(self.mode, Mode::Reflex | Mode::Stopped) {
            return Err(Fault::Refused { code: REFUSED_STOPPED });
        }
        let q = &command.desired.q;
        let refusal = match self.tolerates_gap() {
            true => self.commands.refusal_after_gap(q, self.missing + 1),
            false => self.commands.refusal(q),
        };
        match refusal {
            Some(Refusal::NotFinite) => Err(Fault::Refused { code: REFUSED_NOT_FINITE }),
            Some(Refusal::Jump) => Err(Fault::Refused { code: REFUSED_JUMP }),
            None => {
                self.mode = Mode::Moving;
                self.pending = Some(*q);
                Ok(())
            }
        }
    }

    fn stop(&mut self) {
        self.mode = Mode::Stopped;
        self.pending = None;
    }

    fn deadline_ns(&self) -> Option<u64> {
        self.origin_ns.map(|origin| origin + self.seq * 1_000_000)
    }
}

/// Arms of tests.
#[cfg(test)]
mod two_joints;
