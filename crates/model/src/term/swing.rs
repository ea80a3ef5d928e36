//! A link that oscillates on an elastic gear or in its play.

use super::all_rows::{AllRows, Clock, Law, Past};
use super::carried::CarriedFriction;
use super::family::{Family, Scale, Setting, Site, joint};
use super::load::OperatingPoint;
use super::position_error::PositionError;
use super::{Column, Expected, Motion, Sample, Term};
use crate::fast::trig::tanh_of_one;
use plumbline_core::JointVec;
use std::sync::Arc;

/// Name of the forms with the resonance of the link on the gear.
pub(super) const SWINGING: &str = "swinging";

/// The same where the joint's identified inertia is the link's and the rotor's: no torque of the rotor goes through the gear.
pub(super) const WITH_ROTOR: &str = "swinging-rotor";

/// Inertia of the rotor in the identified one.
pub(super) const ROTOR: Setting = Setting {
    name: "rotor",
    unit: "1",
    what: "inertia of the rotor over that of the joint at q = 0",
    low: 0.0,
    high: 0.9,
    steps: 1,
    scale: Scale::Linear,
};

/// Quality factor of the resonance, `1 / (2 zeta)`. A search starts well damped, where the response depends least on the compliance.
pub(super) const QUALITY: Setting = Setting {
    name: "quality",
    unit: "1",
    what: "quality factor of the link's resonance on its gear",
    low: 2.5,
    high: 50.0,
    steps: 1,
    scale: Scale::Logarithmic,
};

/// Longest step of the integration \[s\]: a link of 1 kg m2 on a gap of 0.75 mrad per 0.05 Nm swings at 1.3 Hz, one of 0.05 kg m2 on
/// 0.1 mrad/Nm at 71 Hz.
const MAX_STEP_S: f64 = 1.1e-3;
/// The same for means of a motion that does not repeat: its noise is not known, and what the data tell of the settings is coarser than that.
const MAX_STEP_OF_MEANS_S: f64 = 4e-3;
/// Most steps between two samples.
const MAX_STEPS: u8 = 20;
/// Most iterations of one step.
const MAX_ITERATIONS: u8 = 50;
/// Tolerance of the torque of one step \[Nm\].
const TOLERANCE_NM: f64 = 1e-9;
/// A last step of Newton's method that is shorter than this leaves no more than its square over the width of a gap, less than the tolerance \[Nm\].
const LAST_STEP_NM: f64 = 3e-6;
/// Largest twist \[rad\], a hundred times that of real gears: on a soft one a body that no real one is would fall without end.
const MAX_TWIST_RAD: f64 = 1.0;
/// Decay time of the oscillation per unit of quality factor \[s\].
const DECAY_S: f64 = 0.8;

/// Deflection of a gear.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Gear {
    /// `theta = gap tanh(tau / width) + compliance tau`: half of the play \[rad\], torque at 76 % of it \[Nm\], compliance of teeth and shaft
    /// \[rad/Nm\].
    Gap { gap: f64, width: f64, compliance: f64 },
    /// `theta = c tau`: compliance \[rad/Nm\].
    Spring(f64),
}

impl Gear {
    /// Twist under a torque, and its slope; no more than [`MAX_TWIST_RAD`].
    fn under(self, tau: f64) -> (f64, f64) {
        let (theta, slope) = match self {
            Gear::Gap { gap, width, compliance } => {
                let flank = tanh_of_one(tau / width);
                (gap * flank + compliance * tau, gap / width * (1.0 - flank * flank) + compliance)
            }
            Gear::Spring(compliance) => (compliance * tau, compliance),
        };
        (theta.clamp(-MAX_TWIST_RAD, MAX_TWIST_RAD), slope)
    }

    /// Factor of the twist.
    fn size(self) -> f64 {
        match self {
            Gear::Gap { gap: size, .. } | Gear::Spring(size) => size,
        }
    }
}

