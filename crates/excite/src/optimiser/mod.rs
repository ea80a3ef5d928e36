//! Excitation optimiser: multi-start descent with exact gradients under constraints, on all cores.
//!
//! The problem has many local minima. A search has three steps: a short descent of every random start with a smooth surrogate (a sketch);
//! a full descent of the best two of every eight; then rounds of basin hopping: the best motions are perturbed and descended again (hops).
//!
//! | file | what |
//! |---|---|
//! | [`grid`] | unknowns of a motion that starts and ends at rest, and their samples |
//! | [`adjoint`] | regressor of one sample and its reverse mode |
//! | [`columns`] | nonzero columns of each row of the regressor |
//! | [`spectral`] | smooth functions of `M = W' W` and their gradients |
//! | [`augmented_lagrangian`], [`grid_limits`] | constraints by an augmented Lagrangian, and their limits on the grid |
//! | [`objective`] | surrogate and constraints as one function with gradient |
//! | [`descent`] | BFGS |
//! | [`workers`] | worker threads; results do not depend on their number |

pub mod adjoint;
pub mod augmented_lagrangian;
pub mod columns;
pub mod descent;
pub mod grid;
pub mod grid_limits;
pub mod objective;
pub mod spectral;
pub mod workers;

use super::ExciteError;
use super::criterion::{check_excitation, sampled, stacked};
use super::fourier::Fourier;
use super::plan::{Plan, PlanSearch};
use super::search::{self, FINE_GRID_RATIO, Problem, Search, SearchControl};
use super::usage::{check_usage, usage};
use descent::Descent;
use grid::Grid;
use objective::{Objective, Smoothing};
use plumbline_model::term::Motion;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::sync::atomic::{AtomicU64, Ordering};
use workers::Workers;

/// Stage of a descent: order of the surrogate, slope of the smoothed sign, penalty, maximum iterations.
#[derive(Clone, Copy)]
struct Stage {
    p: f64,
    sign: f64,
    rho: f64,
    iterations: usize,
}

/// Stages of a sketch: smooth surrogate, soft constraints.
const SKETCH: [Stage; 2] =
    [Stage { p: 1.0, sign: 10.0, rho: 3.0, iterations: 40 }, Stage { p: 8.0, sign: 20.0, rho: 30.0, iterations: 60 }];
/// Stages of a full descent: sharp surrogate, hard constraints.
const FINISH: [Stage; 3] = [
    Stage { p: 16.0, sign: 25.0, rho: 100.0, iterations: 150 },
    Stage { p: 64.0, sign: 40.0, rho: 100.0, iterations: 200 },
    LAST,
];
const HOP: [Stage; 3] = [
    Stage { p: 8.0, sign: 20.0, rho: 30.0, iterations: 60 },
    Stage { p: 24.0, sign: 30.0, rho: 100.0, iterations: 120 },
    LAST,
];
/// Last stage of both, and of every round of `make_feasible`.
const LAST: Stage = Stage { p: 96.0, sign: 60.0, rho: 300.0, iterations: 150 };
/// Convergence tolerance on the logarithm of a condition number.
const TOLERANCE: f64 = 3e-6;
/// Maximum rounds of tightening violations between grid samples, and iterations of each.
const MAX_ROUNDS: usize = 5;
const ROUND_ITERATIONS: usize = 50;
/// Starts per group; a group is finished before the next starts, so that a first motion is available early.
const GROUP_STARTS: usize = 8;
/// Maximum additional starts while no start has led to a motion.
const MAX_EXTRA_STARTS: usize = 16;
/// Sketches per full descent; starts per hop of a round.
const STARTS_PER_DESCENT: usize = 4;
/// Number of best motions that hops start from.
const ELITES: usize = 4;
/// Perturbation sizes as ratios of a motion's amplitude.
const PERTURBATION_RATIOS: [f64; 4] = [0.05, 0.1, 0.2, 0.4];
/// Perturbation of start poses at ratio 1 \[rad\].
const POSE_PERTURBATION_RAD: f64 = 1.0;
/// Motion found by a descent with its cost (a logarithm, lower is better).
#[derive(Clone)]
struct Found {
    cost: f64,
    fourier: Fourier,
}

