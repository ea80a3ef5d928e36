//! Search of a motion by a score that has no gradient: random motions of several sizes, the best of which are perturbed.

use super::ExciteError;
use super::fourier::Fourier;
use super::plan::Plan;
use super::search::{Problem, Progress, Search, SearchControl, normal, plan_of, random_motion, shrunk, validate};
use super::usage::{check_usage, usage};
use plumbline_core::parallel;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use std::ops::Range;

/// Shares of every joint's range of motion that the random motions use in turn: effects of friction show at low speeds and small strokes, those of
/// inertia and load at large ones.
const AMPLITUDES: [f64; 4] = [0.95, 0.5, 0.25, 0.12];
/// Number of best motions that a round starts from, and perturbations of each.
const ELITES: usize = 2;
const PERTURBATIONS: usize = 4;
/// Perturbation sizes in turn, as shares of a motion's amplitudes, and of 1 rad for the start pose.
const PERTURBATION_RATIOS: [f64; 4] = [0.05, 0.1, 0.2, 0.4];

/// A feasible motion with its score.
struct Scored {
    fourier: Fourier,
    score: f64,
}

/// The motion with the largest `score` among `search.starts` random ones and those of `search.rounds` rounds of perturbing the best. `score` is `None`
/// for a motion that it can't judge. Joints outside `moving` (from 0) stay at the start pose. The result satisfies every limit at 1 kHz and depends on the
/// seed, not on the number of threads.
///
/// # Errors
/// An invalid problem; no feasible motion with a score.
pub fn best_by_score(
    problem: &Problem,
    search: &Search,
    moving: Range<usize>,
    score: &(dyn Fn(&Fourier) -> Option<f64> + Sync),
    control: &SearchControl,
) -> Result<Plan, ExciteError> {
    validate(problem, search)?;
    let done = std::sync::atomic::AtomicUsize::new(0);
    let of = search.starts + search.rounds * ELITES * PERTURBATIONS;
    let judged = |mut fourier: Fourier| -> Result<Option<Scored>, ExciteError> {
        let still = (0..fourier.joints()).filter(|j| !moving.contains(j));
        still.for_each(|j| fourier.scale_joint(j, 0.0));
        let fourier = shrunk(problem, fourier, search.samples)?;
        let mut used = usage(&problem.bounds, &fourier);
        // A joint that is to stay is not frozen.
        if let Some(first) = used.get(moving.clone()).and_then(<[_]>::first).copied() {
            (0..used.len()).filter(|j| !moving.contains(j)).for_each(|j| used[j] = first);
        }
        check_usage(&used, None, 1)?;
        Ok(score(&fourier).filter(|score| score.is_finite()).map(|score| Scored { fourier, score }))
    };
    let counted = |found: Result<Option<Scored>, ExciteError>| {
        let done = 1 + done.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        (control.progress)(Progress { done, of, best: f64::INFINITY });
        found
    };
    let random = |k: &usize| {
        if (control.stop)() {
            return Ok(None);
        }
        let mut rng = stream(search.seed, *k);
        random_motion(problem, search, AMPLITUDES[k % AMPLITUDES.len()], &mut rng).and_then(judged)
    };
    let starts: Vec<usize> = (0..search.starts).collect();
    let mut best: Vec<Scored> = Vec::new();
    let mut first_error = None;
    for found in parallel(&starts, control.threads, |k| counted(random(k))) {
        match found {
            Ok(found) => best.extend(found),
            Err(error) => first_error = first_error.or(Some(error)),
        }
    }
    for round in 0..search.rounds {
        best.sort_by(|a, b| b.score.total_cmp(&a.score));
        best.truncate(ELITES);
        if (control.stop)() {
            break;
        }
        let tries: Vec<(usize, usize)> =
            (0..best.len()).flat_map(|elite| (0..PERTURBATIONS).map(move |k| (elite, k))).collect();
        let perturb = |&(elite, k): &(usize, usize)| {
            let number = search.starts + (round * ELITES + elite) * PERTURBATIONS + k;
            let ratio = PERTURBATION_RATIOS[k % PERTURBATION_RATIOS.len()];
            let moved = perturbed(problem, &best[elite].fourier, ratio, &mut stream(search.seed, number));
            counted(judged(moved))
        };
        let found = parallel(&tries, control.threads, perturb);
        best.extend(found.into_iter().filter_map(|found| found.ok().flatten()));
    }
    let found = best.into_iter().max_by(|a, b| a.score.total_cmp(&b.score));
    match (found, first_error) {
        (Some(Scored { fourier, .. }), _) => plan_of(problem, search, fourier),
        (None, Some(error)) => Err(error),
        (None, None) => Err(ExciteError::Budget { starts: search.starts, samples: search.samples }),
    }
}

/// A motion with other amplitudes, and about another start pose where that is free.
fn perturbed(problem: &Problem, fourier: &Fourier, ratio: f64, rng: &mut ChaCha8Rng) -> Fourier {
    let mut moved = fourier.clone();
    for j in 0..moved.joints() {
        let size = (fourier.a.row(j).norm_squared() + fourier.b.row(j).norm_squared()).sqrt();
        let size = ratio * size / (2.0 * moved.harmonics() as f64).sqrt();
        for k in 0..moved.harmonics() {
            moved.a[(j, k)] += size * normal(rng);
            moved.b[(j, k)] += size * normal(rng);
        }
        if problem.q0.is_none() {
            moved.q0[j] += ratio * normal(rng);
        }
    }
    moved.project();
    moved
}

/// The random numbers of one motion of a search.
fn stream(seed: u64, number: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(number as u64);
    rng
}
