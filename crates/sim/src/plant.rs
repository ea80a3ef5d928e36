//! The arm itself: rigid bodies, effects and the inner controller, integrated together by Runge-Kutta 4.
//!
//! The controller is a joint impedance around the smoothed commands, evaluated continuously:
//!
//!   tau = K (q_d - q) + D (dq_d - dq) + M(q_d) ddq_d + C(q_d, dq_d) dq_d + g(q_d),
//!
//! with the arm's own nominal rigid model; or it holds commanded torques. `tau` is the measured torque, which the identified model explains:
//! rigid body, friction and effects.

use super::aba::{aba, inverse};
use super::commands::{Commands, TICK_S};
use super::effect::{At, Effect, Friction, Reading};
use super::spatial::{Force, Mechanism};
use super::truth::Truth;
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS, Setpoint};
use plumbline_model::{Chain, Placement};
use std::ops::Range;

/// An effect and the range of its states in the plant's state.
struct Placed {
    effect: Box<dyn Effect>,
    states: Range<usize>,
}

impl Placed {
    /// Range of its states among those of all effects.
    fn own(&self, joints: usize) -> Range<usize> {
        self.states.start - 2 * joints..self.states.end - 2 * joints
    }
}

/// Exact motion and torque of the arm at an instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Exact {
    /// Joint position \[rad\].
    pub q: JointVec,
    /// Joint velocity \[rad/s\].
    pub dq: JointVec,
    /// Joint acceleration \[rad/s2\].
    pub ddq: JointVec,
    /// Torque of the actuators \[Nm\].
    pub tau: JointVec,
}

pub(super) struct Plant {
    nominal: Mechanism,
    actual: Mechanism,
    /// Declared gravity, which effects may change \[m/s2\].
    gravity: Vector3<f64>,
    stiffness: JointVec,
    damping: JointVec,
    effects: Vec<Placed>,
    substeps: u32,
    ticks: u64,
    /// `[q, dq, states of the effects]`.
    y: Vec<f64>,
    stage: Vec<f64>,
    slopes: [Vec<f64>; 4],
    /// The target at the end of the last millisecond, where the next begins.
    end: Target,
    /// Torques that the actuators hold instead of the controller's \[Nm\].
    held: Option<JointVec>,
}

/// The controller's target at an instant, and the feed-forward torque for it.
#[derive(Clone, Copy, Debug, Default)]
struct Target {
    desired: Setpoint,
    load: JointVec,
}

impl Plant {
    /// At rest at `q`; `effects` act in their order, after friction.
    pub fn new(
        chain: &Chain,
        truth: &Truth,
        gravity: Vector3<f64>,
        q: &JointVec,
        effects: Vec<Box<dyn Effect>>,
    ) -> Plant {
        let n = chain.len();
        let nominal = Mechanism::new(chain, &truth.inertias());
        let friction = Friction::new(truth, |joint| effects.iter().any(|effect| effect.replaces_coulomb(joint)));
        let mut placed: Vec<Placed> = Vec::new();
        let mut end = 2 * n;
        for effect in std::iter::once::<Box<dyn Effect>>(Box::new(friction)).chain(effects) {
            let states = end..end + effect.states();
            end = states.end;
            placed.push(Placed { effect, states });
        }
        let mut y = vec![0.0; end];
        y[..n].copy_from_slice(&q[..n]);
        let per_joint = |value: fn(&super::truth::JointTruth) -> f64| {
            let mut vector = [0.0; MAX_JOINTS];
            vector.iter_mut().zip(&truth.joints).for_each(|(slot, joint)| *slot = value(joint));
            vector
        };
        let mut plant = Plant {
            actual: nominal.clone(),
            nominal,
            gravity,
            stiffness: per_joint(|joint| joint.stiffness),
            damping: per_joint(|joint| joint.damping),
            effects: placed,
            substeps: truth.substeps,
            ticks: 0,
            stage: y.clone(),
            slopes: std::array::from_fn(|_| y.clone()),
            y,
            end: Target::default(),
            held: None,
        };
        plant.end = plant.target(Setpoint { q: *q, ..Setpoint::default() });
        plant
    }

