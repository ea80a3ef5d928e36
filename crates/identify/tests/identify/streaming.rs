//! The recursive estimator against a second implementation solved by singular values, simulated truth, and a check for allocations.

use assert_no_alloc::{AllocDisabler, assert_no_alloc, violation_count};
use nalgebra::{DMatrix, DVector};
use plumbline_core::JointVec;
use plumbline_identify::signal::butterworth::Butterworth;
use plumbline_identify::streaming::gram::Gram;
use plumbline_identify::streaming::{NotFinite, Settings, Streaming, StreamingError};
use plumbline_model::term::{Motion, Sample};
use plumbline_model::{Evaluator, Mounting, Reduction, Structure, TorqueModel};
use plumbline_testkit::arms::{chain, draw};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

#[global_allocator]
static ALLOCATOR: AllocDisabler = AllocDisabler;

const RATE: f64 = 500.0;

fn structure(robot: &str) -> Structure {
    let chain = chain(robot);
    let reduction = Reduction::any_mounting(&chain);
    Structure::of(chain, reduction, &["friction", "torque-offset"]).unwrap()
}

/// A model with parameters of the size of a real arm's.
fn model(structure: &Structure, rng: &mut ChaCha8Rng) -> TorqueModel {
    let values = draw(rng, structure.columns().len(), 0.5).into_iter().map(|value| (value + 0.2, None));
    TorqueModel::new("arm", structure.clone(), Vec::new(), &values.collect::<Vec<_>>()).unwrap()
}

/// Sums of sines with their exact derivatives, and the torque that a model needs along them, with noise.
struct Source {
    sines: Vec<Vec<[f64; 3]>>,
    evaluator: Evaluator,
    noise: Option<Normal<f64>>,
    rng: ChaCha8Rng,
}

impl Source {
    fn new(model: &TorqueModel, noise: f64, seed: u64) -> Source {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let n = model.structure().chain().len();
        let mut sine = || [rng.random_range(0.1..0.5), rng.random_range(0.4..4.5), rng.random_range(-3.0..3.0)];
        let sines = (0..n).map(|_| (0..5).map(|_| sine()).collect()).collect();
        let noise = (noise > 0.0).then(|| Normal::new(0.0, noise).unwrap());
        Source { sines, evaluator: model.evaluator(&Mounting::WALL.gravity()), noise, rng }
    }

    fn sample(&self, k: usize) -> Sample {
        let mut sample = Sample::default();
        let t = k as f64 / RATE;
        for (j, sines) in self.sines.iter().enumerate() {
            for [a, w, phase] in sines {
                let (sin, cos) = (w * t + phase).sin_cos();
                sample.q[j] += a * sin;
                sample.dq[j] += a * w * cos;
                sample.ddq[j] -= a * w * w * sin;
            }
        }
        sample
    }

    fn measured(&mut self, k: usize) -> (JointVec, JointVec) {
        let sample = self.sample(k);
        let mut tau = self.evaluator.torque(&sample).0;
        if let Some(noise) = &self.noise {
            tau[..self.sines.len()].iter_mut().for_each(|tau| *tau += noise.sample(&mut self.rng));
        }
        (sample.q, tau)
    }
}

/// One causal run of a low-pass over a record, section by section, initialised in steady state at the first value.
fn forward(filter: &Butterworth, x: &[f64]) -> Vec<f64> {
    let mut y = x.to_vec();
    for [b0, a1, a2] in filter.coefficients() {
        let (mut x1, mut x2, mut y1, mut y2) = (y[0], y[0], y[0], y[0]);
        for value in &mut y {
            let x0 = *value;
            let out = b0 * (x0 + 2.0 * x1 + x2) - a1 * y1 - a2 * y2;
            (x2, x1, y2, y1) = (x1, x0, y1, out);
            *value = out;
        }
    }
    y
}

