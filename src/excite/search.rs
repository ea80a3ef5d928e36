//! A randomised search for motions that keep every limit and excite every parameter.

use super::ExciteError;
use super::criterion::{evaluate, raw_condition, sampled};
use super::fourier::Fourier;
use super::limits::{Bounds, Check, NominalTorque, Peak, check, verify};
use super::plan::{Constraints, Plan};
use crate::model::gravity::Mounting;
use crate::model::structure::Structure;
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
    /// Nominal torque at (q, dq, ddq), to hold the torque limits as well; `None` leaves them out.
    pub torque: Option<NominalTorque<'a>>,
    /// Torque noise of each joint for the weighted condition number, n \[Nm\].
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
    /// Condition numbers to compute before the search ends.
    pub evaluations: usize,
    /// Samples of one period on the grid that is searched on.
    pub samples: usize,
    /// Seed of the random numbers: the same seed finds the same motion.
    pub seed: u64,
}

impl Default for Search {
    fn default() -> Search {
        Search { period: 10.0, harmonics: 5, evaluations: 3000, samples: 100, seed: 1 }
    }
}

/// How far a search has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Progress {
    /// Condition numbers computed.
    pub done: usize,
    /// Condition numbers granted.
    pub of: usize,
    /// Best raw condition number so far; infinite before the first motion.
    pub best: f64,
}

/// Share of the evaluations that are spent on random motions before the climb.
const RANDOM_SHARE: f64 = 0.1;
/// Random start poses tried before giving up.
const POSES: usize = 2000;
/// Factor by which a motion is shrunk when it leaves the limits, and how often at most.
const SHRINK: f64 = 0.9;
const SHRINKINGS: usize = 80;
/// Extra room on the coarse grid, whose samples can straddle a peak.
const COARSE_ROOM: f64 = 0.99;

/// Searches for the motion of least raw condition number (paper eq. 11 with Sigma = 1): random motions, then a climb from the best
/// with steps that grow after a success and shrink after failures. The result keeps every limit at 1 kHz.
pub fn optimise(problem: &Problem, search: &Search, mut progress: impl FnMut(Progress)) -> Result<Plan, ExciteError> {
    validate(problem, search)?;
    let mut rng = ChaCha8Rng::seed_from_u64(search.seed);
    let gravity = problem.mounting.gravity();
    let cost = |fourier: &Fourier| raw_condition(problem.structure, &sampled(fourier, &gravity, search.samples));
    let of = search.evaluations;
    let starts = ((of as f64 * RANDOM_SHARE).ceil() as usize).clamp(1, of);

    let mut best = (f64::INFINITY, Fourier::still(search.period, pose(problem, &mut rng)?, search.harmonics)?);
    for done in 1..=starts {
        let candidate = feasible_random(problem, search, 1.0, &mut rng)?;
        let value = cost(&candidate);
        if value < best.0 || done == 1 {
            best = (value, candidate);
        }
        progress(Progress { done, of, best: best.0 });
    }
    let mut step = 0.3;
    for done in starts + 1..=of {
        let mut candidate = perturbed(problem, &best.1, step, &mut rng);
        fit_joints(problem, &mut candidate, search.samples);
        let value =
            if coarse(problem, &candidate, search.samples).is_feasible() { cost(&candidate) } else { f64::INFINITY };
        // One success in five failures keeps the step (the 1/5 rule of evolution strategies).
        if value < best.0 {
            best = (value, candidate);
            step = f64::min(step * 1.5, 1.0);
        } else {
            step = f64::max(step * 1.5_f64.powf(-0.25), 0.01);
        }
        progress(Progress { done, of, best: best.0 });
    }
    finish(problem, search, best.1)
}

/// A random motion that keeps every limit at 1 kHz, for validation. `amplitude` (0 to 1) is the share of each joint's room that it
/// uses. Only the condition numbers of the plan depend on the structure.
pub fn random(problem: &Problem, search: &Search, amplitude: f64) -> Result<Plan, ExciteError> {
    validate(problem, search)?;
    let mut rng = ChaCha8Rng::seed_from_u64(search.seed);
    let fourier = feasible_random(problem, search, amplitude, &mut rng)?;
    finish(problem, search, fourier)
}

fn validate(problem: &Problem, search: &Search) -> Result<(), ExciteError> {
    let n = problem.bounds.chain.len();
    if search.evaluations == 0 || search.samples < 20 {
        return Err(ExciteError::Budget { evaluations: search.evaluations, samples: search.samples });
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
        check_pose(problem, search, q0)?;
    }
    Ok(())
}

/// Whether the arm can rest at a pose; the error says what is wrong with it.
fn check_pose(problem: &Problem, search: &Search, q0: &[f64]) -> Result<(), ExciteError> {
    let (limits, margin) = (problem.bounds.limits, problem.bounds.margins.position);
    let still = Fourier::still(search.period, q0.to_vec(), search.harmonics)?;
    for (j, &q) in q0.iter().enumerate() {
        let (min, max) = (limits.q_min[j] + margin, limits.q_max[j] - margin);
        if !(min..=max).contains(&q) {
            return Err(ExciteError::StartJoint { joint: j + 1, q, min, max });
        }
    }
    match check(&problem.bounds, &still, 1, problem.torque).violations().next() {
        None => Ok(()),
        Some(violation) if violation.joint.is_some() => Err(ExciteError::StartTorque { violation: *violation }),
        Some(violation) => Err(ExciteError::StartWorkspace {
            at: problem.bounds.chain.end_effector(q0).into(),
            reason: violation.to_string(),
        }),
    }
}

