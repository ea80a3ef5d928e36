//! The errors before and after, and their intervals: against direct sums over the samples, and against the statistics of known noise.

use super::synthetic::{DT, PERIOD, PERIODS};
use nalgebra::DMatrix;
use plumbline_diagnose::errors::{Compared, Of, compare};
use plumbline_identify::{ExcludedSpan, Experiment, Modelled, Run};
use plumbline_model::Mounting;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::f64::consts::{PI, TAU};

/// Compares two models by their residuals on the samples of one experiment, N x n.
fn compared(experiment: &Experiment, residuals: [&DMatrix<f64>; 2], of: Of) -> Compared {
    let model = |residual: &DMatrix<f64>| Modelled::of(experiment, |_| &experiment.tau - residual);
    let [before, after] = residuals.map(model);
    compare(&[(experiment, before, after)], of).unwrap()
}

/// First-order noise of unit standard deviation with this correlation time \[s\].
fn coloured(rng: &mut ChaCha8Rng, samples: usize, joints: usize, time: f64) -> DMatrix<f64> {
    let pole = (-DT / time).exp();
    let mut noise = DMatrix::zeros(samples, joints);
    for mut column in noise.column_iter_mut() {
        let mut value: f64 = rng.sample(StandardNormal);
        for out in column.iter_mut() {
            *out = value;
            value = pole * value + (1.0 - pole * pole).sqrt() * rng.sample::<f64, _>(StandardNormal);
        }
    }
    noise
}

/// Torques of a periodic run: four periods of white noise of 0.3 Nm about a sine of 1 and 2 Nm.
fn periodic() -> Run {
    let samples = (PERIOD / DT).round() as usize;
    let rows = PERIODS * samples;
    let mut rng = ChaCha8Rng::seed_from_u64(21);
    let angle = |row: usize| TAU * (row % samples) as f64 / samples as f64;
    let tau = DMatrix::from_fn(rows, 2, |row, j| {
        (j + 1) as f64 * (3.0 * angle(row)).sin() + 0.3 * rng.sample::<f64, _>(StandardNormal)
    });
    Run {
        name: "periodic".into(),
        t: (0..rows).map(|row| row as f64 * DT).collect(),
        q: DMatrix::from_fn(rows, 2, |row, j| (angle(row) + j as f64).sin()),
        dq: None,
        tau,
        mounting: Mounting::WALL,
        period: Some(PERIOD),
    }
}

/// Gain of a digital Butterworth low-pass, forward and backward.
fn gain(f: f64, order: i32, cutoff: f64) -> f64 {
    1.0 / (1.0 + ((PI * f * DT).tan() / (PI * cutoff * DT).tan()).powi(2 * order))
}

/// The signal behind the low-pass, by the sums of a plain Fourier series.
fn low_passed(x: &[f64], order: i32, cutoff: f64) -> Vec<f64> {
    let n = x.len();
    let turn = |m: usize, k: usize| TAU * ((m * k) % n) as f64 / n as f64;
    let mut y = vec![0.0; n];
    for m in 0..=n / 2 {
        let gain = gain(m as f64 / (n as f64 * DT), order, cutoff);
        if gain < 1e-9 {
            break;
        }
        let sum = |wave: fn(f64) -> f64| (0..n).map(|k| x[k] * wave(turn(m, k))).sum::<f64>() / n as f64;
        let (a, b) = (sum(f64::cos), sum(f64::sin));
        let sides = if m == 0 { 1.0 } else { 2.0 };
        for (k, y) in y.iter_mut().enumerate() {
            *y += sides * gain * (a * turn(m, k).cos() + b * turn(m, k).sin());
        }
    }
    y
}

fn rms(x: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = x.fold((0.0, 0), |(sum, count), x| (sum + x * x, count + 1));
    (sum / f64::from(count)).sqrt()
}

#[test]
fn raw_errors_are_the_root_mean_square_over_every_sample_of_every_period() {
    let run = periodic();
    let settings = plumbline_identify::Settings::default();
    let experiment = Experiment::prepare(&run, &settings).unwrap();
    let samples = experiment.motion.samples();
    // Torques of two models along the motion: one says nothing, the other knows half of the sine.
    let models = [0.0, 0.5].map(|share| {
        DMatrix::from_fn(samples, 2, |k, j| share * (j + 1) as f64 * (3.0 * TAU * k as f64 / samples as f64).sin())
    });
    let residuals = models.each_ref().map(|model| &experiment.tau - model);
    let found = compared(&experiment, residuals.each_ref(), Of::Raw);
    for j in 0..2 {
        let direct = models
            .each_ref()
            .map(|model| rms((0..run.t.len()).map(|row| run.tau[(row, j)] - model[(row % samples, j)])));
        assert!(
            (found.before.validate_rms[j] / direct[0] - 1.0).abs() < 1e-9,
            "{} {}",
            found.before.validate_rms[j],
            direct[0]
        );
        assert!(
            (found.after.validate_rms[j] / direct[1] - 1.0).abs() < 1e-9,
            "{} {}",
            found.after.validate_rms[j],
            direct[1]
        );
        assert!((found.change.validate_rms[j] - (direct[1] - direct[0])).abs() < 1e-9);
        let floor = found.floor.as_ref().unwrap()[j];
        assert!((floor / 0.3 - 1.0).abs() < 0.05, "{floor}");
    }
}

