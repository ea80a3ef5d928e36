//! The estimator against simulated truth: a Panda with random parameters, torques from Newton-Euler (not from the regressor that
//! the estimator uses), friction, noise.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use plumbline_excite::Fourier;
use plumbline_identify::solve::{Identification, identify};
use plumbline_identify::{Experiment, Run, Settings, validate_parameters};
use plumbline_model::{BaseKind, Chain, LinkParameters, Mounting, Reduction, Robot, Structure, rnea};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

const N: usize = 7;
const DT: f64 = 1e-3;

fn panda() -> Chain {
    Robot::load("panda", None).expect("a shipped robot").chain
}

fn structure(mounting: Option<Mounting>) -> Structure {
    let chain = panda();
    let reduction = match mounting {
        Some(mounting) => Reduction::in_mounting(&chain, &mounting),
        None => Reduction::any_mounting(&chain),
    };
    Structure::of(chain, reduction, &["friction"]).unwrap()
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    StandardNormal.sample(rng)
}

/// An arm: standard parameters of every link, viscous and Coulomb friction of every joint.
struct Truth {
    links: Vec<LinkParameters>,
    fv: [f64; N],
    fc: [f64; N],
}

impl Truth {
    fn random(seed: u64) -> Truth {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let link = |rng: &mut ChaCha8Rng, i: usize| {
            let m = rng.random_range(1.0..4.0) / (1.0 + 0.3 * i as f64);
            let c = Vector3::from_fn(|_, _| rng.random_range(-0.08..0.08));
            let at_centre = m * rng.random_range(0.003..0.02);
            let eye = Matrix3::identity();
            let about: Matrix3<f64> = eye * at_centre + (eye * c.norm_squared() - c * c.transpose()) * m;
            let l = |i, j| about[(i, j)];
            [l(0, 0), l(0, 1), l(0, 2), l(1, 1), l(1, 2), l(2, 2), m * c.x, m * c.y, m * c.z, m]
        };
        let links = (0..N).map(|i| link(&mut rng, i)).collect();
        let mut draw = |low, high| std::array::from_fn(|_| rng.random_range(low..high));
        Truth { links, fv: draw(0.01, 0.1), fc: draw(0.15, 0.5) }
    }

    fn torque(&self, chain: &Chain, gravity: &Vector3<f64>, q: &[f64], dq: &[f64], ddq: &[f64]) -> [f64; N] {
        let mut tau = [0.0; N];
        rnea(chain, &self.links, gravity, q, dq, ddq, &mut tau);
        for j in 0..N {
            tau[j] += self.fv[j] * dq[j] + self.fc[j] * (100.0 * dq[j]).tanh();
        }
        tau
    }

    /// True parameters in the order of the structure's columns.
    fn beta(&self, structure: &Structure) -> Vec<f64> {
        let delta = DVector::from_iterator(10 * N, self.links.iter().flatten().copied());
        let base = structure.reduction().base_of(&delta);
        base.iter().chain(&self.fv).chain(&self.fc).copied().collect()
    }
}

fn motion(seed: u64, period: f64, harmonics: usize) -> Fourier {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let centre = [0.0, -0.3, 0.0, -1.6, 0.0, 1.8, 0.0];
    let q0 = centre.iter().map(|c| c + rng.random_range(-0.3..0.3)).collect();
    let mut draw =
        || DMatrix::from_fn(N, harmonics, |_, k| 0.55 * normal(&mut rng) / ((k + 1) as f64).powf(0.5) * period / 10.0);
    let (a, b) = (draw(), draw());
    let mut fourier = Fourier::new(period, q0, a, b).unwrap();
    fourier.project();
    fourier
}

#[derive(Clone, Copy)]
enum Noise {
    None,
    /// White, of this standard deviation.
    White(f64),
    /// First-order with a correlation time of 0.1 s, of this standard deviation.
    Coloured(f64),
}

