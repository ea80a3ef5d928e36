//! The arm behind the interface: the simulated hardware, and the estimates of the robot's own firmware.

use super::geometry::{self, IDENTITY, Pose};
use super::limits::{JOINTS, Joints, Step, TICK};
use nalgebra::{Matrix3, Vector3};
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_franka::wire::{Load, RobotState};
use plumbline_model::{Chain, LinkParameters, Mounting, Placement, rnea};
use plumbline_sim::{Hardware, Reading, SimError, Truth};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::TAU;

/// Corner frequency of the estimate of external torques \[Hz\].
const EXTERNAL_CORNER: f64 = 10.0;
/// Standard deviation of an accelerometer \[m/s2\].
const ACCELEROMETER_NOISE: f64 = 0.02;
/// Joint that is pushed against, how hard \[Nm\] and for how long \[ms\]: more than any threshold of libfranka's examples, less than the joint's range.
const PUSH: (usize, f64, u32) = (3, 40.0, 100);
/// Inertia of each rotor at its joint's side of the gear \[kg m2\], as MuJoCo's model of the arm has it. Without rotors the wrist would weigh so
/// little that the damping of libfranka's joint impedance example oscillates between two cycles.
const ROTOR_INERTIA: f64 = 0.1;
/// What a client gets that has set no load.
const NO_LOAD: Load = Load { mass: 0.0, com: [0.0; 3], inertia: [0.0; 9] };

#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Drive {
    /// The inner controller follows the desired position.
    Track,
    /// The client's torques, on top of the robot's own gravity compensation \[Nm\].
    Torque(Joints),
}

/// Frames and load as the client has set them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tool {
    pub ne_t_ee: Pose,
    /// Stiffness frame in the end effector.
    pub ee_t_k: Pose,
    pub load: Load,
}

pub struct Body {
    chain: Chain,
    links: Vec<LinkParameters>,
    friction: [(f64, f64); JOINTS],
    gravity: Vector3<f64>,
    /// What the firmware adds torque against.
    compensated: Vector3<f64>,
    hardware: Hardware,
    noise: ChaCha8Rng,
    pub tool: Tool,
    sensed: Reading,
    before: Reading,
    tau_d: Joints,
    external: Joints,
    pushed: u32,
    twist: [f64; 6],
    twist_before: [f64; 6],
}

impl Body {
    /// An arm at rest at `start`, whose firmware compensates gravity `compensates` \[m/s2\].
    pub fn new(
        chain: Chain,
        truth: &Truth,
        mounting: Mounting,
        compensates: [f64; 3],
        start: &Joints,
        seed: u64,
    ) -> Result<Body, SimError> {
        let moving = truth.clone().with_rotors(ROTOR_INERTIA);
        let mut hardware = Hardware::new(&chain, &moving, mounting, &wide(start), seed)?;
        let sensed = hardware.track(&wide(start));
        let mut friction = [(0.0, 0.0); JOINTS];
        friction.iter_mut().zip(&truth.joints).for_each(|(own, joint)| *own = (joint.fv, joint.fc));
        Ok(Body {
            links: truth.link_parameters(),
            friction,
            gravity: mounting.gravity(),
            compensated: Vector3::from(compensates),
            chain,
            hardware,
            noise: ChaCha8Rng::seed_from_u64(seed ^ 0xacce1),
            tool: Tool { ne_t_ee: IDENTITY, ee_t_k: IDENTITY, load: NO_LOAD },
            sensed,
            before: sensed,
            tau_d: [0.0; JOINTS],
            external: [0.0; JOINTS],
            pushed: 0,
            twist: [0.0; 6],
            twist_before: [0.0; 6],
        })
    }