/// The rows of the estimator, computed from whole records: n m rows, joint by joint.
fn rows(
    structure: &Structure,
    q: &DMatrix<f64>,
    tau: &DMatrix<f64>,
    settings: &Settings,
) -> (DMatrix<f64>, DVector<f64>) {
    let (samples, n) = q.shape();
    let wide = Butterworth::new(settings.position_order, settings.position_cutoff, RATE).unwrap();
    let narrow = Butterworth::new(settings.torque_order, settings.torque_cutoff, RATE).unwrap();
    let each = |x: &DMatrix<f64>| {
        let columns: Vec<DVector<f64>> = x
            .column_iter()
            .map(|column| DVector::from_vec(forward(&wide, &column.iter().copied().collect::<Vec<_>>())))
            .collect();
        DMatrix::from_columns(&columns)
    };
    let (q, tau) = (each(q), each(tau));
    let inner = samples - 2;
    let motion = Motion {
        dt: 1.0 / RATE,
        q: q.rows(1, inner).into_owned(),
        dq: DMatrix::from_fn(inner, n, |k, j| (q[(k + 2, j)] - q[(k, j)]) * (0.5 * RATE)),
        ddq: DMatrix::from_fn(inner, n, |k, j| (q[(k + 2, j)] - 2.0 * q[(k + 1, j)] + q[(k, j)]) * (RATE * RATE)),
        gravity: Mounting::WALL.gravity(),
        periodic: false,
        start: 0.0,
    };
    let y = structure.regressor(&motion);
    let settled = 2 + ((wide.settling() + narrow.settling()) * RATE).ceil() as usize;
    let step = settings.decimation.unwrap();
    // Inner row `k` belongs to tick `k + 3`.
    let kept: Vec<usize> = (0..inner).filter(|k| k + 3 >= settled && (k + 3) % step == 0).collect();
    let m = kept.len();
    let mut w = DMatrix::zeros(n * m, y.ncols());
    let mut right = DVector::zeros(n * m);
    for j in 0..n {
        for c in 0..y.ncols() {
            let filtered = forward(&narrow, &y.view((j * inner, c), (inner, 1)).iter().copied().collect::<Vec<_>>());
            kept.iter().enumerate().for_each(|(row, &k)| w[(j * m + row, c)] = filtered[k]);
        }
        let filtered = forward(&narrow, &tau.view((1, j), (inner, 1)).iter().copied().collect::<Vec<_>>());
        kept.iter().enumerate().for_each(|(row, &k)| right[j * m + row] = filtered[k]);
    }
    (w, right)
}

/// Weighted least squares by singular values of the equilibrated rows.
fn by_singular_values(w: &DMatrix<f64>, tau: &DVector<f64>, sigma: &[f64]) -> DVector<f64> {
    let m = tau.len() / sigma.len();
    let (mut w, mut tau) = (w.clone(), tau.clone());
    for (j, sigma) in sigma.iter().enumerate() {
        w.rows_mut(j * m, m).scale_mut(1.0 / sigma);
        tau.rows_mut(j * m, m).scale_mut(1.0 / sigma);
    }
    let norms: Vec<f64> = w.column_iter().map(|column| column.norm()).collect();
    w.column_iter_mut().zip(&norms).for_each(|(mut column, norm)| column /= *norm);
    let mut beta = w.svd(true, true).solve(&tau, 0.0).unwrap();
    beta.iter_mut().zip(&norms).for_each(|(beta, norm)| *beta /= norm);
    beta
}

#[test]
fn the_recursive_estimate_agrees_with_the_batch_solution() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for robot in ["panda", "scara", "ur10"] {
        let structure = structure(robot);
        let (n, samples) = (structure.chain().len(), 16_000);
        let settings = Settings { decimation: Some(16), ..Settings::default() };
        let mut source = Source::new(&model(&structure, &mut rng), 0.05, 7);
        let mut streaming = Streaming::new(&structure, &Mounting::WALL.gravity(), RATE, &settings).unwrap();
        let (mut q, mut tau) = (DMatrix::zeros(samples, n), DMatrix::zeros(samples, n));
        for k in 0..samples {
            let measured = source.measured(k);
            streaming.push(&measured.0, &measured.1).unwrap();
            for j in 0..n {
                (q[(k, j)], tau[(k, j)]) = (measured.0[j], measured.1[j]);
            }
        }
        let estimate = streaming.estimate().unwrap();
        let (w, right) = rows(&structure, &q, &tau, &settings);
        assert_eq!(estimate.rows, right.len(), "{robot}");
        // The weights are those of the residuals.
        let expected = by_singular_values(&w, &right, &estimate.sigma);
        let residual = &right - &w * &expected;
        let m = right.len() / n;
        let freedom = right.len() as f64 / (right.len() - estimate.rank) as f64;
        for j in 0..n {
            let own = (residual.rows(j * m, m).norm_squared() / m as f64 * freedom).sqrt();
            assert!(
                (estimate.sigma[j] / own - 1.0).abs() < 0.02,
                "{robot}, joint {}: {} {own}",
                j + 1,
                estimate.sigma[j]
            );
        }
        for (c, column) in structure.columns().iter().enumerate() {
            let std = estimate.std[c].unwrap_or_else(|| panic!("{robot}: {} is undetermined", column.name));
            let error = (estimate.beta[c] - expected[c]).abs() / std;
            assert!(error < 1e-8, "{robot}, {}: {error:e} standard deviations", column.name);
            let relative = (estimate.beta[c] - expected[c]).abs() / expected[c].abs();
            assert!(relative < 1e-9, "{robot}, {}: {relative:e} of itself", column.name);
        }
        let inverse = {
            let mut weighed = w.clone();
            estimate.sigma.iter().enumerate().for_each(|(j, sigma)| weighed.rows_mut(j * m, m).scale_mut(1.0 / sigma));
            (weighed.transpose() * weighed).try_inverse().unwrap()
        };
        // White noise: one factor for all joints, which the low-passes give.
        let factor = estimate.correlation[0];
        assert!(estimate.correlation.iter().all(|&c| c == factor) && factor > 2.0, "{:?}", estimate.correlation);
        let difference = (&estimate.covariance / factor - &inverse).amax();
        assert!(difference < 1e-6 * inverse.amax(), "{robot}: {difference:e}");
    }
}

