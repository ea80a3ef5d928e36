//! The excitation optimiser on a Panda on a wall: its gradient is exact, and what it finds is good, held to every limit, and repeats.

use plumbline::store::ModelFile;
use plumbline_core::{Limits, MAX_JOINTS};
use plumbline_excite::{
    Bounds, Criterion, Grid, Margins, Nominal, Objective, Problem, Progress, Quantity, Search, SearchControl,
    Smoothing, optimise, random_plan, stacked_conditions, verify_with_guard,
};
use plumbline_model::{Mounting, Reduction, Robot, Structure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::path::Path;
use std::slice::from_ref;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

/// An arm with everything that a motion can be held to.
struct Arm {
    robot: Robot,
    limits: Limits,
    structure: Structure,
    nominal: Nominal,
    sigma: Vec<f64>,
}

impl Arm {
    fn of(robot: Robot, nominal: Nominal) -> Arm {
        let chain = robot.chain.clone();
        let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &["friction"]).unwrap();
        let sigma = robot.limits.tau[..chain.len()].iter().map(|tau| tau * 1e-3).collect();
        Arm { limits: robot.limits, structure, nominal, sigma, robot }
    }

    fn panda() -> Arm {
        let robot = Robot::load("panda", None).unwrap();
        let file = Path::new("config/models/panda-paper-table3.toml");
        let model = ModelFile::load(file, |_| Ok(robot.chain.clone())).unwrap().model;
        Arm::of(robot, Nominal::of(&model).unwrap())
    }

    fn problem<'a>(&'a self, q0: Option<&'a [f64]>) -> Problem<'a> {
        let Robot { chain, workspace, shape, envelope, .. } = &self.robot;
        let bounds = Bounds {
            workspace: Some(workspace),
            shape: Some(shape),
            links_in_box: true,
            envelope: envelope.as_ref(),
            ..Bounds::new(chain, &self.limits, Margins::default())
        };
        let (structure, sigma) = (&self.structure, self.sigma.as_slice());
        let nominal = Some(&self.nominal);
        Problem { robot: "arm", structure, mounting: Mounting::WALL, bounds, nominal, sigma, q0 }
    }
}

/// The whole function, criterion and every kind of constraint, against central differences. The limits are tightened until all of
/// them pull.
#[test]
fn the_gradient_agrees_with_central_differences() {
    let mut arms = [Arm::panda(), Arm::of(Robot::load("fr3", None).unwrap(), Arm::panda().nominal)];
    let start = [0.1, -0.4, 0.2, -1.9, -0.1, 1.9, 0.3];
    for (index, criterion) in Criterion::ALL.into_iter().enumerate() {
        let arm = &mut arms[index % 2];
        arm.limits.tau = [8.0; MAX_JOINTS];
        arm.limits.dtau = [12.0; MAX_JOINTS];
        arm.limits.jerk = [4.0; MAX_JOINTS];
        let q0 = (index == 3).then_some(start.as_slice());
        let mut problem = arm.problem(q0);
        problem.bounds.margins.clearance = 0.3;
        problem.bounds.margins.workspace = 0.3;
        let mut rng = ChaCha8Rng::seed_from_u64(index as u64);
        let grid = Grid::new(6.0, 5, 31);
        let prior = grid.fourier(&start, &(0..49).map(|_| rng.random_range(-0.3..0.3)).collect::<Vec<_>>());
        let mut objective = Objective::new(&problem, grid, criterion).unwrap();
        if index % 2 == 1 {
            objective = objective.with_prior(&[prior]);
        }
        objective.smoothing = Smoothing { p: 3.0, sign: 5.0 };
        let n = objective.unknowns();
        assert_eq!(n, if q0.is_some() { 49 } else { 56 });
        let mut x: Vec<f64> = (0..n).map(|_| rng.random_range(-0.6..0.6)).collect();
        if q0.is_none() {
            x[49..].iter_mut().zip(&start).for_each(|(x, q)| *x += q);
        }
        // A first walk leaves multipliers behind.
        let mut gradient = vec![0.0; n];
        assert!(objective.evaluate(&x, &mut gradient).is_finite());
        objective.constraints.update(4.0);
        let value = objective.evaluate(&x, &mut gradient);
        assert!(value.is_finite() && objective.constraints.psi() > 1.0, "{criterion:?}: constraints that pull");
        let h = 1e-6;
        for i in 0..n {
            let mut there = |by: f64| {
                let mut x = x.clone();
                x[i] += by;
                objective.evaluate(&x, &mut vec![0.0; n])
            };
            let difference = (there(h) - there(-h)) / (2.0 * h);
            let scale = difference.abs().max(value.abs());
            let error = (gradient[i] - difference).abs() / scale;
            assert!(error < 2e-6, "{criterion:?}, unknown {i}: {} {difference}", gradient[i]);
        }
    }
}

fn short() -> Search {
    Search { starts: 4, rounds: 1, samples: 60, seed: 5, ..Search::default() }
}