/// A run of the arm along a motion, sampled at 1 kHz with torque noise, and 1e-5 rad of encoder noise when there is any.
fn simulate(truth: &Truth, fourier: &Fourier, periods: usize, mounting: Mounting, noise: Noise, seed: u64) -> Run {
    let chain = panda();
    let gravity = mounting.gravity();
    let samples = (fourier.period / DT).round() as usize;
    let mut q = DMatrix::zeros(periods * samples, N);
    let mut tau = DMatrix::zeros(periods * samples, N);
    for k in 0..samples {
        let points: Vec<_> = (0..N).map(|j| fourier.at(j, k as f64 * DT)).collect();
        let of = |f: fn(&plumbline_excite::Point) -> f64| points.iter().map(f).collect::<Vec<_>>();
        let clean = truth.torque(&chain, &gravity, &of(|p| p.q), &of(|p| p.dq), &of(|p| p.ddq));
        for p in 0..periods {
            for j in 0..N {
                q[(p * samples + k, j)] = points[j].q;
                tau[(p * samples + k, j)] = clean[j];
            }
        }
    }
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let pole: f64 = (-DT / 0.1_f64).exp();
    for j in 0..N {
        let mut x = normal(&mut rng);
        for k in 0..periods * samples {
            match noise {
                Noise::None => continue,
                Noise::White(std) => tau[(k, j)] += std * normal(&mut rng),
                Noise::Coloured(std) => {
                    x = pole * x + (1.0 - pole * pole).sqrt() * normal(&mut rng);
                    tau[(k, j)] += std * x;
                }
            }
            q[(k, j)] += 1e-5 * normal(&mut rng);
        }
    }
    let t = (0..periods * samples).map(|k| k as f64 * DT).collect();
    Run { name: format!("run {seed}"), t, q, dq: None, tau, mounting, period: Some(fourier.period) }
}

fn prepare(run: &Run) -> Experiment {
    Experiment::prepare(run, &Settings::default()).unwrap()
}

fn z_scores(found: &Identification, truth: &[f64]) -> Vec<f64> {
    let z = |((beta, std), truth): ((&f64, &Option<f64>), &f64)| (beta - truth) / std.expect("determined");
    found.beta.iter().zip(&found.std).zip(truth).map(z).collect()
}

fn mean_square(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64
}

/// Share of the errors that are less than two standard deviations.
fn within_two(z: &[f64]) -> f64 {
    z.iter().filter(|z| z.abs() < 2.0).count() as f64 / z.len() as f64
}

#[test]
fn without_noise_every_parameter_is_exact() {
    let truth = Truth::random(11);
    let structure = structure(None);
    let experiment = prepare(&simulate(&truth, &motion(2, 10.0, 5), 1, Mounting::WALL, Noise::None, 0));
    let found = identify(&structure, &[experiment]).unwrap();
    let beta = truth.beta(&structure);
    assert_eq!((found.beta.len(), found.rank), (59, 59));
    let scale = beta.iter().fold(0.0_f64, |scale, b| scale.max(b.abs()));
    for (c, (found, exact)) in structure.columns().iter().zip(found.beta.iter().zip(&beta)) {
        assert!((found - exact).abs() < 1e-6 * exact.abs().max(0.01 * scale), "{}: {found} {exact}", c.name);
    }
    assert!(found.rms.raw.iter().chain(&found.rms.filtered).all(|&rms| rms < 1e-5), "{:?}", found.rms);
    assert!(found.undetermined.is_empty());
}

#[test]
fn with_noise_errors_agree_with_the_standard_deviations() {
    let truth = Truth::random(12);
    let structure = structure(None);
    let beta = truth.beta(&structure);
    let fourier = motion(3, 10.0, 5);
    for (noise, floor) in [(Noise::White(0.1), 0.1), (Noise::Coloured(0.05), 0.05)] {
        let mut z = Vec::new();
        for seed in 0..5 {
            let run = simulate(&truth, &fourier, 8, Mounting::WALL, noise, 100 + seed);
            let found = identify(&structure, &[prepare(&run)]).unwrap();
            let these = z_scores(&found, &beta);
            for (column, z) in structure.columns().iter().zip(&these) {
                assert!(z.abs() < 4.0, "{}: {z} standard deviations", column.name);
            }
            z.extend(these);
            // The residual is the noise, less the degrees of freedom of the fit.
            let noise_floor = found.rms.noise_floor.as_ref().unwrap();
            for j in 0..N {
                assert!((noise_floor[j] / floor - 1.0).abs() < 0.1, "{noise_floor:?}");
                assert!((found.rms.raw[j] / noise_floor[j] - 0.99).abs() < 0.03, "{:?}", found.rms);
            }
        }
        let mean = mean_square(&z);
        let within_two = within_two(&z);
        println!("mean z2 {mean:.3}, within two standard deviations {within_two:.3}");
        assert!((0.6..1.5).contains(&mean), "mean squared z-score {mean}");
        assert!((0.9..0.99).contains(&within_two), "{within_two} of the parameters within two standard deviations");
    }
}

