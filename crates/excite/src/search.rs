//! What a motion is searched for with, random motions, and the plan that a search ends in. The search itself is [`super::optimiser`].

use super::ExciteError;
use super::criterion::{Criterion, evaluate, sampled, stacked};
use super::fourier::{Fourier, MAX_HARMONICS};
use super::guard_check::check_with_guard;
use super::limits::{Bounds, Check, Peak, Quantity, check, check_pose, verify};
use super::nominal::Nominal;
use super::optimiser::FINE;
use super::plan::{Constraints, Plan, PlanUsage};
use super::usage::{WANTED_USAGE, check_usage, least_usage, usage};
use plumbline_core::JointVec;
use plumbline_model::term::Motion;
use plumbline_model::{Conditions, Mounting, Structure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// What is searched for, and where.
pub struct Problem<'a> {
    /// Name of the robot, for the plan.
    pub robot: &'a str,
    /// Model whose parameters are to be excited; its chain is the arm.
    pub structure: &'a Structure,
    /// Mounting of the base.
    pub mounting: Mounting,
    /// Limits of the motion. Their chain is the arm's.
    pub bounds: Bounds<'a>,
    /// Nominal model, to hold the limits of torque and torque rate as well; `None` leaves them out.
    pub nominal: Option<&'a Nominal>,
    /// Torque noise of each joint for the weighted criteria, n \[Nm\].
    pub sigma: &'a [f64],
    /// Start pose; `None` lets the search choose one \[rad\].
    pub q0: Option<&'a [f64]>,
}

/// How a motion is searched for.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Search {
    /// Period \[s\].
    pub period: f64,
    /// Number of harmonics, N.
    pub harmonics: usize,
    /// What is made small.
    pub criterion: Criterion,
    /// Random motions that are descended from; the best quarter of them is seen through.
    pub starts: usize,
    /// Rounds in which the best motions are shaken and descended again.
    pub rounds: usize,
    /// Samples of one period on the grid that is searched on.
    pub samples: usize,
    /// Seed of the random numbers: the same seed finds the same motion.
    pub seed: u64,
}

impl Default for Search {
    fn default() -> Search {
        Search { period: 10.0, harmonics: 5, criterion: Criterion::Raw, starts: 32, rounds: 6, samples: 80, seed: 1 }
    }
}

/// How far a search has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Steps that are over.
    pub done: usize,
    /// Steps of the whole search.
    pub of: usize,
    /// Best criterion so far (a condition number, or what [`Criterion::LogDet`] stands for); infinite before the first motion.
    pub best: f64,
}

/// Who watches a search, and what it may use.
#[derive(Clone, Copy)]
pub struct SearchControl<'a> {
    /// Threads that descents run on.
    pub threads: usize,
    /// Asked between the legs of a descent: when true, the search ends with the best that it has.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// TimedEvent how far it is, from any thread.
    pub progress: &'a (dyn Fn(Progress) + Sync),
}

impl SearchControl<'_> {
    /// Nobody watches: all starts are seen through, on this many threads.
    pub fn with_threads(threads: usize) -> SearchControl<'static> {
        SearchControl { threads, stop: &|| false, progress: &|_| {} }
    }
}

/// Start poses tried before giving up.
const POSES: usize = 2000;
/// Factors by which a motion is shrunk when it leaves the limits: gently at first.
const SHRINK: [f64; 2] = [0.995, 0.9];
const GENTLE: usize = 8;
const SHRINKINGS: usize = 80;
/// Extra room on the coarse grid, whose samples can straddle a peak.
const COARSE_ROOM: f64 = 0.99;
/// Random motions that are drawn at most.
const DRAWS: usize = 50;
/// Steps of a bisection.
const BISECTIONS: usize = 30;