/// The twist as a state that is integrated in time. The encoder sits on the motor's side and shows `q_i`; the link is at `q_i - theta`:
///
///   theta = twist(s),   s = tau - d dtheta,   d = sqrt(M_ii / twist'(s)) / quality,
///   tau = tau_rb_i(q - theta) + f_i(dq_i - dtheta)
///       = tau_rb_i(q) - K_i theta - V_i dtheta - M_ii ddtheta + f_i(dq_i - dtheta),
///
/// where a rotor of inertia `ia` that the rigid body has absorbed is taken off: `tau_rb_i - ia ddq_i`, `M_ii - ia`. With
/// the friction `f_i` behind the gear and a damping `d` in it, that of teeth which touch: between the flanks of a gap there is hardly any.
/// Without damping the law has a pole at the link's resonance on a motor at rest, where the measured motion is mostly noise. The one column is the change of all rows by the twist, per gap or compliance.
///
/// Backward differences of second order make each step one scalar equation in `tau`, whose left side rises with a slope of at least one.
/// `K_i theta + V_i dtheta` are those of the sample before: next to `M_ii ddtheta` they are small, and slow.
pub(super) struct Swing {
    error: PositionError,
    friction: CarriedFriction,
    gear: Gear,
    quality: f64,
    /// Inertia of the rotor that is part of `M_ii` \[kg m2\].
    rotor: f64,
    past: Past,
    /// Torque that twists the gear \[Nm\].
    tau: f64,
    /// Its change in the last step \[Nm\], which predicts the next.
    rise: f64,
    /// `K_i theta + V_i dtheta` \[Nm\].
    slow: f64,
    /// Slope of the twist over the torque \[rad/Nm\].
    bend: f64,
    /// Friction behind the gear \[Nm\].
    rubbing: f64,
    /// Rigid-body torque and velocity at the sample before.
    before: Option<[f64; 2]>,
    /// Twist, its derivatives, and the change of friction, in the step before.
    last: [f64; 4],
    /// Whether it follows a motion that repeats.
    periodic: bool,
}

impl Swing {
    /// The term of an effect with one column; initial state at rest without load. Its last settings are those of the resonance: [`QUALITY`], and
    /// [`ROTOR`] in the form [`WITH_ROTOR`].
    pub fn term(
        family: &'static Family,
        form: &'static str,
        operating_point: &OperatingPoint,
        site: Site,
        settings: &[f64],
        columns: Vec<Column>,
        gear: Gear,
    ) -> Arc<dyn Term> {
        let (joint, friction, load) =
            (joint(site), CarriedFriction::of(operating_point), Arc::clone(&operating_point.load));
        let [quality, rotor] = match (form, settings) {
            (WITH_ROTOR, &[.., quality, rotor]) => [quality, rotor],
            (_, &[.., quality]) => [quality, 0.0],
            _ => [QUALITY.low, 0.0],
        };
        AllRows::term(family, form, site, settings, columns, move |gravity| {
            let mut error = PositionError::new(joint, &load, gravity);
            let rotor = rotor * error.inertia_at_zero();
            Swing {
                error,
                friction,
                gear,
                quality,
                rotor,
                past: Past::default(),
                tau: 0.0,
                rise: 0.0,
                slow: 0.0,
                bend: gear.under(0.0).1,
                rubbing: 0.0,
                before: None,
                last: [0.0; 4],
                periodic: false,
            }
        })
    }

