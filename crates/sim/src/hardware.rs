//! The simulated arm as hardware for a robot program around it: driven for one millisecond at a time, by positions or by torques, and read
//! through its sensors. It has no modes, limits or losses.

use super::commands::{Commands, TICK_S};
use super::effect::Reading;
use super::plant::{Exact, Plant};
use super::sensors::{Faults, Sensors};
use super::truth::Truth;
use super::{SimError, check};
use plumbline_core::JointVec;
use plumbline_model::{Chain, Mounting};

/// Actuators, bodies and sensors of a simulated arm. The same truth, seed and calls give the same readings bit by bit.
pub struct Hardware {
    joints: usize,
    plant: Plant,
    commands: Commands,
    sensors: Sensors,
    faults: Faults,
    /// Whether the inner controller tracks positions; otherwise the actuators hold torques.
    tracks: bool,
    time: f64,
    exact: Exact,
}

impl Hardware {
    /// An arm with the kinematics of `chain`, held at rest at `start` \[rad\]; `seed` decides its noise.
    ///
    /// # Errors
    /// [`SimError`] when truth and chain do not fit, or a number is not finite.
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

    /// One millisecond in which the inner joint impedance controller tracks `q` \[rad\], the newest command. After torques it takes over first.
    pub fn track(&mut self, q: &JointVec) -> Reading {
        if !self.tracks {
            self.take_over();
        }
        self.commands.push(q);
        self.advance()
    }

    /// The inner controller takes over from torques without a jump, at the arm's present position and velocity. Returns the position
    /// \[rad\] and velocity \[rad/s\] that count as commanded last.
    pub fn take_over(&mut self) -> (JointVec, JointVec) {
        let Exact { q, dq, .. } = self.exact;
        if !self.tracks {
            self.commands = Commands::passing(self.joints, &q, &dq);
            self.plant.take_over(&self.commands);
            self.tracks = true;
        }
        (*self.commands.newest(), dq)
    }

    /// One millisecond in which the actuators hold `tau` \[Nm\]. Gravity is not compensated.
    pub fn hold(&mut self, tau: &JointVec) -> Reading {
        self.plant.hold(tau);
        self.tracks = false;
        self.advance()
    }

    /// The arm's exact motion at the reading taken last; no real arm has this.
    pub fn exact(&self) -> &Exact {
        &self.exact
    }

    fn advance(&mut self) -> Reading {
        self.plant.advance(&self.commands);
        self.time += TICK_S;
        let (mut reading, exact) = self.plant.sense();
        self.sensors.add_noise(&mut reading);
        // The time stamp of a repeated reading is unused: the robot program stamps its states.
        let mut time = self.time;
        self.faults.apply(&mut reading, &mut time);
        self.exact = exact;
        reading
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Gate, Pace, SimArm};
    use super::*;
    use crate::two_joints::{chain, truth};
    use plumbline_core::{Backend, Command, Setpoint};
    use plumbline_model::rnea;
    use std::sync::Arc;

    const START: JointVec = [0.3, -0.4, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];

    fn hardware(truth: &Truth) -> Hardware {
        Hardware::new(&chain(), truth, Mounting::WALL, &START, 7).expect("truth fits the chain")
    }

    fn gravity(truth: &Truth, q: &JointVec) -> JointVec {
        let (mut tau, still) = ([0.0; 8], [0.0; 8]);
        rnea(&chain(), &truth.link_parameters(), &Mounting::WALL.gravity(), q, &still, &still, &mut tau);
        tau
    }

    /// The same arm by the long way, bit for bit, noise and all.
    #[test]
    fn tracks_as_the_backend_does() {
        let truth = truth(
            "",
            "fv = 0.1, fc = 0.3, torque-noise = 0.1, position-noise = 1e-4",
            "{ id = 'delay', delay = 0.002 }",
        );
        let mut hardware = hardware(&truth);
        let pace = Pace::Fast(Arc::new(Gate::unlimited()));
        let mut arm = SimArm::new(&chain(), &truth, Mounting::WALL, START, 7, pace).expect("truth fits the chain");
        // The backend's first state precedes the first command.
        let mut sensed = hardware.track(&START);
        for tick in 0..500 {
            let state = arm.read().expect("the arm goes on");
            assert_eq!((sensed.q, sensed.dq, sensed.tau), (state.q, state.dq, state.tau), "{tick}");
            let mut q = START;
            q[1] += 0.05 * (1.0 - (0.01 * f64::from(tick)).cos());
            let desired = Setpoint { q, ..Setpoint::default() };
            arm.write(&Command { seq: state.seq, desired, ..Command::default() }).expect("a smooth motion");
            sensed = hardware.track(&q);
        }
    }

    /// Held torques are all the torque there is: the estimator's Newton-Euler gives them back from the motion that they make.
    #[test]
    fn held_torques_cause_the_motion_of_inverse_dynamics() {
        for effects in ["", "{ id = 'joint-elasticity', joint = 2, stiffness = 1e4 }"] {
            let truth = truth("", "", effects);
            let mut hardware = hardware(&truth);
            let mut tau = gravity(&truth, &START);
            tau[0] += 0.8;
            tau[1] -= 0.3;
            for _ in 0..200 {
                assert_eq!(hardware.hold(&tau).tau, tau);
                let Exact { q, dq, ddq, .. } = *hardware.exact();
                let mut needed = [0.0; 8];
                let links = truth.link_parameters();
                rnea(&chain(), &links, &Mounting::WALL.gravity(), &q, &dq, &ddq, &mut needed);
                for j in 0..2 {
                    assert!((needed[j] - tau[j]).abs() < 1e-9, "{needed:?}");
                }
            }
            assert!((hardware.exact().q[0] - START[0]).abs() > 0.01, "it moves");
        }
    }

    #[test]
    fn gravity_alone_holds_the_arm_and_an_elastic_joint_shows_its_twist() {
        let truth = truth("", "", "{ id = 'joint-elasticity', joint = 1, stiffness = 1e3 }");
        let mut hardware = hardware(&truth);
        let tau = gravity(&truth, &START);
        let mut sensed = hardware.hold(&tau);
        for _ in 0..100 {
            sensed = hardware.hold(&tau);
        }
        assert!((hardware.exact().q[0] - START[0]).abs() < 1e-9);
        assert!((sensed.q[0] - START[0] - tau[0] * 1e-3).abs() < 1e-9, "{} {}", sensed.q[0], tau[0]);
    }

    /// From torques to positions and back while the arm moves: neither position nor torque jumps.
    #[test]
    fn takes_over_without_a_jump() {
        let truth = truth("", "", "");
        let mut hardware = hardware(&truth);
        let mut pushed = gravity(&truth, &START);
        pushed[1] += 0.5;
        for _ in 0..100 {
            hardware.hold(&pushed);
        }
        let before = *hardware.exact();
        let gravity = gravity(&truth, &before.q);
        let (mut q, dq) = hardware.take_over();
        assert_eq!(hardware.take_over(), (q, dq), "only once");
        for _ in 0..20 {
            (0..2).for_each(|j| q[j] += 1e-3 * dq[j]);
            let sensed = hardware.track(&q);
            for j in 0..2 {
                // At constant velocity the arm needs its gravity and a little for its own motion; its push is gone.
                assert!((sensed.tau[j] - gravity[j]).abs() < 0.4, "{} {}", sensed.tau[j], gravity[j]);
                assert!((sensed.dq[j] - dq[j]).abs() < 0.02, "{} {}", sensed.dq[j], dq[j]);
            }
        }
    }
}