/// A random motion that keeps every limit at 1 kHz and moves every joint, for validation. `amplitude` (0 to 1) is the share of each joint's
/// room that it uses. Only the condition numbers of the plan depend on the structure.
///
/// A start pose near the box or near another link leaves a motion about it little room: below [`WANTED_USAGE`] another one is drawn. The best
/// of the draws is taken.
///
/// # Errors
/// [`ExciteError::Frozen`] where even that leaves a joint below [`super::usage::MIN_USAGE`], and what keeps motions from being drawn at all.
pub fn random_plan(problem: &Problem, search: &Search, amplitude: f64) -> Result<Plan, ExciteError> {
    validate(problem, search)?;
    let mut rng = ChaCha8Rng::seed_from_u64(search.seed);
    let mut best: Option<Drawn> = None;
    let mut trouble = None;
    let used =
        |fourier: &Fourier| least_usage(&usage(&problem.bounds, fourier)).map_or(0.0, |(_, usage)| usage.largest());
    for _ in 0..DRAWS {
        let drawn = random_motion(problem, search, amplitude, &mut rng)?;
        let limited_by = coarse(problem, &drawn, search.samples).violations().next().copied();
        let better = |fourier: &Fourier| best.as_ref().is_none_or(|best| used(fourier) > best.least);
        // The judgement at 1 kHz takes the longest, and makes no motion larger.
        let kept = match shrink(drawn, |fourier| coarse(problem, fourier, search.samples)) {
            Ok(fourier) if !better(&fourier) => continue,
            kept => kept.and_then(|fourier| shrink(fourier, |fourier| verify_with_guard(problem, fourier))),
        };
        match kept {
            Ok(fourier) if better(&fourier) => best = Some(Drawn { least: used(&fourier), fourier, limited_by }),
            Ok(_) => {}
            Err(error) => trouble = Some(error),
        }
        if best.as_ref().is_some_and(|best| best.least >= WANTED_USAGE) {
            break;
        }
    }
    match (best, trouble) {
        (Some(Drawn { fourier, limited_by, .. }), _) => {
            check_usage(&usage(&problem.bounds, &fourier), limited_by, DRAWS)?;
            plan_of(problem, search, fourier)
        }
        (None, Some(error)) => Err(error),
        (None, None) => Err(ExciteError::Budget { starts: search.starts, samples: search.samples }),
    }
}

/// A random motion inside the limits.
struct Drawn {
    fourier: Fourier,
    /// Usage of the joint that it moves least.
    least: f64,
    /// What a larger motion of this form breaks.
    limited_by: Option<Peak>,
}

pub(super) fn validate(problem: &Problem, search: &Search) -> Result<(), ExciteError> {
    let n = problem.bounds.chain.len();
    if search.starts == 0 || search.samples < 20 {
        return Err(ExciteError::Budget { starts: search.starts, samples: search.samples });
    }
    if !(3..=MAX_HARMONICS).contains(&search.harmonics) {
        return Err(ExciteError::Harmonics { harmonics: search.harmonics });
    }
    for found in [problem.q0.map_or(n, <[f64]>::len), problem.sigma.len(), problem.structure.chain().len()] {
        if found != n {
            return Err(ExciteError::Joints { found, expected: n });
        }
    }
    let (limits, margins) = (problem.bounds.limits, &problem.bounds.margins);
    for j in 0..n {
        let rooms = [
            ("range", limits.q_max[j] - limits.q_min[j] - 2.0 * margins.position),
            ("speed", limits.dq[j] * margins.velocity),
            ("acceleration", limits.ddq[j] * margins.acceleration),
            ("jerk", limits.jerk[j] * margins.jerk),
        ];
        if let Some((what, _)) = rooms.into_iter().find(|(_, room)| room.is_nan() || *room <= 0.0) {
            return Err(ExciteError::NoRoom { joint: j + 1, what });
        }
    }
    if let Some(q0) = problem.q0 {
        can_rest(problem, q0)?;
    }
    Ok(())
}

/// Whether the arm can rest at a pose; the error says what is wrong with it.
fn can_rest(problem: &Problem, q0: &[f64]) -> Result<(), ExciteError> {
    let (limits, margin) = (problem.bounds.limits, problem.bounds.margins.position);
    for (j, &q) in q0.iter().enumerate() {
        let (min, max) = (limits.q_min[j] + margin, limits.q_max[j] - margin);
        if !(min..=max).contains(&q) {
            return Err(ExciteError::StartJoint { joint: j + 1, q, min, max });
        }
    }
    if let Some(violation) = check_pose(&problem.bounds, q0).violations().next() {
        if !matches!(violation.quantity, Quantity::BoxMin(_) | Quantity::BoxMax(_) | Quantity::BaseSphere) {
            return Err(ExciteError::StartPose { violation: *violation });
        }
        let at = problem.bounds.chain.end_effector(q0).into();
        return Err(ExciteError::StartWorkspace { at, reason: violation.to_string() });
    }
    let still = Fourier::still(1.0, q0.to_vec(), 1)?;
    match coarse(problem, &still, 1).violations().next() {
        None => Ok(()),
        Some(violation) => Err(ExciteError::StartPose { violation: *violation }),
    }
}

