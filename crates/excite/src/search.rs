//! Search problem, random motions, and the plan of a found motion. The optimiser is [`super::optimiser`].

use super::ExciteError;
use super::criterion::{Criterion, evaluate, sampled, stacked};
use super::fourier::{Fourier, MAX_HARMONICS};
use super::guard_check::check_with_guard;
use super::limits::{Bounds, Check, Peak, Quantity, check, check_pose, verify};
use super::nominal::Nominal;
use super::plan::{Constraints, Plan, PlanUsage};
use super::usage::{TARGET_USAGE, check_usage, least_usage, usage};
use plumbline_core::JointVec;
use plumbline_model::term::Motion;
use plumbline_model::{Conditions, Mounting, Structure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

/// Ratio of samples of the evaluation grid to samples of the search grid.
pub const FINE_GRID_RATIO: usize = 5;

/// Search problem.
pub struct Problem<'a> {
    /// Name of the robot for the plan.
    pub robot: &'a str,
    /// Model whose parameters are excited; its chain is the arm.
    pub structure: &'a Structure,
    /// Mounting of the base.
    pub mounting: Mounting,
    /// Limits of the motion. Their chain is the arm's.
    pub bounds: Bounds<'a>,
    /// Nominal model for the torque and torque-rate limits; `None` for no such limits.
    pub nominal: Option<&'a Nominal>,
    /// Torque noise of each joint for the weighted criteria, n \[Nm\].
    pub sigma: &'a [f64],
    /// Start pose \[rad\]; `None` to optimise it too.
    pub q0: Option<&'a [f64]>,
}

/// Settings of a search.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, rename_all = "kebab-case", default)]
pub struct Search {
    /// Period \[s\].
    pub period: f64,
    /// Number of harmonics, N.
    pub harmonics: usize,
    /// Criterion to minimise.
    pub criterion: Criterion,
    /// Random starts of the descent; the best quarter is continued to convergence.
    pub starts: usize,
    /// Rounds in which the best motions are perturbed and descended again.
    pub rounds: usize,
    /// Samples of one period on the search grid.
    pub samples: usize,
    /// Seed of the random numbers; the result is deterministic.
    pub seed: u64,
}

impl Default for Search {
    fn default() -> Search {
        Search { period: 10.0, harmonics: 5, criterion: Criterion::Raw, starts: 32, rounds: 6, samples: 80, seed: 1 }
    }
}

/// Progress of a search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Completed steps.
    pub done: usize,
    /// Total steps.
    pub of: usize,
    /// Best criterion so far (condition number, or exponential of [`Criterion::LogDet`]); infinite before the first motion.
    pub best: f64,
}

/// Threads, cancellation and progress report of a search.
#[derive(Clone, Copy)]
pub struct SearchControl<'a> {
    /// Number of threads.
    pub threads: usize,
    /// Polled between the stages of a descent: when true, the search ends with its best motion so far.
    pub stop: &'a (dyn Fn() -> bool + Sync),
    /// Called with the progress, from any thread.
    pub progress: &'a (dyn Fn(Progress) + Sync),
}

impl SearchControl<'_> {
    /// A search on `threads` threads without cancellation and progress report.
    pub fn with_threads(threads: usize) -> SearchControl<'static> {
        SearchControl { threads, stop: &|| false, progress: &|_| {} }
    }
}

/// Maximum random start poses.
const MAX_POSES: usize = 2000;
/// Factors by which an infeasible motion is scaled down: the first for [`GENTLE_STEPS`] steps, then the second.
const SHRINK_RATIOS: [f64; 2] = [0.995, 0.9];
const GENTLE_STEPS: usize = 8;
const MAX_SHRINK_STEPS: usize = 80;
/// Ratio that scales a motion fitted on the coarse grid, whose samples can miss a peak.
const COARSE_GRID_RATIO: f64 = 0.99;
/// Maximum random motions drawn.
const MAX_DRAWS: usize = 50;
const BISECTION_STEPS: usize = 30;