#[test]
fn filtered_errors_are_those_of_the_mean_period_behind_the_low_pass() {
    let run = periodic();
    let settings = plumbline_identify::Settings { torque_cutoff: 2.0, ..plumbline_identify::Settings::default() };
    let experiment = Experiment::prepare(&run, &settings).unwrap();
    let samples = experiment.motion.samples();
    let models = [0.0, 0.5].map(|share| {
        DMatrix::from_fn(samples, 2, |k, j| share * (j + 1) as f64 * (3.0 * TAU * k as f64 / samples as f64).sin())
    });
    let residuals = models.each_ref().map(|model| &experiment.tau - model);
    let found = compared(&experiment, residuals.each_ref(), Of::Filtered);
    for j in 0..2 {
        let direct = models.each_ref().map(|model| {
            let mean = |k: usize| (0..PERIODS).map(|p| run.tau[(p * samples + k, j)]).sum::<f64>() / PERIODS as f64;
            let residual: Vec<f64> = (0..samples).map(|k| mean(k) - model[(k, j)]).collect();
            rms(low_passed(&residual, settings.order as i32, 2.0).into_iter())
        });
        assert!(
            (found.before.validate_rms[j] / direct[0] - 1.0).abs() < 1e-6,
            "{} {}",
            found.before.validate_rms[j],
            direct[0]
        );
        assert!(
            (found.after.validate_rms[j] / direct[1] - 1.0).abs() < 1e-6,
            "{} {}",
            found.after.validate_rms[j],
            direct[1]
        );
        // White noise of 0.3 Nm, averaged over four periods, in the share of the spectrum that the filter passes.
        let passed = (0..samples).map(|m| {
            let f = m.min(samples - m) as f64 / PERIOD;
            gain(f, settings.order as i32, 2.0).powi(2)
        });
        let floor = 0.3 / 2.0 * (passed.sum::<f64>() / samples as f64).sqrt();
        let found = found.floor.as_ref().unwrap()[j];
        assert!((found / floor - 1.0).abs() < 0.3, "{found} {floor}");
    }
}

#[test]
fn raw_errors_are_taken_along_the_quieter_motion() {
    // Noisy positions: two motions are prepared, and each band has its own.
    let mut run = periodic();
    let mut rng = ChaCha8Rng::seed_from_u64(22);
    run.q.apply(|q| *q += 1e-6 * rng.sample::<f64, _>(StandardNormal));
    let experiment = Experiment::prepare(&run, &plumbline_identify::Settings::default()).unwrap();
    let judged = experiment.comparison_motion.as_ref().expect("a narrower filter").q.clone();
    let predict = |motion: &plumbline_model::term::Motion| {
        let off = if motion.q == judged { 1.0 } else { 2.0 };
        &experiment.tau - DMatrix::from_element(motion.samples(), 2, off)
    };
    let error = |of: Of| {
        let [before, after] = [Modelled::of(&experiment, predict), Modelled::of(&experiment, predict)];
        compare(&[(&experiment, before, after)], of).unwrap().before.validate_rms[0]
    };
    assert!((error(Of::Filtered) - 2.0).abs() < 1e-6, "{}", error(Of::Filtered));
    assert!((error(Of::Raw) - 1.0f64.hypot(0.3 * 0.75f64.sqrt())).abs() < 0.02, "{}", error(Of::Raw));
}