/// The given start pose, or a random one that the arm can rest at.
fn pose(problem: &Problem, rng: &mut ChaCha8Rng) -> Result<Vec<f64>, ExciteError> {
    if let Some(q0) = problem.q0 {
        return Ok(q0.to_vec());
    }
    let (limits, margin) = (problem.bounds.limits, problem.bounds.margins.position);
    let mut last = None;
    for _ in 0..POSES {
        // From the middle two thirds of each range, to leave room for the motion.
        let q0: Vec<f64> = (0..problem.bounds.chain.len())
            .map(|j| {
                let (min, max) = (limits.q_min[j] + margin, limits.q_max[j] - margin);
                0.5 * (min + max) + rng.random_range(-1.0..1.0) * (max - min) / 3.0
            })
            .collect();
        match can_rest(problem, &q0) {
            Ok(()) => return Ok(q0),
            Err(error) => last = Some(error),
        }
    }
    Err(ExciteError::NoStart { tried: POSES, last: last.map(Box::new) })
}

/// A random motion about a pose that the arm can rest at, every joint scaled to its own limits. Box, bodies and torques are not asked.
pub(super) fn random_motion(
    problem: &Problem,
    search: &Search,
    amplitude: f64,
    rng: &mut ChaCha8Rng,
) -> Result<Fourier, ExciteError> {
    let mut fourier = Fourier::still(search.period, pose(problem, rng)?, search.harmonics)?;
    for k in 0..search.harmonics {
        for j in 0..fourier.joints() {
            // Low harmonics reach far, high ones accelerate: shares that fall with k let neither crowd the other out.
            let weight = 1.0 / (k + 1) as f64;
            fourier.a[(j, k)] = weight * normal(rng);
            fourier.b[(j, k)] = weight * normal(rng);
        }
    }
    fourier.project();
    for j in 0..fourier.joints() {
        let factor = room(problem, &fourier, j, search.samples) * amplitude;
        fourier.scale_joint(j, factor);
    }
    Ok(fourier)
}

/// Shrinks a motion about its start pose until it keeps the limits: a joint that breaks a limit of its own alone, else the whole motion.
pub(super) fn shrink(mut fourier: Fourier, check: impl Fn(&Fourier) -> Check) -> Result<Fourier, ExciteError> {
    let mut broken: Option<Peak> = None;
    for tried in 0..SHRINKINGS {
        let check = check(&fourier);
        let Some(first) = check.violations().next() else { return Ok(fourier) };
        broken = Some(*first);
        let own = |peak: &Peak| peak.joint.filter(|_| peak.quantity.is_of_one_joint());
        let joints: Option<Vec<usize>> = check.violations().map(own).collect();
        for j in 0..fourier.joints() {
            if joints.as_ref().is_none_or(|joints| joints.contains(&(j + 1))) {
                fourier.scale_joint(j, SHRINK[usize::from(tried >= GENTLE)]);
            }
        }
    }
    match broken {
        None => Ok(fourier),
        Some(violation) => Err(ExciteError::NoMotion { violation }),
    }
}