/// No scatter between periods shows what every period repeats: the steps of the encoders, and friction that the model lacks.
#[test]
fn errors_that_every_period_repeats_agree_with_the_standard_deviations() {
    const STEP: f64 = 1e-4;
    let structure = structure(None);
    for (step, peak, least) in [(STEP, 0.0, 0.93), (0.0, 0.3, 0.85)] {
        let mut z = Vec::new();
        for seed in 0..5 {
            let truth = Truth::random(30 + seed);
            let mut run = simulate(&truth, &motion(30 + seed, 10.0, 5), 4, Mounting::WALL, Noise::None, 300 + seed);
            let stribeck = DMatrix::from_fn(run.q.nrows(), N, |k, j| {
                let speed = (run.q[((k + 1) % run.q.nrows(), j)] - run.q[(k, j)]) / DT;
                peak * truth.fc[j] * (-speed.abs() / 0.1).exp() * (100.0 * speed).tanh()
            });
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            run.tau += stribeck;
            run.tau.apply(|torque| *torque += 0.02 * normal(&mut rng));
            if step > 0.0 {
                run.q.apply(|q| *q = (*q / step).round() * step);
            }
            let found = identify(&structure, &[prepare(&run)]).unwrap();
            let rigid = structure.columns().len() - 2 * N;
            z.extend_from_slice(&z_scores(&found, &truth.beta(&structure))[..rigid]);
        }
        let within_two = within_two(&z);
        println!("step {step}, peak {peak}: mean z2 {:.3}, within two {within_two:.3}", mean_square(&z));
        assert!(within_two > least, "{within_two} of the parameters within two standard deviations");
    }
}

#[test]
fn without_repeats_the_residual_gives_the_standard_deviations() {
    let truth = Truth::random(13);
    let structure = structure(None);
    let beta = truth.beta(&structure);
    for noise in [Noise::White(0.1), Noise::Coloured(0.03)] {
        let mut z = Vec::new();
        for seed in 0..3 {
            let run = simulate(&truth, &motion(4, 40.0, 12), 1, Mounting::WALL, noise, 200 + seed);
            let found = identify(&structure, &[prepare(&run)]).unwrap();
            assert!(found.rms.noise_floor.is_none());
            z.extend(z_scores(&found, &beta));
        }
        let mean = mean_square(&z);
        println!("mean z2 {mean:.3}");
        assert!((0.5..2.0).contains(&mean), "mean squared z-score {mean}");
    }
}

#[test]
fn a_filter_on_the_torque_alone_biases_the_estimate() {
    let truth = Truth::random(15);
    let structure = structure(None);
    let beta = truth.beta(&structure);
    let experiment = prepare(&simulate(&truth, &motion(6, 10.0, 5), 1, Mounting::WALL, Noise::None, 0));
    let w = structure.regressor(&experiment.motion);
    let solve = |w: DMatrix<f64>, tau: &DMatrix<f64>| w.svd(true, true).solve(tau, 1e-12).unwrap();
    let error = |found: &DMatrix<f64>| {
        let found: Vec<f64> = found.iter().copied().collect();
        let difference = structure.torques(&found, &experiment.motion) - structure.torques(&beta, &experiment.motion);
        difference.norm() / (difference.len() as f64).sqrt()
    };
    let tau = experiment.filter(&experiment.stacked_tau());
    let every = |m: &DMatrix<f64>| m.select_rows(&(0..m.nrows()).step_by(20).collect::<Vec<_>>());
    let alike = error(&solve(every(&experiment.filter(&w)), &every(&tau)));
    let torque_alone = error(&solve(every(&w), &every(&tau)));
    assert!(alike < 1e-5, "{alike}");
    assert!(torque_alone > 0.01, "{torque_alone}");
}

#[test]
fn parameters_from_the_wall_are_valid_upright_but_not_vice_versa() {
    let truth = Truth::random(16);
    let noise = Noise::White(0.05);
    let run = |seed, mounting| simulate(&truth, &motion(seed, 10.0, 5), 4, mounting, noise, 300 + seed);
    let (gbs, vbs) = (structure(None), structure(Some(Mounting::UPRIGHT)));
    assert_eq!((vbs.kind(), vbs.columns().len()), (BaseKind::Vbs, 57));
    let on_wall = identify(&gbs, &[prepare(&run(7, Mounting::WALL))]).unwrap();
    let upright = identify(&vbs, &[prepare(&run(8, Mounting::UPRIGHT))]).unwrap();

    for seed in [20, 21] {
        for mounting in [Mounting::WALL, Mounting::UPRIGHT, Mounting { rho: 2.3, phi: 0.9 }] {
            let unseen = prepare(&run(seed, mounting));
            let rms = validate_parameters(&unseen, &gbs, &on_wall.beta);
            for (raw, floor) in rms.raw.iter().zip(rms.noise_floor.unwrap()) {
                assert!((raw / floor - 1.0).abs() < 0.1, "GBS, {mounting:?}: {raw} over {floor}");
            }
        }
        let rms = validate_parameters(&prepare(&run(seed, Mounting::UPRIGHT)), &vbs, &upright.beta);
        assert!(rms.raw.iter().all(|&raw| (raw / 0.05 - 1.0).abs() < 0.05), "VBS upright: {rms:?}");
        let rms = validate_parameters(&prepare(&run(seed, Mounting::WALL)), &vbs, &upright.beta);
        assert!(rms.raw[0] > 0.5, "VBS on the wall: {rms:?}");
        assert!(rms.raw[1..].iter().all(|&raw| (raw / 0.05 - 1.0).abs() < 0.05), "VBS on the wall: {rms:?}");
    }
}