#[test]
fn errors_agree_with_the_standard_deviations() {
    let structure = structure("panda");
    let truth = model(&structure, &mut ChaCha8Rng::seed_from_u64(2));
    let (mut beyond, mut all, mut squares) = (0, 0, 0.0);
    for seed in 0..3 {
        let mut source = Source::new(&truth, 0.5, 20 + seed);
        let mut streaming = Streaming::new(&structure, &Mounting::WALL.gravity(), RATE, &Settings::default()).unwrap();
        for k in 0..60_000 {
            let (q, tau) = source.measured(k);
            streaming.push(&q, &tau).unwrap();
            if k == 20_000 {
                streaming.estimate().unwrap();
            }
        }
        let estimate = streaming.estimate().unwrap();
        assert_eq!(estimate.rank, structure.columns().len());
        for (c, truth) in truth.beta().iter().enumerate() {
            let error = (estimate.beta[c] - truth) / estimate.std[c].unwrap();
            all += 1;
            beyond += (error.abs() > 4.0) as usize;
            squares += error * error;
        }
    }
    // The standard deviations agree with the errors.
    let size = (squares / all as f64).sqrt();
    assert!(beyond == 0 && (0.6..1.5).contains(&size), "{beyond} of {all} beyond 4 standard deviations, size {size}");
}

#[test]
fn forgetting_follows_a_change_of_the_parameters() {
    let structure = structure("paper-2dof");
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let (first, second) = (model(&structure, &mut rng), model(&structure, &mut rng));
    let error = |forgetting: f64| {
        let settings = Settings { forgetting, ..Settings::default() };
        let mut streaming = Streaming::new(&structure, &Mounting::WALL.gravity(), RATE, &settings).unwrap();
        for (model, seed) in [(&first, 1), (&second, 2)] {
            let mut source = Source::new(model, 0.01, seed);
            streaming.interrupt();
            for k in 0..40_000 {
                let (q, tau) = source.measured(k);
                streaming.push(&q, &tau).unwrap();
            }
        }
        let estimate = streaming.estimate().unwrap();
        let differences = estimate.beta.iter().zip(second.beta()).map(|(found, truth)| (found - truth).powi(2));
        differences.sum::<f64>().sqrt()
    };
    let (all, recent) = (error(1.0), error(0.99));
    assert!(recent < 0.02 && all > 10.0 * recent, "{all} without, {recent} with forgetting");
}