/// Largest factor by which joint `j` can be scaled within its range, speed, acceleration and jerk, all taken along the scaled motion.
fn room(problem: &Problem, fourier: &Fourier, j: usize, samples: usize) -> f64 {
    let (bounds, limits, margins) = (&problem.bounds, problem.bounds.limits, &problem.bounds.margins);
    let q0 = fourier.q0[j];
    let (up, down) = (limits.q_max[j] - margins.position - q0, q0 - limits.q_min[j] - margins.position);
    let points: Vec<_> = (0..samples).map(|k| fourier.at(j, k as f64 * fourier.period / samples as f64)).collect();
    let mut factor = f64::INFINITY;
    for point in &points {
        let away = point.q - q0;
        let uses = [
            if away > 0.0 { away / up } else { -away / down },
            point.dq.abs() / (limits.dq[j] * margins.velocity),
            point.ddq.abs() / (limits.ddq[j] * margins.acceleration),
            point.jerk.abs() / (limits.jerk[j] * margins.jerk),
        ];
        factor = uses.into_iter().filter(|&used| used > 0.0).fold(factor, |factor, used| factor.min(1.0 / used));
    }
    // A joint that does not move at all has nothing to scale.
    if !factor.is_finite() {
        return 1.0;
    }
    // A speed limit that falls towards the ends of the range is that of the scaled positions. It is concave in them where it is above
    // zero, so the factors that keep it are those from zero to a largest one.
    let keeps = |factor: f64| {
        let speeds = |q: f64| bounds.speeds(j, q0 + factor * (q - q0));
        points.iter().all(|point| factor * point.dq.abs() <= speeds(point.q)[usize::from(point.dq > 0.0)])
    };
    if bounds.envelope.is_some() && !keeps(factor) {
        let mut low = 0.0;
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (low + factor);
            if keeps(middle) { low = middle } else { factor = middle }
        }
        factor = low;
    }
    COARSE_ROOM * factor
}

/// What the motion breaks on a coarse grid.
fn coarse(problem: &Problem, fourier: &Fourier, samples: usize) -> Check {
    with_torque(problem, |torque| check(&problem.bounds, fourier, samples, torque))
}

/// What the motion breaks at 1 kHz, by the limits less their margins and by the rules of the loop's guard: the judgement that a plan stands
/// on.
pub fn verify_with_guard(problem: &Problem, fourier: &Fourier) -> Check {
    let mut check = with_torque(problem, |torque| verify(&problem.bounds, fourier, torque));
    if check.is_feasible() {
        check.peaks.extend(check_with_guard(&problem.bounds, fourier));
    }
    check
}

fn with_torque(problem: &Problem, judge: impl Fn(Option<super::limits::NominalTorque>) -> Check) -> Check {
    let gravity = problem.mounting.gravity();
    match problem.nominal {
        None => judge(None),
        Some(nominal) => judge(Some(&|q: &JointVec, dq: &JointVec, ddq: &JointVec| {
            nominal.torque(problem.bounds.chain, &gravity, q, dq, ddq)
        })),
    }
}

/// One period of each of several motions on a fine grid, one after the other. Panics when there is none.
pub fn motion_samples(problem: &Problem, motions: &[Fourier]) -> Motion {
    let fine = |fourier: &Fourier| sampled(fourier, &problem.mounting.gravity(), FINE * Search::default().samples);
    stacked(&motions.iter().map(fine).collect::<Vec<_>>())
}

/// Condition numbers of several motions together, stacked.
pub fn stacked_conditions(problem: &Problem, motions: &[Fourier]) -> Conditions {
    evaluate(problem.structure, &motion_samples(problem, motions), problem.sigma)
}

/// The plan of a motion that keeps every limit at 1 kHz; an error when it does not.
pub(super) fn plan_of(problem: &Problem, search: &Search, fourier: Fourier) -> Result<Plan, ExciteError> {
    if let Some(violation) = verify_with_guard(problem, &fourier).violations().next() {
        return Err(ExciteError::NoMotion { violation: *violation });
    }
    let motion = sampled(&fourier, &problem.mounting.gravity(), FINE * search.samples);
    let rows = |m: &nalgebra::DMatrix<f64>| m.row_iter().map(|row| row.iter().copied().collect()).collect();
    Ok(Plan {
        robot: problem.robot.to_string(),
        rho: problem.mounting.rho,
        phi: problem.mounting.phi,
        period: search.period,
        harmonics: search.harmonics,
        seed: search.seed,
        q0: fourier.q0.clone(),
        a: rows(&fourier.a),
        b: rows(&fourier.b),
        conditions: evaluate(problem.structure, &motion, problem.sigma),
        constraints: Constraints::of(&problem.bounds, problem.nominal.is_some()),
        usage: Some(PlanUsage::of(&usage(&problem.bounds, &fourier))),
    })
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}
