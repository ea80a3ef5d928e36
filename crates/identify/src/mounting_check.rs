//! Whether all who know the mounting agree, before anything is served.
//!
//! Up to three sides: what was declared, what a sensor on the base measured, and what the torques of the arm at rest imply under the
//! model. Two sides disagree when the angle between their directions exceeds `tolerance + 2 sqrt(s_a^2 + s_b^2)` with their standard
//! deviations. The side that is off is the one that disagrees with the others while these agree; between two sides nobody can say.

use super::direction::{Direction, DirectionError, Pose, direction, wrong_sign};
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_model::term::Sample;
use plumbline_model::{G, Mounting, TorqueModel};

/// How many standard deviations are allowed for on top of the tolerance.
const SPREAD: f64 = 2.0;
/// What a torque sensor's zero and a model leave over at rest, beyond noise and friction \[Nm\].
const OFFSET: f64 = 0.2;
/// Speed at which friction is asked of the model: fast enough to be past presliding, too slow for viscous friction to count \[rad/s\].
const CREEP: f64 = 0.01;
/// Strength of the implied gravity from which on the torques do not speak of the mounting alone.
const STRENGTH: std::ops::RangeInclusive<f64> = 0.8..=1.25;

/// Somebody who knows the direction of gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GravitySource {
    /// What it is called, with its article: `the inclinometer`.
    pub name: &'static str,
    /// Gravity in the base frame; its length counts for nothing.
    pub gravity: Vector3<f64>,
    /// Standard deviation of its direction \[rad\].
    pub std: f64,
}

impl GravitySource {
    /// The configuration, which has no uncertainty of its own: the tolerance is there for it.
    pub fn declared(mounting: &Mounting) -> GravitySource {
        GravitySource { name: "the declared mounting", gravity: mounting.gravity(), std: 0.0 }
    }
}

/// Two sides and the angle between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// One.
    pub first: GravitySource,
    /// The other.
    pub second: GravitySource,
    /// Angle between their directions \[rad\].
    pub angle: f64,
    /// Its standard deviation \[rad\].
    pub std: f64,
}

impl Pair {
    fn of(first: GravitySource, second: GravitySource) -> Pair {
        let angle = first.gravity.cross(&second.gravity).norm().atan2(first.gravity.dot(&second.gravity));
        Pair { first, second, angle, std: first.std.hypot(second.std) }
    }

    fn disagree(&self, tolerance: f64) -> bool {
        let within = tolerance + SPREAD * self.std;
        self.angle.is_nan() || within.is_nan() || self.angle > within
    }
}

impl std::fmt::Display for Pair {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (first, second) = (self.first.name, self.second.name);
        write!(f, "{first} and {second}: {:.2} +- {:.2} deg", self.angle.to_degrees(), self.std.to_degrees())
    }
}

/// The sides do not agree: nothing may be served.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Disagreement {
    /// One side is off and the others agree.
    #[error(
        "{} is off by {:.2} deg, at most {:.2} deg are allowed: {}", .side.name, .off.to_degrees(), .tolerance.to_degrees(), list(.pairs)
    )]
    Off {
        /// The side.
        side: GravitySource,
        /// Its smallest angle to another side \[rad\].
        off: f64,
        /// Allowed \[rad\].
        tolerance: f64,
        /// Every pair.
        pairs: Vec<Pair>,
    },
    /// Sides disagree, and which one is off can't be said.
    #[error("nobody can say which side is off, at most {:.2} deg are allowed: {}", .tolerance.to_degrees(), list(.pairs))]
    Unclear {
        /// Allowed \[rad\].
        tolerance: f64,
        /// Every pair.
        pairs: Vec<Pair>,
    },
    /// A torque sensor has the wrong sign.
    #[error("the torques at rest fit the model only if the torque of joint {} had the opposite sign", .joint + 1)]
    WrongSign {
        /// Joint, counted from 0.
        joint: usize,
    },
}

fn list(pairs: &[Pair]) -> String {
    pairs.iter().map(Pair::to_string).collect::<Vec<_>>().join("; ")
}