/// Searches for the motion with the best criterion, stacked with the motions of `prior`. The result satisfies every limit at 1 kHz.
///
/// Every start and every hop has its own random stream: the result depends on the seed and the numbers of starts and rounds, not on the
/// number of threads. It depends on time when `control.stop` does.
///
/// # Errors
/// An invalid problem; no feasible motion; undetermined parameters.
pub fn optimise(
    problem: &Problem,
    search: &Search,
    prior: &[Fourier],
    watch: &SearchControl,
) -> Result<Plan, ExciteError> {
    search::validate(problem, search)?;
    let hops = search.starts.div_ceil(STARTS_PER_DESCENT);
    let groups = (0..search.starts)
        .step_by(GROUP_STARTS)
        .map(|first| GROUP_STARTS.min(search.starts - first).div_ceil(STARTS_PER_DESCENT));
    let workers = Workers::new(watch, search.starts + 3 * (groups.sum::<usize>() + hops * search.rounds));
    let task = Task { problem, search, prior, watch, evaluations: AtomicU64::new(0) };

    let mut best: Vec<Found> = Vec::new();
    let mut course = PlanSearch::new(search.criterion);
    let mut first_error = None;
    let mut first = 0;
    while first < search.starts || (best.is_empty() && first < search.starts + MAX_EXTRA_STARTS) {
        let count = GROUP_STARTS.min(search.starts.saturating_sub(first)).max(1);
        let (mut sketches, errors) = sorted(workers.map(count, 1, |index| task.sketch(first + index)));
        sketches.truncate(count.div_ceil(STARTS_PER_DESCENT));
        let finish = |index: usize| workers.report(task.descend(&sketches[index].fourier, &FINISH));
        let (finished, more) = sorted(workers.map(sketches.len(), 3, finish));
        best.extend(finished);
        task.note(&best, &mut course);
        first_error = first_error.or(errors).or(more);
        first += count;
        if (watch.stop)() && (!best.is_empty() || first >= search.starts) {
            break;
        }
    }
    for round in 1..=search.rounds {
        best.sort_by(|one, other| one.cost.total_cmp(&other.cost));
        best.truncate(ELITES);
        if best.is_empty() || (watch.stop)() {
            break;
        }
        let hop = |index: usize| {
            let mut rng = task.stream(round, index);
            let perturbed = perturb(&best[index % best.len()].fourier, search.samples, problem.q0.is_none(), &mut rng);
            workers.report(task.descend(&perturbed, &HOP))
        };
        let (finished, _) = sorted(workers.map(hops, 3, hop));
        best.extend(finished);
        task.note(&best, &mut course);
    }
    best.sort_by(|one, other| one.cost.total_cmp(&other.cost));
    match best.into_iter().next() {
        Some(found) => {
            check_excitation(problem.structure, &task.with_prior(&found.fourier))?;
            let course = course.end(task.evaluations());
            search::plan_of(problem, search, found.fourier).map(|plan| Plan { search: Some(course), ..plan })
        }
        None => Err(first_error.unwrap_or(ExciteError::Budget { starts: search.starts, samples: search.samples })),
    }
}

/// The found motions, best first, and the first error.
fn sorted(results: Vec<Result<Found, ExciteError>>) -> (Vec<Found>, Option<ExciteError>) {
    let mut found = Vec::new();
    let mut first_error = None;
    for result in results {
        match result {
            Ok(motion) => found.push(motion),
            Err(error) => first_error = first_error.or(Some(error)),
        }
    }
    found.sort_by(|one, other| one.cost.total_cmp(&other.cost));
    (found, first_error)
}

/// Common data of all descents of a search.
struct Task<'a> {
    problem: &'a Problem<'a>,
    search: &'a Search,
    prior: &'a [Fourier],
    watch: &'a SearchControl<'a>,
    /// Evaluations of the objective in all descents. Their sum after a group of descents does not depend on the number of threads.
    evaluations: AtomicU64,
}

