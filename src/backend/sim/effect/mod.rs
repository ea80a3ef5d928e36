//! Effects: what a simulated arm has beyond a rigid body. The estimator doesn't know them.
//!
//! An `Effect` bends the arm wherever its physics acts, through hooks that do nothing by default; one kind of effect is one file here
//! and one arm of [`EffectSpec`]. Where each row of the catalogue acts:
//!
//! | hook | effects |
//! |---|---|
//! | `torque` (with `states`) | every friction, presliding, spring, load-dependent, drift, coupling, cogging, flexible joints |
//! | `replaces_coulomb` | friction that takes the place of `fc tanh(100 dq)` |
//! | `inertia`, `armature` | payload, rotor inertia |
//! | `gravity` | wrong mounting, moving base |
//! | `wrench` | contact |
//! | `encoder` | encoder zero and eccentricity, quasi-static elasticity, backlash: what the arm's controller sees too |
//! | `sense` | torque offset, gain, cross-talk, ripple, offset drift, channel delay, outliers |

mod friction;
pub mod payload;
pub mod presliding;
#[cfg(test)]
mod tests;
pub mod torque_offset;

pub(super) use friction::Friction;

use super::spatial::Inertia;
use super::truth::Truth;
use crate::input::BadInput;
use crate::joint::{JointVec, Setpoint};
use nalgebra::Vector3;
use serde::Deserialize;

/// The arm at one instant, as effects see it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct At {
    /// Time since the arm was switched on \[s\].
    pub t: f64,
    /// Number of joints.
    pub n: usize,
    /// True joint position \[rad\].
    pub q: JointVec,
    /// True joint velocity \[rad/s\].
    pub dq: JointVec,
    /// What the inner controller tracks.
    pub desired: Setpoint,
    /// Rigid-body torque along `desired` \[Nm\]: the load that gears and bearings carry.
    pub load: JointVec,
}

/// What the sensors say, before noise.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Reading {
    /// Position \[rad\].
    pub q: JointVec,
    /// Velocity \[rad/s\].
    pub dq: JointVec,
    /// Torque of the actuators \[Nm\].
    pub tau: JointVec,
}

/// A force \[N\] at `point` \[m\] of a link and a moment \[Nm\] on it. The point is in the link frame, force and moment in the base frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct External {
    pub link: usize,
    pub point: Vector3<f64>,
    pub force: Vector3<f64>,
    pub moment: Vector3<f64>,
}

/// One deviation from the ideal arm. Hooks allocate nothing; joints and links count from 0.
pub(super) trait Effect: Send {
    /// Number of the effect's own continuous states; `torque` gives their derivatives.
    fn states(&self) -> usize {
        0
    }

    /// Whether the effect stands for `joint`'s Coulomb friction.
    fn replaces_coulomb(&self, _joint: usize) -> bool {
        false
    }

    /// Inertia that moves with a link at time `t` besides the link itself.
    fn inertia(&self, _t: f64) -> Option<(usize, Inertia)> {
        None
    }

    /// Inertia that turns with `joint` alone, seen at the joint \[kg m2\].
    fn armature(&self, _joint: usize) -> f64 {
        0.0
    }

    /// Bends the gravitational acceleration in the base frame \[m/s2\]; a base that accelerates by `a` adds `-a`.
    fn gravity(&self, _t: f64, _gravity: &mut Vector3<f64>) {}

    /// Turns the torque that comes from the actuators' side into what the links get, and writes the derivatives of the states.
    fn torque(&self, _at: &At, _x: &[f64], _dx: &mut [f64], _tau: &mut JointVec) {}

    /// A wrench from outside.
    fn wrench(&self, _at: &At) -> Option<External> {
        None
    }

    /// Turns true joint position and velocity into what the encoders see.
    fn encoder(&self, _at: &At, _x: &[f64], _q: &mut JointVec, _dq: &mut JointVec) {}

    /// Bends what is reported each millisecond.
    fn sense(&mut self, _at: &At, _x: &[f64], _reading: &mut Reading) {}
}

/// An effect as it is written in a truth file.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "id", rename_all = "kebab-case")]
pub enum EffectSpec {
    /// A torque sensor's zero is off.
    TorqueOffset(torque_offset::Config),
    /// Friction that bends like a bristle before it slides.
    Presliding(presliding::Config),
    /// A body that nobody declared.
    Payload(payload::Config),
}

impl EffectSpec {
    pub(super) fn check(&self, file: &str, place: &str, truth: &Truth) -> Result<(), BadInput> {
        match self {
            EffectSpec::TorqueOffset(config) => config.check(file, place, truth),
            EffectSpec::Presliding(config) => config.check(file, place, truth),
            EffectSpec::Payload(config) => config.check(file, place, truth),
        }
    }

    pub(super) fn build(&self, truth: &Truth) -> Box<dyn Effect> {
        match self {
            EffectSpec::TorqueOffset(config) => Box::new(config.build()),
            EffectSpec::Presliding(config) => Box::new(config.build(truth)),
            EffectSpec::Payload(config) => Box::new(config.build(truth)),
        }
    }

    pub(super) fn replaces_coulomb(&self, joint: usize) -> bool {
        matches!(self, EffectSpec::Presliding(config) if config.joint == joint + 1)
    }
}

/// A joint of the arm, counted from 1.
fn check_joint(file: &str, place: &str, joint: usize, truth: &Truth) -> Result<(), BadInput> {
    if (1..=truth.joints()).contains(&joint) {
        return Ok(());
    }
    Err(BadInput::new(file, format!("{place}, joint"), joint, format!("1 to {}", truth.joints())))
}

/// A number that lies in `[low, high]`.
fn check_range(file: &str, place: &str, key: &str, value: f64, low: f64, high: f64) -> Result<(), BadInput> {
    if (low..=high).contains(&value) {
        return Ok(());
    }
    Err(BadInput::new(file, format!("{place}, {key}"), value, format!("{low} to {high}")))
}