    /// Sets the velocity `dq` before the first millisecond; `commands` move with it.
    pub fn start_moving(&mut self, dq: &JointVec, commands: &Commands) {
        let n = self.actual.n;
        self.y[n..2 * n].copy_from_slice(&dq[..n]);
        self.end = self.target(commands.at(1.0));
    }

    /// The controller tracks `commands` from now on.
    pub fn take_over(&mut self, commands: &Commands) {
        self.held = None;
        self.end = self.target(commands.at(1.0));
    }

    /// The actuators hold `tau` \[Nm\] until [`Plant::take_over`].
    pub fn hold(&mut self, tau: &JointVec) {
        self.held = Some(*tau);
    }

    /// One millisecond along `commands`. Allocates nothing.
    pub fn advance(&mut self, commands: &Commands) {
        self.update_bodies(self.time());
        let h = TICK_S / f64::from(self.substeps);
        // Feed-forward at three instants, and the parabola between them. The controller is defined by this: its torque moves the arm.
        let loads = [self.end.load, self.target(commands.at(0.5)).load, self.target(commands.at(1.0)).load];
        let mut from = self.end;
        for k in 0..self.substeps {
            let t = self.time() + f64::from(k) * h;
            let target = |part: f64| {
                let s = (f64::from(k) + part) / f64::from(self.substeps);
                let weights = [(1.0 - s) * (1.0 - 2.0 * s), 4.0 * s * (1.0 - s), s * (2.0 * s - 1.0)];
                let load = std::array::from_fn(|j| (0..3).map(|i| weights[i] * loads[i][j]).sum());
                Target { desired: commands.at(s), load }
            };
            let (middle, to) = (target(0.5), target(1.0));
            let start = self.at(t, &self.y, &from);
            self.effects.iter_mut().for_each(|placed| placed.effect.begin_step(&start));
            self.slope(0, None, t, &from);
            self.slope(1, Some((0, 0.5 * h)), t + 0.5 * h, &middle);
            self.slope(2, Some((1, 0.5 * h)), t + 0.5 * h, &middle);
            self.slope(3, Some((2, h)), t + h, &to);
            let [k1, k2, k3, k4] = &self.slopes;
            for (i, value) in self.y.iter_mut().enumerate() {
                *value += h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
            }
            from = to;
        }
        self.end = from;
        self.ticks += 1;
    }

    /// Readings without noise, and the exact values. Call once per millisecond: effects may have a memory.
    pub fn sense(&mut self) -> (Reading, Exact) {
        let t = self.time();
        self.stage.copy_from_slice(&self.y);
        let at = self.at(t, &self.y, &self.end);
        let mut dx = [0.0; MAX_STATES];
        let (q, dq) = self.encoders(&at, &mut dx);
        let tau = self.controller(&q, &dq, &at);
        let ddq = self.acceleration(&at, &tau, &mut dx);
        let mut reading = Reading { q, dq, tau };
        for placed in &mut self.effects {
            placed.effect.sense(&at, &mut reading);
        }
        (reading, Exact { q: at.q, dq: at.dq, ddq, tau })
    }

    /// Time since the start \[s\].
    fn time(&self) -> f64 {
        self.ticks as f64 * TICK_S
    }

    /// Adds the effects' bodies and rotor inertias.
    fn update_bodies(&mut self, t: f64) {
        self.actual.links = self.nominal.links;
        self.actual.armature = self.nominal.armature;
        for placed in &self.effects {
            if let Some((link, inertia)) = placed.effect.inertia(t) {
                self.actual.links[link] += inertia;
            }
            for (j, armature) in self.actual.armature.iter_mut().enumerate() {
                *armature += placed.effect.armature(t, j);
            }
        }
    }