/// Random motion for validation: it satisfies every limit at 1 kHz and moves every joint. `amplitude` (0 to 1) is the share of each joint's
/// range of motion. Only the condition numbers of the plan depend on the structure.
///
/// A motion about a start pose near the box or near another link is small: below [`TARGET_USAGE`] another pose is drawn. The best
/// of the draws is returned.
///
/// # Errors
/// [`ExciteError::Frozen`] where the best draw leaves a joint below [`super::usage::MIN_USAGE`]; errors of drawing motions.
pub fn random_plan(problem: &Problem, search: &Search, amplitude: f64) -> Result<Plan, ExciteError> {
    validate(problem, search)?;
    let mut rng = ChaCha8Rng::seed_from_u64(search.seed);
    let mut best: Option<Candidate> = None;
    let mut first_error = None;
    let used =
        |fourier: &Fourier| least_usage(&usage(&problem.bounds, fourier)).map_or(0.0, |(_, usage)| usage.largest());
    for _ in 0..MAX_DRAWS {
        let drawn = random_motion(problem, search, amplitude, &mut rng)?;
        let limited_by = coarse(problem, &drawn, search.samples).violations().next().copied();
        let better = |fourier: &Fourier| best.as_ref().is_none_or(|best| used(fourier) > best.least);
        // The check at 1 kHz is the most expensive and only scales motions down.
        let kept = match shrink(drawn, |fourier| coarse(problem, fourier, search.samples)) {
            Ok(fourier) if !better(&fourier) => continue,
            kept => kept.and_then(|fourier| shrink(fourier, |fourier| verify_with_guard(problem, fourier))),
        };
        match kept {
            Ok(fourier) if better(&fourier) => best = Some(Candidate { least: used(&fourier), fourier, limited_by }),
            Ok(_) => {}
            Err(error) => first_error = Some(error),
        }
        if best.as_ref().is_some_and(|best| best.least >= TARGET_USAGE) {
            break;
        }
    }
    match (best, first_error) {
        (Some(Candidate { fourier, limited_by, .. }), _) => {
            check_usage(&usage(&problem.bounds, &fourier), limited_by, MAX_DRAWS)?;
            plan_of(problem, search, fourier)
        }
        (None, Some(error)) => Err(error),
        (None, None) => Err(ExciteError::Budget { starts: search.starts, samples: search.samples }),
    }
}

/// Feasible random motion.
struct Candidate {
    fourier: Fourier,
    /// Smallest usage over the joints.
    least: f64,
    /// The limit that a larger motion of this form violates.
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
        check_start_pose(problem, q0)?;
    }
    Ok(())
}