/// The given start pose, or a random one that the arm can rest at.
fn pose(problem: &Problem, rng: &mut ChaCha8Rng) -> Result<Vec<f64>, ExciteError> {
    if let Some(q0) = problem.q0 {
        return Ok(q0.to_vec());
    }
    let (limits, margin) = (problem.bounds.limits, problem.bounds.margins.position);
    let any = Search::default();
    let mut last = [0.0; 3];
    for _ in 0..POSES {
        // From the middle two thirds of each range, to leave room for the motion.
        let q0: Vec<f64> = (0..problem.bounds.chain.len())
            .map(|j| {
                let (min, max) = (limits.q_min[j] + margin, limits.q_max[j] - margin);
                0.5 * (min + max) + rng.random_range(-1.0..1.0) * (max - min) / 3.0
            })
            .collect();
        match check_pose(problem, &any, &q0) {
            Ok(()) => return Ok(q0),
            Err(_) => last = problem.bounds.chain.end_effector(&q0).into(),
        }
    }
    Err(ExciteError::NoStart { tried: POSES, last })
}

/// A random motion, every joint scaled to its limits, then all of them shrunk until the whole motion is feasible.
fn feasible_random(
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
    shrink(fourier, |fourier| coarse(problem, fourier, search.samples))
}

/// Shrinks the whole motion about its start pose until it keeps the limits.
fn shrink(mut fourier: Fourier, check: impl Fn(&Fourier) -> Check) -> Result<Fourier, ExciteError> {
    let mut broken: Option<Peak> = None;
    for _ in 0..SHRINKINGS {
        match check(&fourier).violations().next() {
            None => return Ok(fourier),
            Some(violation) => broken = Some(*violation),
        }
        for j in 0..fourier.joints() {
            fourier.scale_joint(j, SHRINK);
        }
    }
    match broken {
        None => Ok(fourier),
        Some(violation) => Err(ExciteError::NoMotion { violation }),
    }
}

/// A neighbour: the amplitudes of one joint (or, one time in four, of all) and, when it is free, the start pose move by `step`.
fn perturbed(problem: &Problem, from: &Fourier, step: f64, rng: &mut ChaCha8Rng) -> Fourier {
    let mut to = from.clone();
    let n = to.joints();
    let all = rng.random_range(0..4) == 0;
    let one = rng.random_range(0..n);
    // A step in all joints at once is shared among them.
    let step = if all { step / (n as f64).sqrt() } else { step };
    for j in (0..n).filter(|&j| all || j == one) {
        for k in 0..to.harmonics() {
            let size = 0.5 * step / (k + 1) as f64;
            to.a[(j, k)] += size * normal(rng);
            to.b[(j, k)] += size * normal(rng);
        }
        if problem.q0.is_none() {
            let margin = problem.bounds.margins.position;
            let (min, max) = (problem.bounds.limits.q_min[j] + margin, problem.bounds.limits.q_max[j] - margin);
            to.q0[j] = (to.q0[j] + 0.5 * step * normal(rng)).clamp(min, max);
        }
    }
    to.project();
    to
}

/// Scales down the joints that left their own limits; what the end effector does is checked afterwards.
fn fit_joints(problem: &Problem, fourier: &mut Fourier, samples: usize) {
    for j in 0..fourier.joints() {
        let factor = room(problem, fourier, j, samples);
        if factor < 1.0 {
            fourier.scale_joint(j, factor);
        }
    }
}

/// Largest factor by which joint `j` can be scaled within its range, speed, acceleration and jerk.
fn room(problem: &Problem, fourier: &Fourier, j: usize, samples: usize) -> f64 {
    let (limits, margins) = (problem.bounds.limits, &problem.bounds.margins);
    let q0 = fourier.q0[j];
    let (up, down) = (limits.q_max[j] - margins.position - q0, q0 - limits.q_min[j] - margins.position);
    let mut factor = f64::INFINITY;
    for k in 0..samples {
        let point = fourier.at(j, k as f64 * fourier.period / samples as f64);
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
    if factor.is_finite() { COARSE_ROOM * factor } else { 1.0 }
}

fn coarse(problem: &Problem, fourier: &Fourier, samples: usize) -> Check {
    check(&problem.bounds, fourier, samples, problem.torque)
}

/// Holds the motion to every limit at 1 kHz and writes the plan.
fn finish(problem: &Problem, search: &Search, fourier: Fourier) -> Result<Plan, ExciteError> {
    let fourier = shrink(fourier, |fourier| verify(&problem.bounds, fourier, problem.torque))?;
    let motion = sampled(&fourier, &problem.mounting.gravity(), 5 * search.samples);
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
        constraints: Constraints::of(&problem.bounds, problem.torque.is_some()),
    })
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}