    fn target(&self, desired: Setpoint) -> Target {
        let load = inverse(&self.nominal, &self.gravity, &desired.q, &desired.dq, &desired.ddq);
        Target { desired, load }
    }

    /// Writes slope `which` at the state, moved by `(slope, step)`.
    fn slope(&mut self, which: usize, from: Option<(usize, f64)>, t: f64, target: &Target) {
        self.stage.copy_from_slice(&self.y);
        if let Some((slope, step)) = from {
            for (value, slope) in self.stage.iter_mut().zip(&self.slopes[slope]) {
                *value += step * slope;
            }
        }
        let n = self.actual.n;
        let at = self.at(t, &self.stage, target);
        let mut dx = [0.0; MAX_STATES];
        let (q, dq) = self.encoders(&at, &mut dx);
        let tau = self.controller(&q, &dq, &at);
        let ddq = self.acceleration(&at, &tau, &mut dx);
        let slope = &mut self.slopes[which];
        slope[..n].copy_from_slice(&at.dq[..n]);
        slope[n..2 * n].copy_from_slice(&ddq[..n]);
        let own = slope.len() - 2 * n;
        slope[2 * n..].copy_from_slice(&dx[..own]);
    }

    /// Encoder readings of the state in `stage`; may write derivatives of the effects' states.
    fn encoders(&self, at: &At, dx: &mut [f64; MAX_STATES]) -> (JointVec, JointVec) {
        let (mut q, mut dq) = (at.q, at.dq);
        for placed in &self.effects {
            let x = &self.stage[placed.states.clone()];
            placed.effect.encoder(at, x, &mut dx[placed.own(at.n)], &mut q, &mut dq);
        }
        (q, dq)
    }

    fn controller(&self, q: &JointVec, dq: &JointVec, at: &At) -> JointVec {
        if let Some(held) = self.held {
            return held;
        }
        let mut tau = at.load;
        for j in 0..at.n {
            tau[j] += self.stiffness[j] * (at.desired.q[j] - q[j]) + self.damping[j] * (at.desired.dq[j] - dq[j]);
        }
        tau
    }

    /// Joint accelerations of the state in `stage` under actuator torque `tau`; writes the derivatives of the effects' states.
    fn acceleration(&self, at: &At, tau: &JointVec, dx: &mut [f64; MAX_STATES]) -> JointVec {
        let n = self.actual.n;
        let mut gravity = self.gravity;
        let mut link_torque = *tau;
        let mut external = [Force::ZERO; MAX_JOINTS];
        for placed in &self.effects {
            let x = &self.stage[placed.states.clone()];
            placed.effect.gravity(at.t, &mut gravity);
            placed.effect.torque(at, x, &mut dx[placed.own(n)], &mut link_torque);
            if let Some(wrench) = placed.effect.wrench(at) {
                let to_base = self.orientation(&at.q, wrench.link);
                let f = to_base.rotation.tr_mul(&wrench.force);
                let n = to_base.rotation.tr_mul(&wrench.moment) + wrench.point.cross(&f);
                external[wrench.link] += Force { n, f };
            }
        }
        aba(&self.actual, &gravity, &external, &at.q, &at.dq, &link_torque)
    }

    /// Inputs of the effects at time `t` in state `y`.
    fn at(&self, t: f64, y: &[f64], target: &Target) -> At {
        let n = self.actual.n;
        let mut at = At { t, n, desired: target.desired, load: target.load, held: self.held, ..At::default() };
        at.q[..n].copy_from_slice(&y[..n]);
        at.dq[..n].copy_from_slice(&y[n..2 * n]);
        at
    }

    fn orientation(&self, q: &JointVec, link: usize) -> Placement {
        (0..=link).fold(Placement::identity(), |base, i| base.then(&self.actual.frames[i].at(q[i])))
    }
}

/// Room for the continuous states of all effects together.
pub(super) const MAX_STATES: usize = 64;