    pub fn advance(&mut self, desired: &Step, drive: Drive) {
        self.before = self.sensed;
        self.sensed = match drive {
            Drive::Track => self.hardware.track(&wide(&desired.q)),
            Drive::Torque(tau) => {
                let gravity = self.compensation(&self.q());
                self.hardware.hold(&wide(&std::array::from_fn(|j| tau[j] + gravity[j])))
            }
        };
        // The torque sensors are on the links' side of the rotors.
        let ddq = self.hardware.exact().ddq;
        (0..JOINTS).for_each(|j| self.sensed.tau[j] -= ROTOR_INERTIA * ddq[j]);
        if self.pushed > 0 {
            self.pushed -= 1;
            self.sensed.tau[PUSH.0] += PUSH.1;
        }
        self.tau_d = match drive {
            Drive::Torque(tau) => tau,
            Drive::Track => {
                let exact = *self.hardware.exact();
                let gravity = self.compensation(&narrow(&exact.q));
                std::array::from_fn(|j| exact.tau[j] - gravity[j])
            }
        };
        self.estimate_external();
        let frames = geometry::frames(&self.chain, &desired.q);
        let at = self.end_effector(&frames[JOINTS]).origin;
        self.twist_before = self.twist;
        self.twist = (geometry::jacobian(&frames, &at) * nalgebra::SMatrix::<f64, JOINTS, 1>::from(desired.dq)).into();
    }

    /// Somebody pushes against the arm from the next millisecond on. The sensors feel it; the arm itself is held too well to be moved.
    pub fn push(&mut self) {
        self.pushed = PUSH.2;
    }

    /// Ends torques: the inner controller continues from here, without a jump.
    pub fn take_over(&mut self) -> Step {
        let (q, dq) = self.hardware.take_over();
        Step { q: narrow(&q), dq: narrow(&dq), ..Step::default() }
    }

    /// Measured position \[rad\].
    pub fn q(&self) -> Joints {
        narrow(&self.sensed.q)
    }

    /// Measured velocity \[rad/s\].
    pub fn dq(&self) -> Joints {
        narrow(&self.sensed.dq)
    }

    /// Measured torque \[Nm\].
    pub fn tau(&self) -> Joints {
        narrow(&self.sensed.tau)
    }

    /// Desired torque without gravity \[Nm\].
    pub fn tau_d(&self) -> Joints {
        self.tau_d
    }

    /// Estimated external torque \[Nm\].
    pub fn external(&self) -> Joints {
        self.external
    }

    /// The wrench that the external torque amounts to, on the stiffness frame in the base's axes \[N, Nm\].
    pub fn external_wrench(&self) -> [f64; 6] {
        let frames = geometry::frames(&self.chain, &self.q());
        let at = self.stiffness_frame(&frames[JOINTS]).origin;
        geometry::wrench(&geometry::jacobian(&frames, &at), &self.external)
    }

    /// Everything of a state that is about the body.
    pub fn report(&mut self, desired: &Step, state: &mut RobotState) {
        let (q, dq, tau) = (self.q(), self.dq(), self.tau());
        let (measured, wanted) = (geometry::frames(&self.chain, &q), geometry::frames(&self.chain, &desired.q));
        state.q = q;
        state.dq = dq;
        state.tau_j = tau;
        state.dtau_j = std::array::from_fn(|j| (tau[j] - self.before.tau[j]) / TICK);
        state.tau_j_d = self.tau_d;
        (state.q_d, state.dq_d, state.ddq_d) = (desired.q, desired.dq, desired.ddq);
        // The simulated transmissions are rigid to the interface: the motor's side is the link's.
        (state.theta, state.dtheta) = (q, dq);
        state.o_t_ee = geometry::pose(&self.end_effector(&measured[JOINTS]));
        state.o_t_ee_d = geometry::pose(&self.end_effector(&wanted[JOINTS]));
        state.o_t_ee_c = state.o_t_ee_d;
        state.f_t_ne = IDENTITY;
        state.ne_t_ee = self.tool.ne_t_ee;
        state.f_t_ee = self.tool.ne_t_ee;
        state.ee_t_k = self.tool.ee_t_k;
        (state.m_load, state.f_x_cload, state.i_load) =
            (self.tool.load.mass, self.tool.load.com, self.tool.load.inertia);
        let elbow = |q: &Joints| [q[2], if q[3] < 0.0 { -1.0 } else { 1.0 }];
        (state.elbow, state.elbow_d, state.elbow_c) = (elbow(&q), elbow(&desired.q), elbow(&desired.q));
        (state.delbow_c, state.ddelbow_c) = ([desired.dq[2], 0.0], [desired.ddq[2], 0.0]);
        (state.o_dp_ee_d, state.o_dp_ee_c) = (self.twist, self.twist);
        state.o_ddp_ee_c = std::array::from_fn(|k| (self.twist[k] - self.twist_before[k]) / TICK);
        state.tau_ext_hat_filtered = self.external;
        state.o_f_ext_hat_k = self.external_wrench();
        state.k_f_ext_hat_k = geometry::turned(&self.stiffness_frame(&measured[JOINTS]), &state.o_f_ext_hat_k);
        let exact = *self.hardware.exact();
        let felt = geometry::specific_force(
            &self.chain,
            &self.gravity,
            &narrow(&exact.q),
            &narrow(&exact.dq),
            &narrow(&exact.ddq),
        );
        let mut noisy = || felt.map(|link| link.map(|value| value + self.noise_of_accelerometer()));
        (state.accelerometer_top, state.accelerometer_bottom) = (noisy(), noisy());
    }