impl Task<'_> {
    fn evaluations(&self) -> u64 {
        self.evaluations.load(Ordering::Relaxed)
    }

    /// Adds the best motion so far to the course of the search, when no descent is running.
    fn note(&self, best: &[Found], course: &mut PlanSearch) {
        if let Some(cost) = best.iter().map(|found| found.cost).reduce(f64::min) {
            course.add(self.evaluations(), cost.exp());
        }
    }

    /// Random numbers of one descent of one round; round 0 is the sketches.
    fn stream(&self, round: usize, index: usize) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.search.seed);
        rng.set_stream(((round as u64) << 32) | index as u64);
        rng
    }

    fn objective(&self) -> Result<Objective<'_>, ExciteError> {
        let grid = Grid::new(self.search.period, self.search.harmonics, self.search.samples);
        Ok(Objective::new(self.problem, grid, self.search.criterion)?.with_prior(self.prior))
    }

    /// Short descent of a random start.
    fn sketch(&self, index: usize) -> Result<Found, ExciteError> {
        let first = search::random_motion(self.problem, self.search, 1.0, &mut self.stream(0, index))?;
        let mut objective = self.objective()?;
        let mut descent = Descent::new(objective.pack(&first));
        let mut cost = f64::INFINITY;
        for stage in SKETCH {
            cost = self.stage(&mut objective, &mut descent, stage);
        }
        Ok(Found { cost, fourier: objective.unpack(descent.x()) })
    }

    /// Descent from a motion through `stages`, made feasible between grid samples.
    fn descend(&self, from: &Fourier, stages: &[Stage]) -> Result<Found, ExciteError> {
        let mut objective = self.objective()?;
        let mut descent = Descent::new(objective.pack(from));
        for &stage in stages {
            if (self.watch.stop)() {
                break;
            }
            self.stage(&mut objective, &mut descent, stage);
        }
        let fourier = self.make_feasible(&mut objective, &mut descent)?;
        check_usage(&usage(&self.problem.bounds, &fourier), None, 1)?;
        let motion = self.with_prior(&fourier);
        let cost = self.search.criterion.value(self.problem.structure, &motion, self.problem.sigma);
        if !cost.is_finite() {
            check_excitation(self.problem.structure, &motion)?;
        }
        Ok(Found { cost, fourier })
    }

    fn stage(&self, objective: &mut Objective, descent: &mut Descent, stage: Stage) -> f64 {
        objective.smoothing = Smoothing { p: stage.p, sign: stage.sign };
        objective.constraints.update(stage.rho);
        let evaluate = |x: &[f64], gradient: &mut [f64]| {
            self.evaluations.fetch_add(1, Ordering::Relaxed);
            objective.evaluate(x, gradient)
        };
        descent.run(stage.iterations, TOLERANCE, evaluate).0
    }

    /// Tightens the limits violated at 1 kHz and descends again until the motion is feasible; finally scales it down about its start pose.
    fn make_feasible(&self, objective: &mut Objective, descent: &mut Descent) -> Result<Fourier, ExciteError> {
        for _ in 0..MAX_ROUNDS {
            let fourier = objective.unpack(descent.x());
            let check = search::verify_with_guard(self.problem, &fourier);
            if check.is_feasible() {
                return Ok(fourier);
            }
            if (self.watch.stop)() {
                break;
            }
            objective.limits_on_grid.tighten(&check);
            self.stage(objective, descent, Stage { iterations: ROUND_ITERATIONS, ..LAST });
        }
        search::shrink(objective.unpack(descent.x()), |fourier| search::verify_with_guard(self.problem, fourier))
    }

    /// Samples of `prior` and a motion on the fine grid, for the criterion.
    fn with_prior(&self, fourier: &Fourier) -> Motion {
        let gravity = self.problem.mounting.gravity();
        let fine = |fourier: &Fourier| sampled(fourier, &gravity, FINE_GRID_RATIO * self.search.samples);
        let motions: Vec<_> = self.prior.iter().chain([fourier]).map(fine).collect();
        stacked(&motions)
    }
}

/// Random perturbation of a motion: of all amplitudes, and of the start pose where it is free.
fn perturb(fourier: &Fourier, samples: usize, free: bool, rng: &mut ChaCha8Rng) -> Fourier {
    let grid = Grid::new(fourier.period, fourier.harmonics(), samples);
    let mut x = grid.coordinates(fourier);
    let size = PERTURBATION_RATIOS[rng.random_range(0..PERTURBATION_RATIOS.len())];
    let amplitude = (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt();
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    x.iter_mut().for_each(|x| *x += size * amplitude * normal());
    let mut q0 = fourier.q0.clone();
    if free {
        q0.iter_mut().for_each(|q| *q += size * POSE_PERTURBATION_RAD * normal());
    }
    grid.fourier(&q0, &x)
}