#[test]
fn a_search_improves_keeps_every_limit_and_repeats_by_seed_on_any_number_of_threads() {
    let arm = Arm::panda();
    let problem = arm.problem(None);
    let seen = Mutex::new(Vec::new());
    let hear = |now: Progress| seen.lock().unwrap().push(now);
    let plan =
        optimise(&problem, &short(), &[], &SearchControl { threads: 1, stop: &|| false, progress: &hear }).unwrap();
    let seen = seen.into_inner().unwrap();
    assert!(seen.windows(2).all(|w| w[1].best <= w[0].best && w[1].done > w[0].done));
    let last = seen.last().unwrap();
    assert_eq!(last.done, last.of);
    assert!((last.best / plan.conditions.raw - 1.0).abs() < 1e-9, "{} {}", last.best, plan.conditions.raw);

    // Its course ends with the motion that was found.
    let course = plan.search.as_ref().unwrap();
    assert_eq!((course.criterion, course.best.len()), (Criterion::Raw, course.evaluations.len()));
    assert!(course.best.windows(2).all(|w| w[1] <= w[0]) && course.evaluations.windows(2).all(|w| w[1] > w[0]));
    assert!((course.best.last().unwrap() / plan.conditions.raw - 1.0).abs() < 1e-9, "{course:?}");
    assert!(course.evaluations[0] > 100 && course.best.len() <= 1 + 1 + 1, "{course:?}");

    let fourier = plan.fourier().unwrap();
    let check = verify_with_guard(&problem, &fourier);
    assert!(check.is_feasible());
    for kind in
        [Quantity::Jerk, Quantity::TorqueRate, Quantity::BaseSphere, Quantity::LinkBoxMin(2), Quantity::Clearance(0, 7)]
    {
        assert!(check.peaks.iter().any(|peak| peak.quantity == kind), "{kind:?} was not asked");
    }
    assert!(fourier.boundary_error().iter().all(|&error| error < 1e-9));
    assert!(plan.constraints.tau.is_some());
    // Random motions have some hundreds; a random search of some seconds 58.
    let any = random_plan(&problem, &short(), 1.0).unwrap();
    assert!(plan.conditions.raw < 50.0 && any.conditions.raw > 100.0, "{} {}", plan.conditions.raw, any.conditions.raw);
    assert_eq!(any.search, None);

    assert_eq!(optimise(&problem, &short(), &[], &SearchControl::with_threads(3)).unwrap(), plan);
    let other = optimise(&problem, &Search { seed: 6, ..short() }, &[], &SearchControl::with_threads(2)).unwrap();
    assert_ne!(plan.a, other.a);
}

#[test]
#[ignore = "hil/long-tests/run.sh"]
fn each_criterion_is_lowest_after_its_own_search() {
    let arm = Arm::panda();
    let problem = arm.problem(None);
    let search = |criterion| Search { criterion, starts: 2, rounds: 0, ..short() };
    let found = Criterion::ALL.map(|criterion| {
        optimise(&problem, &search(criterion), &[], &SearchControl::with_threads(2)).unwrap().conditions
    });
    let [raw, rigid, equilibrated, weighted, log_det] = found;
    let others = [raw, rigid, weighted, log_det];
    assert!(others.iter().all(|other| equilibrated.equilibrated < 0.8 * other.equilibrated), "{found:?}");
    assert!([raw, equilibrated, log_det].iter().all(|other| weighted.weighted < other.weighted), "{found:?}");
    assert!([equilibrated, weighted, log_det].iter().all(|other| raw.raw < other.raw), "{found:?}");
    assert!([raw, equilibrated, log_det].iter().all(|other| rigid.raw_rigid < other.raw_rigid), "{found:?}");
}

#[test]
fn a_stopped_search_keeps_a_motion_inside_every_limit() {
    let arm = Arm::panda();
    let problem = arm.problem(None);
    for after in [0, 3, 9] {
        let asked = AtomicUsize::new(0);
        let stop = || asked.fetch_add(1, Ordering::Relaxed) >= after;
        let plan =
            optimise(&problem, &short(), &[], &SearchControl { threads: 1, stop: &stop, progress: &|_| {} }).unwrap();
        assert!(verify_with_guard(&problem, &plan.fourier().unwrap()).is_feasible());
    }
}

#[test]
fn a_second_motion_complements_the_first() {
    let arm = Arm::panda();
    let problem = arm.problem(None);
    let search = Search { starts: 2, rounds: 0, ..short() };
    let find = |seed, prior: &[_]| {
        optimise(&problem, &Search { seed, ..search.clone() }, prior, &SearchControl::with_threads(2))
            .unwrap()
            .fourier()
            .unwrap()
    };
    let first = find(1, &[]);
    let alone = stacked_conditions(&problem, from_ref(&first)).raw;
    let second = find(2, from_ref(&first));
    let both = stacked_conditions(&problem, &[first.clone(), second]).raw;
    let any = stacked_conditions(&problem, &[first.clone(), find(2, &[])]).raw;
    assert!(both < 0.9 * alone && both < any, "{alone} alone, {both} with its complement, {any} with any other");
}