#[test]
fn push_does_not_allocate_and_ignores_non_finite_samples() {
    let structure = structure("panda");
    let mut source = Source::new(&model(&structure, &mut ChaCha8Rng::seed_from_u64(4)), 0.1, 1);
    let mut streaming = Streaming::new(&structure, &Mounting::WALL.gravity(), RATE, &Settings::default()).unwrap();
    let samples: Vec<_> = (0..20_000).map(|k| source.measured(k)).collect();
    samples.iter().for_each(|(q, tau)| streaming.push(q, tau).unwrap());
    // From here on the correlation of the residuals is computed too.
    streaming.estimate().unwrap();
    // The allocation check itself works.
    assert_no_alloc(|| drop(std::hint::black_box(Box::new(1.0))));
    let counted = violation_count();
    assert!(counted > 0);
    assert_no_alloc(|| samples.iter().for_each(|(q, tau)| streaming.push(q, tau).unwrap()));
    assert_eq!(violation_count(), counted);

    let before = (streaming.rows(), streaming.estimate().unwrap().beta);
    let mut bad = samples[0].1;
    bad[4] = f64::NAN;
    assert_eq!(streaming.push(&samples[0].0, &bad), Err(NotFinite { joint: 5 }));
    assert_eq!((streaming.rows(), streaming.estimate().unwrap().beta), before);
    // After the restart the low-passes must settle before another row is added.
    samples[..500].iter().for_each(|(q, tau)| streaming.push(q, tau).unwrap());
    assert_eq!(streaming.rows(), before.0);
}

#[test]
fn invalid_settings_and_missing_rows_are_errors() {
    let structure = structure("panda");
    let gravity = Mounting::WALL.gravity();
    let settings = |forgetting, torque_cutoff| Settings { forgetting, torque_cutoff, ..Settings::default() };
    let error = |settings: Settings| Streaming::new(&structure, &gravity, RATE, &settings).unwrap_err();
    assert_eq!(error(settings(1.5, 5.0)), StreamingError::Forgetting { value: 1.5 });
    assert!(matches!(error(settings(1.0, 300.0)), StreamingError::Signal(_)));
    let mut streaming = Streaming::new(&structure, &gravity, RATE, &Settings::default()).unwrap();
    let columns = structure.columns().len();
    assert_eq!(streaming.estimate().unwrap_err(), StreamingError::TooFewRows { rows: 0, columns });
    // At rest friction and inertia are undetermined.
    for _ in 0..20_000 {
        streaming.push(&[0.3; 8], &[1.0; 8]).unwrap();
    }
    let estimate = streaming.estimate().unwrap();
    assert!(estimate.rank < columns && estimate.std.iter().filter(|std| std.is_none()).count() > 20);
}

/// The joint blocks against dense products, with rows that no block divides evenly.
#[test]
fn the_joint_blocks_agree_with_dense_products() {
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for forgetting in [1.0, 0.97] {
        let (p, count) = (13, 77);
        let active = vec![(0..13).collect(), vec![2, 5, 6, 12], vec![]];
        let mut gram = Gram::new(p, active.clone(), forgetting);
        let mut dense = vec![(DMatrix::<f64>::zeros(p, p), DVector::<f64>::zeros(p), 0.0); 3];
        for k in 0..count {
            let mut y = vec![[0.0; 8]; p];
            let tau: JointVec = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
            let weight = forgetting.powi(count - 1 - k);
            for (j, active) in active.iter().enumerate() {
                active.iter().for_each(|&c: &usize| y[c][j] = rng.random_range(-1.0..1.0));
                let row = DVector::from_iterator(p, y.iter().map(|column| column[j]));
                dense[j].0 += &row * row.transpose() * weight;
                dense[j].1 += &row * (tau[j] * weight);
                dense[j].2 += tau[j] * tau[j] * weight;
            }
            gram.add(&y, &tau);
        }
        let sigma = [0.5, 2.0, 1.0];
        let (m, b) = gram.normal_equations(&sigma);
        let weighed = |j: usize| 1.0 / (sigma[j] * sigma[j]);
        let expected = (0..3).fold((DMatrix::zeros(p, p), DVector::zeros(p)), |sum, j| {
            (sum.0 + &dense[j].0 * weighed(j), sum.1 + &dense[j].1 * weighed(j))
        });
        assert!((m - expected.0).amax() < 1e-11 && (b - expected.1).amax() < 1e-11);
        assert!((gram.of_joint(1) - &dense[1].0).amax() < 1e-11);
        let beta = DVector::from_vec(draw(&mut rng, p, 1.0));
        for (j, square) in gram.residual_squares(&beta).into_iter().enumerate() {
            let (m, b, tau) = &dense[j];
            let expected = tau - 2.0 * beta.dot(b) + beta.dot(&(m * &beta));
            assert!((square - expected).abs() < 1e-10, "joint {j}: {square} {expected}");
            assert!((gram.torque_squares()[j] - tau).abs() < 1e-11);
        }
        let expected = (0..count).map(|k| forgetting.powi(k)).sum::<f64>();
        assert!((gram.weight() - expected).abs() < 1e-9 && gram.count() == count as usize);
    }
}