    fn noise_of_accelerometer(&mut self) -> f64 {
        ACCELEROMETER_NOISE * self.noise.sample::<f64, _>(StandardNormal)
    }

    fn end_effector(&self, last: &Placement) -> Placement {
        last.then(self.chain.flange()).then(&geometry::placement(&self.tool.ne_t_ee))
    }

    fn stiffness_frame(&self, last: &Placement) -> Placement {
        self.end_effector(last).then(&geometry::placement(&self.tool.ee_t_k))
    }

    /// Torque that the firmware adds to the client's at `q` \[Nm\].
    fn compensation(&self, q: &Joints) -> Joints {
        self.load(&self.compensated, q, &[0.0; JOINTS], &[0.0; JOINTS])
    }

    /// Torque of the firmware's rigid bodies, the client's load among them, under `gravity` \[Nm\].
    fn load(&self, gravity: &Vector3<f64>, q: &Joints, dq: &Joints, ddq: &Joints) -> Joints {
        let mut links = [[0.0; 10]; JOINTS];
        links.copy_from_slice(&self.links[..JOINTS]);
        for (own, more) in links[JOINTS - 1].iter_mut().zip(body_at(self.chain.flange(), &self.tool.load)) {
            *own += more;
        }
        let mut tau = [0.0; JOINTS];
        rnea(&self.chain, &links, gravity, q, dq, ddq, &mut tau);
        tau
    }

    /// What the torque sensors show beyond bodies and friction, behind a low-pass.
    fn estimate_external(&mut self) {
        let (q, dq, tau) = (self.q(), self.dq(), self.tau());
        let ddq = std::array::from_fn(|j| (dq[j] - self.before.dq[j]) / TICK);
        // A robot's estimate on an undeclared wall is not published: here, only the contact.
        let load = self.load(&self.gravity, &q, &dq, &ddq);
        let gain = TICK * TAU * EXTERNAL_CORNER / (1.0 + TICK * TAU * EXTERNAL_CORNER);
        for j in 0..JOINTS {
            let (fv, fc) = self.friction[j];
            let found = tau[j] - load[j] - fv * dq[j] - fc * (100.0 * dq[j]).tanh();
            self.external[j] += gain * (found - self.external[j]);
        }
    }
}

/// Standard parameters of a load at the flange, in the frame that carries the flange.
fn body_at(flange: &Placement, load: &Load) -> LinkParameters {
    let com = flange.rotation * Vector3::from(load.com) + flange.origin;
    let about = flange.rotation * Matrix3::from_column_slice(&load.inertia) * flange.rotation.transpose();
    let steiner = load.mass * (com.norm_squared() * Matrix3::identity() - com * com.transpose());
    // A client that sets nothing has set nothing, wherever that is.
    let l = about + steiner;
    let first = load.mass * com;
    [l[(0, 0)], l[(0, 1)], l[(0, 2)], l[(1, 1)], l[(1, 2)], l[(2, 2)], first.x, first.y, first.z, load.mass]
}

fn wide(joints: &Joints) -> JointVec {
    let mut vector = [0.0; MAX_JOINTS];
    vector[..JOINTS].copy_from_slice(joints);
    vector
}

fn narrow(vector: &JointVec) -> Joints {
    std::array::from_fn(|j| vector[j])
}
