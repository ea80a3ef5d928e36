//! A link that swings on a gear that gives way.

use super::all_rows::{AllRows, Clock, Law, Past};
use super::carried::CarriedFriction;
use super::effect::{Family, Ground, Site, joint};
use super::position_error::PositionError;
use super::{Column, Sample, Term};
use crate::joint::JointVec;
use std::sync::Arc;

/// Name of the forms of an effect of a gear for a link that swings on it, by its own inertia.
pub(super) const SWINGING: &str = "swinging";

/// Longest step of the integration \[s\]: a link of 1 kg m2 on a gap of 0.75 mrad per 0.05 Nm swings at 1.3 Hz, one of 0.05 kg m2 per 5 Nm
/// at 60 Hz.
const STEP: f64 = 1.1e-3;
/// Steps between two samples at most.
const STEPS: u8 = 20;
/// Tries to solve one step.
const TRIES: u8 = 20;
/// Damping ratio of the link on its gear: an assumption (docs/effects.md).
const DAMPING: f64 = 0.2;
/// A step is solved to so much of a torque \[Nm\].
const EXACT: f64 = 1e-9;

/// How a gear gives way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Gear {
    /// `theta = gap tanh(tau / width)`: half of the play \[rad\], torque at which 76 % of it are used up \[Nm\].
    Gap(f64, f64),
    /// `theta = c tau`: compliance \[rad/Nm\].
    Spring(f64),
}

impl Gear {
    /// Twist under a torque, and how fast it grows with it.
    fn under(self, tau: f64) -> (f64, f64) {
        match self {
            Gear::Gap(gap, width) => {
                let flank = (tau / width).tanh();
                (gap * flank, gap / width * (1.0 - flank * flank))
            }
            Gear::Spring(compliance) => (compliance * tau, compliance),
        }
    }

    /// What the twist is proportional to.
    fn size(self) -> f64 {
        match self {
            Gear::Gap(size, _) | Gear::Spring(size) => size,
        }
    }
}

/// The twist as a state that is integrated in time. The encoder sits on the motor's side and shows `q_i`; the link is at `q_i - theta`:
///
///   theta = twist(tau - d dtheta),
///   tau = tau_rb_i(q - theta) + f_i(dq_i - dtheta)
///       = tau_rb_i(q) - K_i theta - V_i dtheta - M_ii ddtheta + f_i(dq_i - dtheta),
///
/// with the friction `f_i` behind the gear and a damping `d` in it. Without that the law would divide by nothing at the link's resonance on a motor
/// that stands still: there the measured motion is next to nothing, and its noise would be all that is left. The one column is what the twist
/// changes in all rows, per gap or compliance.
///
/// Backward differences of second order make each step one scalar equation in `tau`, whose left side rises with a slope of at least one.
/// `K_i theta + V_i dtheta` are those of the sample before: next to `M_ii ddtheta` they are small, and slow.
pub(super) struct Swing {
    error: PositionError,
    friction: CarriedFriction,
    gear: Gear,
    past: Past,
    /// Torque that twists the gear \[Nm\].
    tau: f64,
    /// `K_i theta + V_i dtheta` \[Nm\].
    slow: f64,
    /// Rigid-body torque and velocity at the sample before.
    before: Option<[f64; 2]>,
}

impl Swing {
    /// The term of an effect with one column, at rest and without load to begin with.
    pub fn term(
        family: &'static Family,
        ground: &Ground,
        site: Site,
        settings: &[f64],
        columns: Vec<Column>,
        gear: Gear,
    ) -> Arc<dyn Term> {
        let (joint, friction, load) = (joint(site), CarriedFriction::of(ground), Arc::clone(&ground.load));
        AllRows::term(family, SWINGING, site, settings, columns, move |gravity| {
            let error = PositionError { joint, load: load.under(gravity) };
            Swing { error, friction, gear, past: Past::default(), tau: 0.0, slow: 0.0, before: None }
        })
    }

    /// One step: `[theta, dtheta, ddtheta]` where the rigid body asks for `load` \[Nm\] at the velocity `dq`.
    fn step(&mut self, load: f64, dq: f64, inertia: f64, dt: f64) -> [f64; 3] {
        let damping = 2.0 * DAMPING * (inertia / self.gear.under(0.0).1).sqrt();
        let at = |tau: f64| {
            let (theta, bend) = self.gear.under(tau);
            let [dtheta, ddtheta] = self.past.with(theta, dt);
            let carried = self.friction.at(dq - dtheta, self.error.joint) - damping * dtheta;
            (tau + self.slow + inertia * ddtheta - load - carried, bend, [theta, dtheta, ddtheta])
        };
        let [first, second] = self.past.slopes(dt);
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        let mut now = at(self.tau);
        let mut tau = self.tau;
        for _ in 0..TRIES {
            let (wrong, bend, [_, dtheta, _]) = now;
            if wrong.abs() < EXACT {
                break;
            }
            // The left side rises at least as fast as tau: the solution is no farther away than what is wrong.
            if wrong > 0.0 {
                (low, high) = (low.max(tau - wrong), tau)
            } else {
                (low, high) = (tau, high.min(tau - wrong))
            }
            let carried = self.friction.slope(dq - dtheta, self.error.joint) + damping;
            let newton = tau - wrong / (1.0 + bend * (inertia * second + carried * first));
            tau = if low < newton && newton < high { newton } else { 0.5 * (low + high) };
            now = at(tau);
        }
        let (.., theta) = now;
        self.tau = tau;
        self.past.derivatives(theta[0], dt);
        theta
    }
}

impl Law for Swing {
    /// A link's swinging dies away in this time at the latest, or is kept up by every period alike.
    const MEMORY: usize = 2000;

    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let (joint, size) = (self.error.joint, self.gear.size());
        let (Some(&dq), Some(column)) = (sample.dq.get(joint), columns.first_mut()) else { return };
        let load = self.error.own(sample);
        let inertia = self.error.inertia(sample, load);
        let [load_before, dq_before] = self.before.replace([load, dq]).unwrap_or([load, dq]);
        let steps = ((clock.dt / STEP).ceil() as u8).clamp(1, STEPS);
        let mut theta = [0.0; 3];
        for step in 1..=steps {
            let share = f64::from(step) / f64::from(steps);
            let between = |before: f64, now: f64| before + share * (now - before);
            // An inertia that was identified below nothing would let the torque run away.
            theta = self.step(
                between(load_before, load),
                between(dq_before, dq),
                inertia.max(0.0),
                clock.dt / f64::from(steps),
            );
        }
        *column = self.error.signature(sample, theta.map(|value| -value / size));
        let Some(own) = column.get_mut(joint) else { return };
        self.slow = -size * *own - inertia * theta[2];
        let friction = |dq: f64| self.friction.at(dq, joint);
        *own += (friction(dq - theta[1]) - friction(dq)) / size;
    }
}