#[test]
fn what_is_left_out_of_a_run_has_no_error() {
    let run = Run {
        name: "free".into(),
        t: (0..2500).map(|k| k as f64 * DT).collect(),
        q: DMatrix::from_fn(2500, 2, |k, j| (k as f64 * DT + j as f64).sin()),
        dq: None,
        tau: DMatrix::from_element(2500, 2, 1.0),
        mounting: Mounting::WALL,
        period: None,
    };
    let gone = ExcludedSpan { run: "free".into(), from: 4.0, to: 5.0 };
    let settings = plumbline_identify::Settings { leave_out: vec![gone], ..plumbline_identify::Settings::default() };
    let experiment = Experiment::prepare(&run, &settings).unwrap();
    let residual =
        DMatrix::from_fn(experiment.motion.samples(), 2, |k, _| if experiment.resting()[k] { 1e3 } else { 0.5 });
    let found = compared(&experiment, [&residual, &residual], Of::Raw);
    assert!((found.before.validate_rms[0] - 0.5).abs() < 1e-12, "{}", found.before.validate_rms[0]);
    assert!(found.floor.is_none());
}

/// A run of one minute that does not repeat: what it moves like does not matter here.
fn minute() -> Experiment {
    let rows = 15_000;
    let run = Run {
        name: "minute".into(),
        t: (0..rows).map(|k| k as f64 * DT).collect(),
        q: DMatrix::from_fn(rows, 2, |k, j| (k as f64 * DT + j as f64).sin()),
        dq: None,
        tau: DMatrix::zeros(rows, 2),
        mounting: Mounting::WALL,
        period: None,
    };
    Experiment::prepare(&run, &plumbline_identify::Settings::default()).unwrap()
}

/// Correlation time of the noise in the tests of intervals \[s\].
const CORRELATED: f64 = 0.1;

#[test]
fn an_interval_holds_the_true_error_nineteen_times_out_of_twenty_and_is_no_wider_than_that_takes() {
    let experiment = minute();
    let samples = experiment.motion.samples();
    let mut rng = ChaCha8Rng::seed_from_u64(24);
    let (mut inside, mut width, draws) = (0, 0.0, 300);
    for _ in 0..draws {
        let noise = coloured(&mut rng, samples, 2, CORRELATED);
        let found = compared(&experiment, [&noise, &noise], Of::Raw);
        for j in 0..2 {
            let [low, high] = found.before.intervals[j];
            assert!(low < found.before.validate_rms[j] && found.before.validate_rms[j] < high);
            inside += usize::from(low <= 1.0 && 1.0 <= high);
            width += (high - low) / (2 * draws) as f64;
            // The difference of a model with itself is nothing, and its interval is that.
            assert_eq!((found.change.validate_rms[j], found.change.intervals[j]), (0.0, [0.0, 0.0]));
        }
    }
    // Squares of first-order noise with pole a are correlated by a^2k: their mean has the variance (2 / N) (1 + a^2) / (1 - a^2).
    let a2 = (-2.0 * DT / CORRELATED).exp();
    let std = 0.5 * (2.0 / samples as f64 * (1.0 + a2) / (1.0 - a2)).sqrt();
    let analytic = 2.0 * 1.96 * std;
    let share = inside as f64 / (2 * draws) as f64;
    println!("coverage {share:.3}, width {width:.4}, analytic {analytic:.4}");
    assert!((0.92..0.97).contains(&share), "the true error is inside {share} of the intervals");
    assert!((0.93..1.05).contains(&(width / analytic)), "mean width {width}, analytic {analytic}");
}

#[test]
fn the_interval_of_a_change_is_that_of_the_paired_difference() {
    let experiment = minute();
    let samples = experiment.motion.samples();
    let effect = DMatrix::from_fn(samples, 2, |k, _| 0.5 * 2f64.sqrt() * (TAU * 0.7 * k as f64 * DT).sin());
    let mut rng = ChaCha8Rng::seed_from_u64(25);
    let truth = 1.0 - 1.25f64.sqrt();
    let (mut inside, mut paired, mut unpaired, draws) = (0, 0.0, 0.0, 200);
    for _ in 0..draws {
        let noise = coloured(&mut rng, samples, 2, CORRELATED);
        let found = compared(&experiment, [&(&noise + &effect), &noise], Of::Raw);
        for j in 0..2 {
            let [low, high] = found.change.intervals[j];
            inside += usize::from(low <= truth && truth <= high);
            assert!(low < found.change.validate_rms[j] && found.change.validate_rms[j] < high);
            let [before, after] = [&found.before, &found.after].map(|of| of.intervals[j][1] - of.intervals[j][0]);
            paired += high - low;
            unpaired += before.hypot(after);
        }
    }
    let share = inside as f64 / (2 * draws) as f64;
    println!("coverage {share:.3}, width {:.3} of the unpaired", paired / unpaired);
    // Noise that both have does not count twice.
    assert!(paired < 0.7 * unpaired, "{paired} {unpaired}");
    assert!((0.91..0.99).contains(&share), "the true change is inside {share} of the intervals");
}