    /// One step: `[theta, dtheta, ddtheta]` at the rigid-body torque `load` \[Nm\] and the velocity `dq`.
    fn step(&mut self, load: f64, dq: f64, inertia: f64, dt: f64) -> [f64; 3] {
        // At the torque of the step before: the left side below goes on to rise with a slope of at least one.
        let damping = (inertia / self.bend).sqrt() / self.quality;
        let [first, second] = self.past.slopes(dt);
        // Left side minus right side, its slope over tau, the twist with its slope, and the friction with its own.
        let at = |tau: f64| {
            let (theta, bend) = self.gear.under(tau);
            let [dtheta, ddtheta] = self.past.with(theta, dt);
            let (friction, drag) = self.friction.with_slope(dq - dtheta, self.error.joint);
            let wrong = tau + self.slow + inertia * ddtheta - load - friction + damping * dtheta;
            let slope = 1.0 + bend * (inertia * second + (drag + damping) * first);
            (wrong, slope, [theta, bend], [friction, drag])
        };
        let (mut low, mut high) = (f64::NEG_INFINITY, f64::INFINITY);
        let mut tau = self.tau + self.rise;
        let mut now = at(tau);
        let mut went = f64::INFINITY;
        // What is left to go along the slopes.
        let mut rest = 0.0;
        for _ in 0..MAX_ITERATIONS {
            let (wrong, slope, ..) = now;
            if wrong.abs() < TOLERANCE_NM {
                break;
            }
            // The slope is at least one, so the solution is no farther away than the error.
            if wrong > 0.0 {
                (low, high) = (low.max(tau - wrong), tau)
            } else {
                (low, high) = (tau, high.min(tau - wrong))
            }
            // On a flank Newton's step can be far too long, and between the flanks repeatedly too short.
            let newton = tau - wrong / slope;
            let good = low < newton && newton < high && (newton - tau).abs() < 0.5 * went;
            if good && (newton - tau).abs() < LAST_STEP_NM {
                rest = newton - tau;
                break;
            }
            let next = if good { newton } else { 0.5 * (low + high) };
            (went, tau) = ((next - tau).abs(), next);
            now = at(tau);
        }
        let (.., [theta, bend], [friction, drag]) = now;
        let theta = theta + bend * rest;
        (self.tau, self.rise, self.bend) = (tau + rest, tau + rest - self.tau, bend);
        self.rubbing = friction - drag * first * bend * rest;
        let [dtheta, ddtheta] = self.past.derivatives(theta, dt);
        [theta, dtheta, ddtheta]
    }
}

impl Law for Swing {
    const INTEGRATES: bool = true;
    const EXPECTS: Expected = Expected::FirstSetting;

    fn memory(&self, dt: f64) -> usize {
        (DECAY_S * self.quality / dt).ceil() as usize
    }

    fn follow(&mut self, motion: &Motion) {
        self.periodic = motion.periodic;
        self.error.follow(motion);
    }

    fn at(&mut self, sample: &Sample, clock: &Clock, columns: &mut [JointVec]) {
        let (joint, size) = (self.error.joint, self.gear.size());
        let (Some(&dq), Some(column)) = (sample.dq.get(joint), columns.first_mut()) else { return };
        let own = self.error.own(sample, clock.index);
        let inertia = self.error.inertia(sample, clock.index, own) - self.rotor;
        let load = own - self.rotor * sample.ddq[joint];
        let [load_before, dq_before] = self.before.replace([load, dq]).unwrap_or([load, dq]);
        let longest = if clock.means && !self.periodic { MAX_STEP_OF_MEANS_S } else { MAX_STEP_S };
        let steps = ((clock.dt / longest).ceil() as u8).clamp(1, MAX_STEPS);
        let mut mean = [0.0; 4];
        for step in 1..=steps {
            let share = f64::from(step) / f64::from(steps);
            let between = |before: f64, now: f64| before + share * (now - before);
            let (load, dq) = (between(load_before, load), between(dq_before, dq));
            // With a negative identified inertia the torque would diverge.
            let [theta, dtheta, ddtheta] = self.step(load, dq, inertia.max(0.0), clock.dt / f64::from(steps));
            if clock.means || step == steps {
                let now = [theta, dtheta, ddtheta, self.rubbing - self.friction.at(dq, joint)];
                let before = std::mem::replace(&mut self.last, now);
                let middle = before.iter().zip(now).map(|(before, now)| 0.5 * (before + now));
                mean.iter_mut().zip(middle).for_each(|(sum, value)| *sum += value / f64::from(steps));
            }
        }
        let [theta, dtheta, ddtheta, rubbed] = if clock.means { mean } else { self.last };
        *column = self.error.signature(sample, clock.index, [theta, dtheta, ddtheta].map(|value| -value / size));
        let Some(own) = column.get_mut(joint) else { return };
        // The rotor turns with the encoder.
        *own += self.rotor * ddtheta / size;
        self.slow = -size * *own - inertia * ddtheta;
        *own += rubbed / size;
    }
}
