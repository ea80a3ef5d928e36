//! The simulated arm as a robot's own firmware has it: driven for one millisecond at a time, by positions or by torques, and read
//! through its sensors. There are no modes, no limits and no losses here: those are the business of the program around it.

use super::commands::{Commands, TICK};
use super::plant::{Exact, Plant};
use super::sensors::{Faults, Sensors};
use super::truth::Truth;
use super::{SimError, check};
use crate::joint::JointVec;
use crate::model::chain::Chain;
use crate::model::gravity::Mounting;

/// What the sensors say at the end of a millisecond.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sensed {
    /// Position \[rad\].
    pub q: JointVec,
    /// Velocity \[rad/s\].
    pub dq: JointVec,
    /// Torque, gravity included \[Nm\].
    pub tau: JointVec,
}

/// Actuators, bodies and sensors of a simulated arm. The same truth, seed and calls give the same readings bit by bit.
pub struct Hardware {
    joints: usize,
    plant: Plant,
    commands: Commands,
    sensors: Sensors,
    faults: Faults,
    /// Whether the inner controller tracks positions, instead of the actuators holding torques.
    tracks: bool,
    time: f64,
    exact: Exact,
}

impl Hardware {
    /// An arm with the kinematics of `chain`, held at rest at `start` \[rad\]; `seed` decides its noise.
    ///
    /// # Errors
    /// [`SimError`] when truth and chain do not fit, or a number is none.
    pub fn new(
        chain: &Chain,
        truth: &Truth,
        mounting: Mounting,
        start: &JointVec,
        seed: u64,
    ) -> Result<Hardware, SimError> {
        let (effects, gravity) = (truth.build_effects(), mounting.gravity());
        check(chain, truth, &gravity, start, &effects)?;
        Ok(Hardware {
            joints: chain.len(),
            plant: Plant::new(chain, truth, gravity, start, effects),
            commands: Commands::at_rest(chain.len(), start),
            sensors: Sensors::new(truth, seed),
            faults: Faults::new(truth, seed),
            tracks: true,
            time: 0.0,
            exact: Exact { q: *start, ..Exact::default() },
        })
    }

    /// One millisecond in which the inner joint impedance controller tracks `q` \[rad\] as the newest of the positions that it has
    /// been given. After torques it takes over first.
    pub fn track(&mut self, q: &JointVec) -> Sensed {
        if !self.tracks {
            self.take_over();
        }
        self.commands.push(q);
        self.advance()
    }

    /// The inner controller takes over from torques, without a jump: it goes on from where the arm is and as fast as it moves. Returns
    /// the position \[rad\] and velocity \[rad/s\] that count as commanded last.
    pub fn take_over(&mut self) -> (JointVec, JointVec) {
        let Exact { q, dq, .. } = self.exact;
        if !self.tracks {
            self.commands = Commands::passing(self.joints, &q, &dq);
            self.plant.take_over(&self.commands);
            self.tracks = true;
        }
        (*self.commands.newest(), dq)
    }

    /// One millisecond in which the actuators hold `tau` \[Nm\]. That is all the torque there is: whoever wants gravity compensated adds it.
    pub fn hold(&mut self, tau: &JointVec) -> Sensed {
        self.plant.hold(tau);
        self.tracks = false;
        self.advance()
    }

    /// The arm's exact motion at the reading taken last; no real arm has this.
    pub fn exact(&self) -> &Exact {
        &self.exact
    }

    fn advance(&mut self) -> Sensed {
        self.plant.advance(&self.commands);
        self.time += TICK;
        let (mut reading, exact) = self.plant.sense();
        self.sensors.distort(&mut reading);
        // A reading that repeats the one before shows its time, too; here the robot around this stamps its states itself.
        let mut time = self.time;
        self.faults.spoil(&mut reading, &mut time);
        self.exact = exact;
        Sensed { q: reading.q, dq: reading.dq, tau: reading.tau }
    }
}