/// Holds every side to every other.
///
/// # Errors
/// A pair that disagrees by more than `tolerance` \[rad\] and twice its standard deviation.
pub fn cross_check(sides: &[GravitySource], tolerance: f64) -> Result<Vec<Pair>, Disagreement> {
    let after = |i: usize| sides.iter().skip(i + 1).map(move |&second| (i, second));
    let pairs: Vec<Pair> = (0..sides.len()).flat_map(after).map(|(i, second)| Pair::of(sides[i], second)).collect();
    let bad: Vec<&Pair> = pairs.iter().filter(|pair| pair.disagree(tolerance)).collect();
    if bad.is_empty() {
        return Ok(pairs);
    }
    let takes_part = |side: &GravitySource, pair: &Pair| pair.first.name == side.name || pair.second.name == side.name;
    // Off is who is in every quarrel while at least two others have none.
    let culprits: Vec<&GravitySource> =
        sides.iter().filter(|side| bad.iter().all(|pair| takes_part(side, pair))).collect();
    match culprits[..] {
        [side] if sides.len() >= 3 => {
            let own = bad.iter().map(|pair| pair.angle);
            let off = own.fold(f64::INFINITY, f64::min);
            Err(Disagreement::Off { side: *side, off, tolerance, pairs })
        }
        _ => Err(Disagreement::Unclear { tolerance, pairs }),
    }
}

/// What the torques at rest say.
#[derive(Clone, Debug, PartialEq)]
pub struct ImpliedGravity {
    /// The direction, its standard deviation widened where model and torques do not agree to within what was expected.
    pub side: GravitySource,
    /// Strength of the implied gravity over the standard one.
    pub strength: f64,
    /// Squared misfit over its degrees of freedom; about 1 where the model explains the torques.
    pub misfit: f64,
}

impl ImpliedGravity {
    /// What else should be known of it, if anything.
    pub fn remark(&self) -> Option<String> {
        if STRENGTH.contains(&self.strength) {
            return None;
        }
        let percent = 100.0 * (self.strength - 1.0);
        Some(format!(
            "the torques at rest imply {percent:+.0} % of gravity's strength: is there a payload that the model does not know?"
        ))
    }
}

/// The direction that the torques of an arm at rest imply under `model`. `noise` is the standard deviation of each pose's mean torque
/// \[Nm\], as far as it is known.
///
/// # Errors
/// `Ok(Err(_))` is a torque sensor with the wrong sign.
pub fn implied_gravity(
    model: &TorqueModel,
    poses: &[Pose],
    noise: &[f64],
) -> Result<Result<ImpliedGravity, Disagreement>, DirectionError> {
    let sigma = spread_at_rest(model, poses, noise);
    if let Some(joint) = wrong_sign(model, poses, &sigma)? {
        return Ok(Err(Disagreement::WrongSign { joint }));
    }
    let found: Direction = direction(model, poses, &sigma)?;
    let freedom = (sigma.len() * poses.len()).saturating_sub(3).max(1) as f64;
    let misfit = found.misfit(&sigma) / freedom;
    let std = found.std() * misfit.max(1.0).sqrt();
    let side = GravitySource { name: "what the torques at rest imply", gravity: found.gravity, std };
    Ok(Ok(ImpliedGravity { side, strength: found.gravity.norm() / G, misfit }))
}

/// Standard deviation of each joint's torque at rest: noise, the sensor's zero, and friction that holds the joint, which lies anywhere
/// between its two signs \[Nm\].
fn spread_at_rest(model: &TorqueModel, poses: &[Pose], noise: &[f64]) -> Vec<f64> {
    let n = model.structure().chain().len();
    let mut evaluator = model.evaluator(&Vector3::zeros());
    let mut torque = |q: JointVec, speed: f64| {
        let mut dq = [0.0; MAX_JOINTS];
        dq[..n].fill(speed);
        evaluator.torque(&Sample { q, dq, ..Sample::default() }).0
    };
    let q = poses.first().map_or([0.0; MAX_JOINTS], |pose| pose.q);
    let (there, back) = (torque(q, CREEP), torque(q, -CREEP));
    let friction = |j: usize| 0.5 * (there[j] - back[j]).abs();
    let noise = |j: usize| noise.get(j).copied().unwrap_or(0.0);
    (0..n).map(|j| (noise(j).powi(2) + OFFSET.powi(2) + friction(j).powi(2) / 3.0).sqrt()).collect()
}
