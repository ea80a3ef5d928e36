//! Presliding friction: hysteresis of elastic contacts before sliding. It replaces a joint's `fc tanh(100 dq)` with the same `fc`; its
//! viscous friction remains. Two forms. Both weaken with speed: `w = 1 + (breakaway - 1) exp(-(dq / stribeck-velocity)^2)`.
//!
//! With `delta`, the LuGre law (Canudas de Wit, Olsson, Astrom and Lischinsky, A new model for control of systems with friction, TAC 1995),
//! written with the displacement `delta` of one bristle:
//!
//!   dz/dt = dq - |dq| z / (delta w),   tau_f = fc z / delta + damping dz/dt.
//!
//! With `breakaway = 1` and no damping it is Dahl's law, `d tau_f / dq = (fc / delta) (1 - sgn(dq) tau_f / fc)`. The bristle `z` is a state of
//! the arm and is integrated with it.
//!
//! With `elements`, the generalised Maxwell-slip law (Al-Bender, Lampaert and Swevers, The generalized Maxwell-slip model: a novel model for
//! friction simulation and compensation, TAC 2005, with its relaxation in slip taken as immediate): springs in parallel, each of which slides at
//! its own displacement,
//!
//!   tau_f = fc sum_i share_i z_i / delta_i,   z_i follows q but stays within +-delta_i w.
//!
//! Each `z_i` depends on the path and not on the velocity, so it is computed exactly from the displacement within a step.

use super::*;

/// Most elements of a Maxwell-slip law.
const MAX_ELEMENTS: usize = 8;

/// Either `delta`, or `elements`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Config {
    /// Joint, counted from 1.
    pub joint: usize,
    /// LuGre: displacement at which a new bristle would carry `fc` \[rad\].
    pub delta: Option<f64>,
    /// LuGre: damping of the bristle \[Nms/rad\].
    pub damping: Option<f64>,
    /// Maxwell slip: up to 8 elements.
    pub elements: Option<Vec<Element>>,
    /// Friction at the first slip over Coulomb friction, at least 1.
    #[serde(default = "one")]
    pub breakaway: f64,
    /// Velocity over which the breakaway excess fades \[rad/s\].
    #[serde(default = "tenth")]
    pub stribeck_velocity: f64,
}

/// A spring that slides.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, rename_all = "kebab-case")]
pub struct Element {
    /// Share of `fc` that it carries as it slides.
    pub share: f64,
    /// Displacement at which it slides \[rad\].
    pub delta: f64,
}

/// Decrease of friction with speed.
#[derive(Clone, Copy)]
struct Weakening {
    breakaway: f64,
    velocity: f64,
}

struct LuGre {
    joint: usize,
    delta: f64,
    stiffness: f64,
    damping: f64,
    weakening: Weakening,
}

struct MaxwellSlip {
    joint: usize,
    /// `delta_i`, stiffness \[Nm/rad\], and `z_i` at `q`.
    elements: [(f64, f64, f64); MAX_ELEMENTS],
    /// Position at the start of the step \[rad\]; `None` before the first.
    q: Option<f64>,
    weakening: Weakening,
}

impl Spec for Config {
    fn check(&self, place: &Place) -> Result<(), BadInput> {
        place.joint(self.joint)?;
        place.range("breakaway", self.breakaway, 1.0, 10.0)?;
        place.range("stribeck-velocity", self.stribeck_velocity, 1e-3, 10.0)?;
        let elements = match (self.delta, &self.elements) {
            (Some(delta), None) => {
                // A bristle must not slide within one step of the integration at 2.5 rad/s.
                place.range("delta", delta, 1e-3 / f64::from(place.truth.substeps), 1.0)?;
                return place.range("damping", self.damping.unwrap_or(0.0), 0.0, 100.0);
            }
            (None, Some(elements)) => elements,
            (delta, _) => {
                let found = if delta.is_some() { "delta, elements" } else { "neither" };
                return Err(place.wrong("keys", found, "either `delta` or `elements`"));
            }
        };
        if let Some(damping) = self.damping {
            return Err(place.wrong("damping", damping, "nothing: Maxwell slip has none"));
        }
        if !(1..=MAX_ELEMENTS).contains(&elements.len()) {
            return Err(place.wrong("elements", elements.len(), format!("1 to {MAX_ELEMENTS} elements")));
        }
        for element in elements {
            place.range("elements, share", element.share, 0.0, 1.0)?;
            place.range("elements, delta", element.delta, 1e-6, 1.0)?;
        }
        let sum: f64 = elements.iter().map(|element| element.share).sum();
        if (sum - 1.0).abs() > 1e-6 {
            return Err(place.wrong("elements", format!("shares that sum to {sum}"), "shares that sum to 1"));
        }
        Ok(())
    }

    fn replaces_coulomb(&self, joint: usize) -> bool {
        self.joint == joint + 1
    }

    fn build(&self, truth: &Truth, _from: f64) -> Box<dyn Effect> {
        let joint = self.joint - 1;
        let fc = truth.joints[joint].fc;
        let weakening = Weakening { breakaway: self.breakaway, velocity: self.stribeck_velocity };
        let Some(delta) = self.delta else {
            let mut elements = [(1.0, 0.0, 0.0); MAX_ELEMENTS];
            for (slot, element) in elements.iter_mut().zip(self.elements.iter().flatten()) {
                *slot = (element.delta, fc * element.share / element.delta, 0.0);
            }
            return Box::new(MaxwellSlip { joint, elements, q: None, weakening });
        };
        let damping = self.damping.unwrap_or(0.0);
        Box::new(LuGre { joint, delta, stiffness: fc / delta, damping, weakening })
    }
}

impl Weakening {
    fn at(&self, dq: f64) -> f64 {
        1.0 + (self.breakaway - 1.0) * (-(dq / self.velocity).powi(2)).exp()
    }
}

impl Effect for LuGre {
    fn states(&self) -> usize {
        1
    }

    fn replaces_coulomb(&self, joint: usize) -> bool {
        joint == self.joint
    }

    fn torque(&self, at: &At, x: &[f64], dx: &mut [f64], tau: &mut JointVec) {
        let dq = at.dq[self.joint];
        dx[0] = dq - dq.abs() * x[0] / (self.delta * self.weakening.at(dq));
        tau[self.joint] -= self.stiffness * x[0] + self.damping * dx[0];
    }
}

impl MaxwellSlip {
    /// `z` of an element that slides at `delta`, after the joint has moved to `at`.
    fn moved(&self, at: &At, delta: f64, z: f64) -> f64 {
        let q = at.q[self.joint];
        let most = delta * self.weakening.at(at.dq[self.joint]);
        (z + q - self.q.unwrap_or(q)).clamp(-most, most)
    }
}

impl Effect for MaxwellSlip {
    fn replaces_coulomb(&self, joint: usize) -> bool {
        joint == self.joint
    }

    fn begin_step(&mut self, at: &At) {
        for i in 0..MAX_ELEMENTS {
            let (delta, _, z) = self.elements[i];
            self.elements[i].2 = self.moved(at, delta, z);
        }
        self.q = Some(at.q[self.joint]);
    }

    fn torque(&self, at: &At, _x: &[f64], _dx: &mut [f64], tau: &mut JointVec) {
        let force = |&(delta, stiffness, z): &(f64, f64, f64)| stiffness * self.moved(at, delta, z);
        tau[self.joint] -= self.elements.iter().map(force).sum::<f64>();
    }
}