#[test]
fn parameters_hidden_by_the_mounting_are_undetermined_and_the_others_exact() {
    let truth = Truth::random(17);
    let structure = structure(None);
    let beta = truth.beta(&structure);
    let run = simulate(&truth, &motion(9, 10.0, 5), 6, Mounting::UPRIGHT, Noise::White(0.05), 9);
    let found = identify(&structure, &[prepare(&run)]).unwrap();
    let names: Vec<&str> = found.undetermined.iter().map(|u| u.name.as_str()).collect();
    assert_eq!(names, ["lx1", "ly1"]);
    assert_eq!(found.rank, 57);
    assert!(found.beta.iter().all(|b| b.is_finite()));
    for (c, column) in structure.columns().iter().enumerate() {
        match found.std[c] {
            Some(std) => assert!((found.beta[c] - beta[c]).abs() < 4.0 * std, "{}", column.name),
            None => assert!(names.contains(&column.name.as_str())),
        }
    }
}

#[test]
fn joints_that_never_move_give_finite_parameters() {
    let truth = Truth::random(18);
    let structure = structure(None);
    let mut fourier = motion(10, 10.0, 5);
    fourier.scale_joint(3, 0.0);
    let run = simulate(&truth, &fourier, 4, Mounting::WALL, Noise::None, 10);
    let found = identify(&structure, &[prepare(&run)]).unwrap();
    assert!(found.rank < 59);
    assert!(found.undetermined.iter().any(|u| u.name == "fv4") && found.undetermined.iter().any(|u| u.name == "fc4"));
    assert!(found.beta.iter().all(|b| b.is_finite()));
    assert!(found.rms.raw.iter().all(|&rms| rms < 1e-3), "{:?}", found.rms);
}

#[test]
fn an_uneven_aperiodic_record_with_gaps_and_repeats_is_identified() {
    let truth = Truth::random(19);
    let structure = structure(None);
    let beta = truth.beta(&structure);
    let fourier = motion(11, 40.0, 12);
    let even = simulate(&truth, &fourier, 1, Mounting::WALL, Noise::None, 11);
    let chain = panda();
    let mut rng = ChaCha8Rng::seed_from_u64(55);
    let (mut t, mut q, mut tau) = (Vec::new(), Vec::new(), Vec::new());
    for k in 0..even.t.len() {
        if rng.random_range(0.0..1.0) < 0.02 {
            continue;
        }
        let time = k as f64 * DT + rng.random_range(-3e-4..3e-4);
        let points: Vec<_> = (0..N).map(|j| fourier.at(j, time)).collect();
        let of = |f: fn(&plumbline_excite::Point) -> f64| points.iter().map(f).collect::<Vec<_>>();
        let clean = truth.torque(&chain, &even.mounting.gravity(), &of(|p| p.q), &of(|p| p.dq), &of(|p| p.ddq));
        t.push(time);
        q.push(points.iter().map(|p| p.q + 1e-6 * normal(&mut rng)).collect::<Vec<_>>());
        tau.push(clean.map(|tau| tau + 0.05 * normal(&mut rng)));
        if k % 50 == 0 {
            let last = q.len() - 1;
            t.push(time + 4e-4);
            q.push(q[last].clone());
            tau.push(tau[last]);
        }
    }
    let matrix = |of: &dyn Fn(usize, usize) -> f64| DMatrix::from_fn(t.len(), N, of);
    let (q, tau) = (matrix(&|k, j| q[k][j]), matrix(&|k, j| tau[k][j]));
    let run = Run { name: "uneven".into(), t, dq: None, q, tau, mounting: even.mounting, period: None };
    let settings = Settings { position_cutoff: Some(10.0), ..Settings::default() };
    let experiment = Experiment::prepare(&run, &settings).unwrap();
    assert!(experiment.sampling.repeated_rows > 700 && experiment.sampling.missing > 700, "{:?}", experiment.sampling);
    let found = identify(&structure, &[experiment]).unwrap();
    let mean = mean_square(&z_scores(&found, &beta));
    println!("mean z2 {mean:.3}");
    assert!((0.4..2.5).contains(&mean), "mean squared z-score {mean}");
    assert!(found.rms.raw.iter().all(|&rms| (0.03..0.06).contains(&rms)), "{:?}", found.rms);
}
