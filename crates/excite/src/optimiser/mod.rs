//! The excitation optimiser: many starts, each a descent with exact gradients under hard constraints, on all cores.
//!
//! The problem has many local minima, so a search goes in three steps: every start is descended a little way with a smooth surrogate
//! (a sketch); of every eight the best two are seen through; then, in rounds, the best motions so far are shaken and descended again (hops).
//!
//! | file | what |
//! |---|---|
//! | [`grid`] | unknowns of a motion at rest at its ends, and their samples |
//! | [`adjoint`] | regressor of one sample and its reverse mode |
//! | [`columns`] | which columns a row of the regressor has |
//! | [`spectral`] | smooth functions of `M = W' W` and their gradients |
//! | [`held`], [`caps`] | constraints by an augmented Lagrangian, and what they are held to |
//! | [`objective`] | all of it as one function with gradient |
//! | [`descent`] | BFGS |
//! | [`crew`] | work shared among threads, its result independent of their number |

pub mod adjoint;
pub mod caps;
pub mod columns;
pub mod crew;
pub mod descent;
pub mod grid;
pub mod held;
pub mod objective;
pub mod spectral;

use super::ExciteError;
use super::criterion::{check_excitation, sampled, stacked};
use super::fourier::Fourier;
use super::plan::Plan;
use super::search::{self, Problem, Search, SearchControl};
use super::usage::{check_usage, usage};
use crew::Crew;
use descent::Descent;
use grid::Grid;
use objective::{Objective, Smoothing};
use plumbline_model::term::Motion;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

/// One leg of a descent: order of the surrogate, slope of the smoothed sign, penalty, most iterations.
#[derive(Clone, Copy)]
struct Leg {
    p: f64,
    sign: f64,
    rho: f64,
    iterations: usize,
}

/// The sketch: a smooth surrogate with soft constraints.
const SKETCH: [Leg; 2] =
    [Leg { p: 1.0, sign: 10.0, rho: 3.0, iterations: 40 }, Leg { p: 8.0, sign: 20.0, rho: 30.0, iterations: 60 }];
/// The rest of the way: a sharp surrogate with hard constraints.
const FINISH: [Leg; 3] = [
    Leg { p: 16.0, sign: 25.0, rho: 100.0, iterations: 150 },
    Leg { p: 64.0, sign: 40.0, rho: 100.0, iterations: 200 },
    LAST,
];
/// What a shaken motion goes through.
const HOP: [Leg; 3] = [
    Leg { p: 8.0, sign: 20.0, rho: 30.0, iterations: 60 },
    Leg { p: 24.0, sign: 30.0, rho: 100.0, iterations: 120 },
    LAST,
];
/// The last leg of both, and of every round of `settle`.
const LAST: Leg = Leg { p: 96.0, sign: 60.0, rho: 300.0, iterations: 150 };
/// Gain of the logarithm of a condition number that is not worth another step.
const TOLERANCE: f64 = 3e-6;
/// Rounds in which what the grid did not see is taken off, and iterations of each.
const ROUNDS: usize = 5;
const ROUND_ITERATIONS: usize = 50;
/// Starts are sketched in groups of so many, so that the first finished motion is there soon.
const GROUP: usize = 8;
/// Starts that are added one by one while none has led to a motion.
const SPARE: usize = 16;
/// One sketch of so many is seen through; a round of hops has one hop for so many starts.
const KEPT: usize = 4;
/// How many of the best motions hops start from.
const ELITES: usize = 4;
/// Sizes that a motion is shaken by, in shares of its own amplitude.
const SHAKES: [f64; 4] = [0.05, 0.1, 0.2, 0.4];
/// Start poses are shaken by the same shares of this \[rad\].
const POSE_SHAKE: f64 = 1.0;
/// Samples of the grid on which a finished motion is judged, per sample of the search's grid.
pub const FINE: usize = 5;

/// A motion on its way: its cost (a logarithm, lower is better) and its unknowns' motion.
#[derive(Clone)]
struct Found {
    cost: f64,
    fourier: Fourier,
}

/// Searches for the motion with the best criterion; together with the motions of `prior`, when there are any. The result keeps every
/// limit at 1 kHz, or it is an error.
///
/// Every start and every hop draws its random numbers from a stream of its own, so the result depends on the seed and the numbers of
/// starts and rounds, not on the number of threads. It depends on time when `watch.stop` does.
pub fn optimise(
    problem: &Problem,
    search: &Search,
    prior: &[Fourier],
    watch: &SearchControl,
) -> Result<Plan, ExciteError> {
    search::validate(problem, search)?;
    let hops = search.starts.div_ceil(KEPT);
    let groups = (0..search.starts).step_by(GROUP).map(|first| GROUP.min(search.starts - first).div_ceil(KEPT));
    let crew = Crew::new(watch, search.starts + 3 * (groups.sum::<usize>() + hops * search.rounds));
    let task = Task { problem, search, prior, watch };

    let mut best: Vec<Found> = Vec::new();
    let mut trouble = None;
    let mut first = 0;
    while first < search.starts || (best.is_empty() && first < search.starts + SPARE) {
        let count = GROUP.min(search.starts.saturating_sub(first)).max(1);
        let (mut sketches, errors) = sorted(crew.map(count, 1, |index| task.sketch(first + index)));
        sketches.truncate(count.div_ceil(KEPT));
        let finish = |index: usize| crew.told(task.descend(&sketches[index].fourier, &FINISH));
        let (finished, more) = sorted(crew.map(sketches.len(), 3, finish));
        best.extend(finished);
        trouble = trouble.or(errors).or(more);
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
            let shaken = shake(&best[index % best.len()].fourier, search.samples, problem.q0.is_none(), &mut rng);
            crew.told(task.descend(&shaken, &HOP))
        };
        let (finished, _) = sorted(crew.map(hops, 3, hop));
        best.extend(finished);
    }
    best.sort_by(|one, other| one.cost.total_cmp(&other.cost));
    match best.into_iter().next() {
        Some(found) => {
            check_excitation(problem.structure, &task.with_prior(&found.fourier))?;
            search::plan_of(problem, search, found.fourier)
        }
        None => Err(trouble.unwrap_or(ExciteError::Budget { starts: search.starts, samples: search.samples })),
    }
}