/// Checks that the arm can rest at a pose.
///
/// # Errors
/// The violated limit.
fn check_start_pose(problem: &Problem, q0: &[f64]) -> Result<(), ExciteError> {
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

/// The given start pose, or a random feasible one.
fn pose(problem: &Problem, rng: &mut ChaCha8Rng) -> Result<Vec<f64>, ExciteError> {
    if let Some(q0) = problem.q0 {
        return Ok(q0.to_vec());
    }
    let (limits, margin) = (problem.bounds.limits, problem.bounds.margins.position);
    let mut last = None;
    for _ in 0..MAX_POSES {
        // From the middle two thirds of each range.
        let q0: Vec<f64> = (0..problem.bounds.chain.len())
            .map(|j| {
                let (min, max) = (limits.q_min[j] + margin, limits.q_max[j] - margin);
                0.5 * (min + max) + rng.random_range(-1.0..1.0) * (max - min) / 3.0
            })
            .collect();
        match check_start_pose(problem, &q0) {
            Ok(()) => return Ok(q0),
            Err(error) => last = Some(error),
        }
    }
    Err(ExciteError::NoStart { tried: MAX_POSES, last: last.map(Box::new) })
}

/// Random motion about a feasible start pose, every joint scaled to its own limits. Box, clearances and torques are not checked.
pub(super) fn random_motion(
    problem: &Problem,
    search: &Search,
    amplitude: f64,
    rng: &mut ChaCha8Rng,
) -> Result<Fourier, ExciteError> {
    let mut fourier = Fourier::still(search.period, pose(problem, rng)?, search.harmonics)?;
    for k in 0..search.harmonics {
        for j in 0..fourier.joints() {
            // Amplitudes proportional to 1/k balance range (low harmonics) and acceleration (high harmonics).
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

/// Scales a motion about its start pose down until it is feasible: only the joints that violate their own limits, else the whole motion.
pub(super) fn shrink(mut fourier: Fourier, check: impl Fn(&Fourier) -> Check) -> Result<Fourier, ExciteError> {
    let mut violated: Option<Peak> = None;
    for tried in 0..MAX_SHRINK_STEPS {
        let check = check(&fourier);
        let Some(first) = check.violations().next() else { return Ok(fourier) };
        violated = Some(*first);
        let own = |peak: &Peak| peak.joint.filter(|_| peak.quantity.is_of_one_joint());
        let joints: Option<Vec<usize>> = check.violations().map(own).collect();
        for j in 0..fourier.joints() {
            if joints.as_ref().is_none_or(|joints| joints.contains(&(j + 1))) {
                fourier.scale_joint(j, SHRINK_RATIOS[usize::from(tried >= GENTLE_STEPS)]);
            }
        }
    }
    match violated {
        None => Ok(fourier),
        Some(violation) => Err(ExciteError::NoMotion { violation }),
    }
}

/// A motion scaled down until it is feasible at 1 kHz. The coarse grid comes first: the check at 1 kHz is the most expensive.
pub(super) fn shrunk(problem: &Problem, fourier: Fourier, samples: usize) -> Result<Fourier, ExciteError> {
    shrink(fourier, |fourier| coarse(problem, fourier, samples))
        .and_then(|fourier| shrink(fourier, |fourier| verify_with_guard(problem, fourier)))
}

/// Largest factor by which joint `j` can be scaled within its range, speed, acceleration and jerk.
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
    // The joint does not move.
    if !factor.is_finite() {
        return 1.0;
    }
    // The position-dependent speed limit is evaluated at the scaled positions. It is concave where positive, so the feasible factors are an
    // interval from zero.
    let keeps = |factor: f64| {
        let speeds = |q: f64| bounds.speeds(j, q0 + factor * (q - q0));
        points.iter().all(|point| factor * point.dq.abs() <= speeds(point.q)[usize::from(point.dq > 0.0)])
    };
    if bounds.envelope.is_some() && !keeps(factor) {
        let mut low = 0.0;
        for _ in 0..BISECTION_STEPS {
            let middle = 0.5 * (low + factor);
            if keeps(middle) { low = middle } else { factor = middle }
        }
        factor = low;
    }
    COARSE_GRID_RATIO * factor
}

fn coarse(problem: &Problem, fourier: &Fourier, samples: usize) -> Check {
    with_torque(problem, |torque| check(&problem.bounds, fourier, samples, torque))
}

/// Check of a motion at 1 kHz by the limits less margins and by the rules of the loop's guard. A plan must pass it.
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

/// Samples of one period of each motion on a fine grid, concatenated. Panics when there is none.
pub fn motion_samples(problem: &Problem, motions: &[Fourier]) -> Motion {
    let fine =
        |fourier: &Fourier| sampled(fourier, &problem.mounting.gravity(), FINE_GRID_RATIO * Search::default().samples);
    stacked(&motions.iter().map(fine).collect::<Vec<_>>())
}

/// Condition numbers of the stacked regressor of several motions.
pub fn stacked_conditions(problem: &Problem, motions: &[Fourier]) -> Conditions {
    evaluate(problem.structure, &motion_samples(problem, motions), problem.sigma)
}

/// The plan of a motion.
///
/// # Errors
/// [`ExciteError::NoMotion`] when it violates a limit at 1 kHz.
pub(super) fn plan_of(problem: &Problem, search: &Search, fourier: Fourier) -> Result<Plan, ExciteError> {
    if let Some(violation) = verify_with_guard(problem, &fourier).violations().next() {
        return Err(ExciteError::NoMotion { violation: *violation });
    }
    let motion = sampled(&fourier, &problem.mounting.gravity(), FINE_GRID_RATIO * search.samples);
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
        search: None,
    })
}

pub(super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}
