//! Effects: what a simulated arm has beyond a rigid body. The estimator has no access to them.
//!
//! An `Effect` changes the arm through hooks that do nothing by default. One kind of effect is one file here and one line of the
//! catalogue in `spec`.
//!
//! | hook | effects |
//! |---|---|
//! | `torque` (with states) | every friction, spring, transmission coupling, ripple as a real torque, foreign |
//! | `replaces_coulomb`, `begin_step` | presliding, which replaces `fc tanh(100 dq)` |
//! | `inertia`, `armature` | payload, rotor inertia |
//! | `gravity` | wrong mounting, moving base |
//! | `wrench` | contact |
//! | `encoder` | encoder zero and eccentricity, elasticity, backlash: inputs of the arm's controller, too |
//! | `sense` | torque offset and its drift, gain, cross-talk, ripple of the sensor, delay |
//!
//! Every effect takes `from` \[s\], the time at which it begins.

pub mod asymmetric_coulomb;
pub mod asymmetric_viscous;
pub mod backlash;
pub mod base_motion;
pub mod contact;
pub mod coulomb_slope;
pub mod delay;
pub mod encoder_eccentricity;
pub mod encoder_offset;
pub mod foreign;
mod friction;
pub mod friction_drift;
pub mod joint_elasticity;
pub mod load_dependent_friction;
#[cfg(feature = "made-up-effect")]
pub mod made_up;
pub mod mounting;
pub mod nonlinear_viscous;
pub mod offset_drift;
mod onset;
pub mod payload;
mod place;
pub mod position_dependent_friction;
pub mod position_ripple;
pub mod presliding;
pub mod rotor_inertia;
mod spec;
pub mod spring;
pub mod stribeck;
#[cfg(test)]
mod tests;
pub mod torque_crosstalk;
pub mod torque_gain;
pub mod torque_offset;
pub mod transmission_coupling;
mod trend;
mod twist;

pub(super) use friction::Friction;
use friction::sign;
pub(crate) use place::Place;
pub use spec::{EffectSpec, Kind};
pub use trend::Trend;

use super::spatial::Inertia;
use super::truth::Truth;
use nalgebra::Vector3;
use plumbline_core::{BadInput, JointVec, MAX_JOINTS, Setpoint};
use serde::Deserialize;

/// Inputs of effects at one instant.
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
    /// Target of the inner controller.
    pub desired: Setpoint,
    /// The controller's feed-forward: torque of the nominal rigid bodies along `desired` \[Nm\].
    pub load: JointVec,
    /// Torques that the actuators hold instead of the controller's \[Nm\].
    pub held: Option<JointVec>,
}

/// Readings of the arm's sensors.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Reading {
    /// Position \[rad\].
    pub q: JointVec,
    /// Velocity \[rad/s\].
    pub dq: JointVec,
    /// Torque of the actuators, gravity included \[Nm\].
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

/// An effect on the arm. Hooks allocate nothing; joints and links count from 0.
pub(super) trait Effect: Send {
    /// Number of the effect's own continuous states; `torque` or `encoder` gives their derivatives.
    fn states(&self) -> usize {
        0
    }

    /// Whether the effect replaces `joint`'s Coulomb friction.
    fn replaces_coulomb(&self, _joint: usize) -> bool {
        false
    }

    /// Whether the effect is a deflection of `joint`'s transmission under the controller's torque. It depends on all other changes of the
    /// encoder, so it acts last, at most one per joint.
    fn twists(&self, _joint: usize) -> bool {
        false
    }

    /// Whether the effect has the period of a motion that repeats after `period` \[s\].
    fn repeats(&self, _period: f64) -> bool {
        true
    }

    /// Additional inertia of a link at time `t`.
    fn inertia(&self, _t: f64) -> Option<(usize, Inertia)> {
        None
    }

    /// Rotor inertia of `joint` at time `t` \[kg m2\].
    fn armature(&self, _t: f64, _joint: usize) -> f64 {
        0.0
    }

    /// Changes the gravitational acceleration in the base frame \[m/s2\]; a base that accelerates by `a` adds `-a`.
    fn gravity(&self, _t: f64, _gravity: &mut Vector3<f64>) {}

    /// Start of an integration step at `at`, for effects with a memory.
    fn begin_step(&mut self, _at: &At) {}

    /// Converts the actuators' torque into the links' torque, and writes the derivatives of the states.
    fn torque(&self, _at: &At, _x: &[f64], _dx: &mut [f64], _tau: &mut JointVec) {}

    /// External wrench.
    fn wrench(&self, _at: &At) -> Option<External> {
        None
    }

    /// Converts true joint position and velocity into encoder readings; may write derivatives of the states.
    fn encoder(&self, _at: &At, _x: &[f64], _dx: &mut [f64], _q: &mut JointVec, _dq: &mut JointVec) {}

    /// Changes the readings of each millisecond.
    fn sense(&mut self, _at: &At, _reading: &mut Reading) {}
}

/// Configuration of an effect in a truth file.
trait Spec {
    /// # Errors
    /// A joint that does not exist, or an impossible value.
    fn check(&self, place: &Place) -> Result<(), BadInput>;

    /// Whether the effect replaces the Coulomb friction of `joint`, counted from 0.
    fn replaces_coulomb(&self, _joint: usize) -> bool {
        false
    }

    /// The effect of an arm that passed `check`; it begins at `from` \[s\].
    fn build(&self, truth: &Truth, from: f64) -> Box<dyn Effect>;
}

/// A configuration that is the effect: one without memory, which depends neither on the arm nor on the time since it began.
trait Stateless: Effect + Copy + 'static {
    /// As [`Spec::check`].
    fn check(&self, place: &Place) -> Result<(), BadInput>;
}

impl<T: Stateless> Spec for T {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        Stateless::check(self, place)
    }

    fn build(&self, _truth: &Truth, _from: f64) -> Box<dyn Effect> {
        Box::new(*self)
    }
}

// Defaults of configurations.

fn one() -> f64 {
    1.0
}

fn half() -> f64 {
    0.5
}

fn tenth() -> f64 {
    0.1
}