/// What was found, best first, and the first error.
fn sorted(results: Vec<Result<Found, ExciteError>>) -> (Vec<Found>, Option<ExciteError>) {
    let mut found = Vec::new();
    let mut trouble = None;
    for result in results {
        match result {
            Ok(motion) => found.push(motion),
            Err(error) => trouble = trouble.or(Some(error)),
        }
    }
    found.sort_by(|one, other| one.cost.total_cmp(&other.cost));
    (found, trouble)
}

/// What all descents of a search share.
struct Task<'a> {
    problem: &'a Problem<'a>,
    search: &'a Search,
    prior: &'a [Fourier],
    watch: &'a SearchControl<'a>,
}

impl Task<'_> {
    /// Random numbers of one descent of one round; round 0 are the sketches.
    fn stream(&self, round: usize, index: usize) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.search.seed);
        rng.set_stream(((round as u64) << 32) | index as u64);
        rng
    }

    fn objective(&self) -> Result<Objective<'_>, ExciteError> {
        let grid = Grid::new(self.search.period, self.search.harmonics, self.search.samples);
        Ok(Objective::new(self.problem, grid, self.search.criterion)?.with_prior(self.prior))
    }

    /// A random start and the first legs.
    fn sketch(&self, index: usize) -> Result<Found, ExciteError> {
        let first = search::random_motion(self.problem, self.search, 1.0, &mut self.stream(0, index))?;
        let mut objective = self.objective()?;
        let mut descent = Descent::new(objective.pack(&first));
        let mut cost = f64::INFINITY;
        for leg in SKETCH {
            cost = self.leg(&mut objective, &mut descent, leg);
        }
        Ok(Found { cost, fourier: objective.unpack(descent.x()) })
    }

    /// Legs from a motion on, then the way to one that keeps every limit between the samples of the grid, too.
    fn descend(&self, from: &Fourier, legs: &[Leg]) -> Result<Found, ExciteError> {
        let mut objective = self.objective()?;
        let mut descent = Descent::new(objective.pack(from));
        for &leg in legs {
            if (self.watch.stop)() {
                break;
            }
            self.leg(&mut objective, &mut descent, leg);
        }
        let fourier = self.settle(&mut objective, &mut descent)?;
        check_usage(&usage(&self.problem.bounds, &fourier), None, 1)?;
        let motion = self.with_prior(&fourier);
        let cost = self.search.criterion.value(self.problem.structure, &motion, self.problem.sigma);
        if !cost.is_finite() {
            check_excitation(self.problem.structure, &motion)?;
        }
        Ok(Found { cost, fourier })
    }

    fn leg(&self, objective: &mut Objective, descent: &mut Descent, leg: Leg) -> f64 {
        objective.sharpness = Smoothing { p: leg.p, sign: leg.sign };
        objective.held.update(leg.rho);
        descent.run(leg.iterations, TOLERANCE, |x, gradient| objective.evaluate(x, gradient)).0
    }

    /// Tightens what is broken at 1 kHz and descends again, until nothing is; at last shrinks the motion about its start.
    fn settle(&self, objective: &mut Objective, descent: &mut Descent) -> Result<Fourier, ExciteError> {
        for _ in 0..ROUNDS {
            let fourier = objective.unpack(descent.x());
            let check = search::verify_with_guard(self.problem, &fourier);
            if check.is_feasible() {
                return Ok(fourier);
            }
            if (self.watch.stop)() {
                break;
            }
            objective.caps.tighten(&check);
            self.leg(objective, descent, Leg { iterations: ROUND_ITERATIONS, ..LAST });
        }
        search::shrink(objective.unpack(descent.x()), |fourier| search::verify_with_guard(self.problem, fourier))
    }

    /// A motion on a fine grid, after those of `prior`: what the criterion is taken of.
    fn with_prior(&self, fourier: &Fourier) -> Motion {
        let gravity = self.problem.mounting.gravity();
        let fine = |fourier: &Fourier| sampled(fourier, &gravity, FINE * self.search.samples);
        let motions: Vec<_> = self.prior.iter().chain([fourier]).map(fine).collect();
        stacked(&motions)
    }
}

/// A neighbour of a motion: all amplitudes, and the start pose where it is free, moved at random.
fn shake(fourier: &Fourier, samples: usize, free: bool, rng: &mut ChaCha8Rng) -> Fourier {
    let grid = Grid::new(fourier.period, fourier.harmonics(), samples);
    let mut x = grid.coordinates(fourier);
    let size = SHAKES[rng.random_range(0..SHAKES.len())];
    let amplitude = (x.iter().map(|x| x * x).sum::<f64>() / x.len() as f64).sqrt();
    let mut normal = || -> f64 { StandardNormal.sample(rng) };
    x.iter_mut().for_each(|x| *x += size * amplitude * normal());
    let mut q0 = fourier.q0.clone();
    if free {
        q0.iter_mut().for_each(|q| *q += size * POSE_SHAKE * normal());
    }
    grid.fourier(&q0, &x)
}
