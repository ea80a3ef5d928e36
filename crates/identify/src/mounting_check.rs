//! Cross-check of the sources of the mounting, before a model is served.
//!
//! Up to three sources: the declared mounting, a sensor on the base, and the torques of the arm at rest under the model. Two sources
//! disagree when the angle between their directions exceeds `tolerance + 2 sqrt(s_a^2 + s_b^2)` with their standard deviations. A source is
//! wrong when it disagrees with the others while these agree; with two sources this is undetermined.

use super::direction::{Direction, DirectionError, Pose, direction, wrong_sign};
use nalgebra::Vector3;
use plumbline_core::{JointVec, MAX_JOINTS};
use plumbline_model::term::Sample;
use plumbline_model::{G, Mounting, TorqueModel};

/// Standard deviations allowed in addition to the tolerance.
const STD_FACTOR: f64 = 2.0;
/// Standard deviation of torque offsets and model errors at rest, beyond noise and friction \[Nm\].
const OFFSET_STD: f64 = 0.2;
/// Speed at which the model's friction is evaluated \[rad/s\]: beyond presliding, with negligible viscous friction.
const FRICTION_SPEED: f64 = 0.01;
/// Ratio of the implied to standard gravity that is plausible without a payload.
const STRENGTH_RATIO: std::ops::RangeInclusive<f64> = 0.8..=1.25;

/// Source of the direction of gravity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GravitySource {
    /// Name with its article: `the inclinometer`.
    pub name: &'static str,
    /// Gravity in the base frame; its length is ignored.
    pub gravity: Vector3<f64>,
    /// Standard deviation of its direction \[rad\].
    pub std: f64,
}

impl GravitySource {
    /// The declared mounting, without an uncertainty beyond the tolerance.
    pub fn declared(mounting: &Mounting) -> GravitySource {
        GravitySource { name: "the declared mounting", gravity: mounting.gravity(), std: 0.0 }
    }
}

/// Two sources and the angle between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pair {
    /// First source.
    pub first: GravitySource,
    /// Second source.
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
        let within = tolerance + STD_FACTOR * self.std;
        self.angle.is_nan() || within.is_nan() || self.angle > within
    }
}

impl std::fmt::Display for Pair {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (first, second) = (self.first.name, self.second.name);
        write!(f, "{first} and {second}: {:.2} +- {:.2} deg", self.angle.to_degrees(), self.std.to_degrees())
    }
}

/// The sources disagree: no model may be served.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "each message says what its variant and fields are")]
pub enum Disagreement {
    /// One source is wrong and the others agree.
    #[error(
        "{} is off by {:.2} deg, at most {:.2} deg are allowed: {}", .side.name, .off.to_degrees(), .tolerance.to_degrees(), list(.pairs)
    )]
    Off { side: GravitySource, off: f64, tolerance: f64, pairs: Vec<Pair> },
    #[error("sources of gravity disagree, at most {:.2} deg are allowed: {}", .tolerance.to_degrees(), list(.pairs))]
    Unclear { tolerance: f64, pairs: Vec<Pair> },
    #[error("the torques at rest fit the model only if the torque of joint {} had the opposite sign", .joint + 1)]
    WrongSign { joint: usize },
}

fn list(pairs: &[Pair]) -> String {
    pairs.iter().map(Pair::to_string).collect::<Vec<_>>().join("; ")
}

/// Compares every source with every other.
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
    // The wrong source is part of every disagreement while at least two others agree.
    let wrong: Vec<&GravitySource> =
        sides.iter().filter(|side| bad.iter().all(|pair| takes_part(side, pair))).collect();
    match wrong[..] {
        [side] if sides.len() >= 3 => {
            let own = bad.iter().map(|pair| pair.angle);
            let off = own.fold(f64::INFINITY, f64::min);
            Err(Disagreement::Off { side: *side, off, tolerance, pairs })
        }
        _ => Err(Disagreement::Unclear { tolerance, pairs }),
    }
}

/// Gravity implied by the torques at rest.
#[derive(Clone, Debug, PartialEq)]
pub struct ImpliedGravity {
    /// The direction; its standard deviation is increased where the misfit is larger than expected.
    pub side: GravitySource,
    /// Ratio of the implied to standard gravity.
    pub strength: f64,
    /// Squared misfit divided by its degrees of freedom; about 1 for a valid model.
    pub misfit: f64,
}

impl ImpliedGravity {
    /// Remark on an implausible strength.
    pub fn remark(&self) -> Option<String> {
        if STRENGTH_RATIO.contains(&self.strength) {
            return None;
        }
        let percent = 100.0 * (self.strength - 1.0);
        Some(format!(
            "the torques at rest imply {percent:+.0} % of gravity's strength: is there a payload that the model does not know?"
        ))
    }
}

/// Gravity implied by the torques of an arm at rest and `model`. `noise` is the standard deviation of each pose's mean torque
/// \[Nm\], where known.
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

/// Standard deviation of each joint's torque at rest \[Nm\]: noise, sensor offset, and static friction, uniform between its two
/// signs.
fn spread_at_rest(model: &TorqueModel, poses: &[Pose], noise: &[f64]) -> Vec<f64> {
    let n = model.structure().chain().len();
    let mut evaluator = model.evaluator(&Vector3::zeros());
    let mut torque = |q: JointVec, speed: f64| {
        let mut dq = [0.0; MAX_JOINTS];
        dq[..n].fill(speed);
        evaluator.torque(&Sample { q, dq, ..Sample::default() }).0
    };
    let q = poses.first().map_or([0.0; MAX_JOINTS], |pose| pose.q);
    let (there, back) = (torque(q, FRICTION_SPEED), torque(q, -FRICTION_SPEED));
    let friction = |j: usize| 0.5 * (there[j] - back[j]).abs();
    let noise = |j: usize| noise.get(j).copied().unwrap_or(0.0);
    (0..n).map(|j| (noise(j).powi(2) + OFFSET_STD.powi(2) + friction(j).powi(2) / 3.0).sqrt()).collect()
}
