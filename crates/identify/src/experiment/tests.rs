use super::*;
use crate::Derivative;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

pub(super) fn run(period: Option<f64>, seconds: f64) -> Run {
    let count = (seconds * 1000.0) as usize + 1;
    let t: Vec<f64> = (0..count).map(|k| k as f64 * 1e-3).collect();
    let q = DMatrix::from_fn(count, 2, |k, j| (PI * t[k] * (j + 1) as f64).sin());
    let tau = q.map(|q| 3.0 * q);
    Run { name: "test".into(), t, dq: None, q, tau, mounting: plumbline_model::Mounting::UPRIGHT, period }
}

#[test]
fn derivatives_of_periodic_and_aperiodic_sines_are_exact() {
    for (period, derivative) in
        [(Some(2.0), Derivative::Spectral), (Some(2.0), Derivative::Central), (None, Derivative::Central)]
    {
        let settings = Settings { derivative, ..Settings::default() };
        let experiment = Experiment::prepare(&run(period, 8.0), &settings).unwrap();
        let (samples, edge) = if period.is_some() { (2000, 0) } else { (8001 - 100, 50) };
        assert_eq!(experiment.motion.samples(), samples);
        for k in 0..samples {
            for j in 0..2 {
                let w = PI * (j + 1) as f64;
                let angle = w * (k + edge) as f64 * 1e-3;
                let errors = [
                    experiment.motion.q[(k, j)] - angle.sin(),
                    experiment.motion.dq[(k, j)] - w * angle.cos(),
                    experiment.motion.ddq[(k, j)] + w * w * angle.sin(),
                ];
                // Larger errors near the ends of an aperiodic run.
                let inside = period.is_some() || (1500..samples - 1500).contains(&k);
                let bounds = if inside { [1e-6, 1e-5, 1e-3] } else { [2e-4, 1e-2, 0.5] };
                for (error, bound) in errors.iter().zip(bounds) {
                    assert!(error.abs() < bound, "{derivative:?}, joint {j}, sample {k}: {errors:?}");
                }
            }
        }
    }
}

#[test]
fn band_filters_columns_and_torques_alike() {
    let experiment = Experiment::prepare(&run(Some(2.0), 4.0), &Settings::default()).unwrap();
    let tau = experiment.stacked_tau();
    let column = &tau / 3.0;
    assert!((experiment.band(&column) * 3.0 - experiment.band(&tau)).abs().max() < 1e-12);
    assert_eq!(experiment.band(&tau).nrows(), 2 * experiment.kept().len());
    assert_eq!(experiment.kept()[1], 80);
    assert_eq!(experiment.scatter.as_ref().unwrap().periods, 2);
    assert!(experiment.scatter.unwrap().std.iter().all(|&s| s < 1e-12));
}

/// Aperiodic run at rest for its first 3 s, then along a sine that starts at rest.
fn at_rest_first() -> Run {
    let mut run = run(None, 9.0);
    let angle = |t: f64| PI * (t - 3.0).max(0.0);
    let speed = |k: usize| if run.t[k] > 3.0 { PI * angle(run.t[k]).sin() } else { 0.0 };
    run.dq = Some(DMatrix::from_fn(run.t.len(), 2, |k, _| speed(k)));
    run.q = DMatrix::from_fn(run.t.len(), 2, |k, _| 1.0 - angle(run.t[k]).cos());
    run
}

#[test]
fn samples_at_rest_are_excluded_from_regression_and_errors() {
    use super::super::validate::validate;
    let run = at_rest_first();
    let whole = Experiment::prepare(&run, &Settings::default()).unwrap();
    let moving = Experiment::prepare(&run, &Settings { rest: Some(0.01), ..Settings::default() }).unwrap();
    // 3 s of 9 s, less the edge; the sine itself passes its turning points in an instant.
    let resting = moving.resting().iter().filter(|resting| **resting).count();
    assert!((2850..3050).contains(&resting), "{resting}");
    assert!(whole.resting().iter().all(|resting| !resting) && moving.kept().iter().all(|&k| !moving.resting()[k]));
    assert!(moving.kept().len() < whole.kept().len() * 7 / 10);
    // A model that is wrong by 1 Nm at rest and exact in motion has no error where rests are excluded.
    let wrong_at_rest = |motion: &Motion| {
        let tau = &moving.tau;
        DMatrix::from_fn(tau.nrows(), tau.ncols(), |k, j| {
            tau[(k, j)] + if motion.dq.row(k).amax() < 0.01 { 1.0 } else { 0.0 }
        })
    };
    let error = |experiment: &Experiment| validate(experiment, wrong_at_rest).raw[0];
    assert!(error(&moving) < 1e-12 && error(&whole) > 0.5, "{} {}", error(&moving), error(&whole));
    // A periodic run keeps all of its samples.
    let periodic = Run { period: Some(9.0), ..run };
    let periodic = Experiment::prepare(&periodic, &Settings { rest: Some(0.01), ..Settings::default() }).unwrap();
    assert!(periodic.resting().iter().all(|resting| !resting));
}

/// White noise behind the low-pass is `sigma sqrt(2 f_c dt)` within a run, and `sigma` at its first and last sample.
#[test]
fn the_ends_of_an_aperiodic_run_count_no_noise_that_the_filter_lets_through() {
    use super::super::validate::validate;
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    let (mut ends, mut counted, mut expected) = (0.0, 0.0, 0.0);
    for _ in 0..40 {
        let mut noise = run(None, 3.0);
        noise.tau = DMatrix::from_fn(noise.t.len(), 2, |_, _| rng.sample(StandardNormal));
        let settings = Settings { without_ends: true, ..Settings::default() };
        let experiment = Experiment::prepare(&noise, &settings).unwrap();
        let zero = |motion: &Motion| DMatrix::zeros(motion.samples(), 2);
        counted += validate(&experiment, zero).filtered[0].powi(2) / 40.0;
        let filtered = experiment.filter(&experiment.stacked_tau());
        ends += filtered[0].powi(2) / 40.0;
        let bandwidth: f64 = (0..500).map(|f| experiment.gain(f64::from(f)).powi(2)).sum();
        expected = 2.0 * (bandwidth - 0.5) * 1e-3;
    }
    assert!((counted / expected).sqrt() < 1.1, "{counted} {expected}");
    assert!((ends / expected).sqrt() > 5.0, "{ends} {expected}");
}

#[test]
fn measured_velocities_replace_the_derived_ones_of_aperiodic_runs() {
    let mut run = at_rest_first();
    let settings = Settings { measured_velocities: true, trim: 0.5, ..Settings::default() };
    let derived = Experiment::prepare(&run, &Settings { measured_velocities: false, ..settings.clone() }).unwrap();
    let measured = Experiment::prepare(&run, &settings).unwrap();
    assert_eq!(measured.motion.samples(), 9001 - 2 * 500, "half a second is cut off each end");
    let difference = |other: &Experiment| (&other.motion.dq - &derived.motion.dq).rows(100, 7800).amax();
    assert!(difference(&measured) < 0.05, "the true velocity is the derivative of the position");
    // A different measured velocity is used, and the acceleration is its derivative.
    run.dq.as_mut().unwrap().scale_mut(2.0);
    let doubled = Experiment::prepare(&run, &settings).unwrap();
    assert!((&doubled.motion.dq - &measured.motion.dq * 2.0).amax() < 1e-9);
    assert!((&doubled.motion.ddq - &measured.motion.ddq * 2.0).amax() < 1e-7);
    assert_eq!(doubled.motion.q, measured.motion.q);
    // Perturbed positions do not change them.
    let (rows, columns) = doubled.grid();
    assert_eq!(doubled.moved(&DMatrix::from_element(rows, columns, 1e-3)).dq, doubled.motion.dq);
    // Measured velocities of a periodic run are ignored; another length is an error.
    let periodic = Experiment::prepare(&Run { period: Some(9.0), ..run.clone() }, &settings).unwrap();
    assert!(periodic.motion.dq.amax() < 1.5 * PI);
    run.dq = Some(DMatrix::zeros(7, 2));
    assert!(matches!(Experiment::prepare(&run, &settings), Err(EstimateError::Signal { .. })));
}

#[test]
fn too_few_and_too_short_periods_are_errors() {
    let settings = Settings { skip_periods: 2, ..Settings::default() };
    let error = Experiment::prepare(&run(Some(2.0), 4.5), &settings).unwrap_err();
    assert_eq!(error, EstimateError::Periods { run: "test".into(), found: 2, skipped: 2, period: 2.0 });
    assert!(matches!(
        Experiment::prepare(&run(Some(0.001), 4.5), &Settings::default()),
        Err(EstimateError::Period { .. })
    ));
}

/// Torque of an inertia of 2 kg m2 in each joint.
pub(super) fn inertia(motion: &Motion) -> DMatrix<f64> {
    2.0 * &motion.ddq
}

pub(super) fn kept_periods() -> Settings {
    Settings { keep_periods: true, ..Settings::default() }
}

#[test]
fn a_period_is_compared_with_the_model_along_its_own_motion() {
    // Every period swings wider than the one before, and its torque with it.
    let mut run = run(Some(2.0), 16.0);
    for (k, t) in run.t.clone().into_iter().enumerate() {
        for j in 0..2 {
            let (w, growth) = (PI * (j + 1) as f64, 5e-5);
            let (sin, cos) = (w * t).sin_cos();
            run.q[(k, j)] = (1.0 + growth * t) * sin;
            run.tau[(k, j)] = 2.0 * (2.0 * growth * w * cos - w * w * run.q[(k, j)]);
        }
    }
    let mut experiment = Experiment::prepare(&run, &kept_periods()).unwrap();
    let noise = |experiment: &Experiment| experiment.scatter.as_ref().unwrap().std_of_mean(|f| f64::from(f < 16.0));
    let before = noise(&experiment);
    experiment.follow_own_motion(inertia);
    let after = noise(&experiment);
    assert!(before.iter().zip(&after).all(|(before, after)| *after < 0.1 * before), "{before:?} {after:?}");
    // The raw samples scatter as they did.
    assert!(experiment.scatter.unwrap().std[0] > 1e-3);
}

#[test]
fn a_start_from_standstill_is_not_in_the_mean_period() {
    let mut run = run(Some(2.0), 16.0);
    for (k, t) in run.t.clone().into_iter().enumerate() {
        let tick = ((k * k) as f64 * 0.618_034).fract() - 0.5;
        run.q[(k, 0)] += 1e-5 * tick + 0.01 * (-t / 0.1).exp();
    }
    let experiment = Experiment::prepare(&run, &kept_periods()).unwrap();
    assert!((0.3..1.2).contains(&experiment.settling), "{} s", experiment.settling);
    let q = experiment.motion.q.column(0);
    let worst = (0..q.len()).map(|k| (q[k] - (PI * k as f64 * 1e-3).sin()).abs()).fold(0.0, f64::max);
    assert!(worst < 5e-5, "{worst}");
    assert!(experiment.repeats.unwrap().counted[..100].iter().all(|counted| !counted));
}

/// Three periods of 2 s that differ by 0.6 mrad, as where a payload is picked up after the second: lost samples and drop-outs leave the mean as it is.
#[test]
fn lost_samples_and_drop_outs_do_not_move_the_mean_of_periods_that_differ() {
    let mut whole = run(Some(2.0), 6.0);
    for k in 4000..whole.t.len() {
        whole.q[(k, 0)] += 6e-4;
        whole.tau[(k, 0)] += 0.5;
    }
    // Noise, without which no drop-out differs from a signal that is zero.
    for (k, tau) in whole.tau.iter_mut().enumerate() {
        *tau += 5.0 + 1e-3 * ((k * 7919 % 1000) as f64 / 500.0 - 1.0);
    }
    let mut torn = whole.clone();
    // The first period is left out at this phase; the third has lost a sample within the drop-out of the second.
    torn.tau.view_mut((2500, 0), (200, 1)).fill(0.0);
    let lost = [600, 1300, 2900, 4580, 5200];
    for row in lost.into_iter().rev() {
        torn.t.remove(row);
        (torn.q, torn.tau) = (torn.q.remove_row(row), torn.tau.remove_row(row));
    }
    let out = crate::ExcludedSpan { run: "test".into(), from: 0.4, to: 0.8 };
    let settings = Settings { leave_out: vec![out], ..kept_periods() };
    let [whole, torn] = [whole, torn].map(|run| Experiment::prepare(&run, &settings).unwrap());
    assert_eq!((torn.sampling.missing, torn.replaced[0]), (5, 200));
    // Where the third period stands in for the second, it is above it by what they differ on both sides.
    assert!((&torn.tau - &whole.tau).amax() < 0.01, "{}", (&torn.tau - &whole.tau).amax());
    assert!((&torn.motion.ddq - &whole.motion.ddq).amax() < 0.5, "{}", (&torn.motion.ddq - &whole.motion.ddq).amax());
    // Its deviation there is that of two samples, and no noise.
    let repeats = torn.repeats.as_ref().unwrap();
    assert!((2500..2700).all(|row| !repeats.counted[row] && repeats.tau[(row, 0)] == 0.0) && repeats.counted[2900]);
    let std = |experiment: &Experiment| experiment.scatter.as_ref().unwrap().std[0];
    assert!((std(&torn) / std(&whole) - 1.0).abs() < 0.1, "{} {}", std(&torn), std(&whole));
}

/// Where the torques of the one settled period are lost for long, motion and torques are those of the other, which is not; a spike is bridged by a line.
#[test]
fn a_drop_out_where_the_other_period_has_not_settled_is_no_line_and_a_spike_is_one() {
    // The last goes across the end of the period, and no other period has it: a cubic from end to end.
    for (far, first, lost, most) in
        [(0.002, 2400, 200, 0.1), (0.1, 2200, 200, 0.1), (0.01, 2400, 2, 0.1), (0.1, 1900, 200, 0.5)]
    {
        let mut run = run(Some(2.0), 4.0);
        for (k, t) in run.t.clone().into_iter().enumerate() {
            for j in 0..2 {
                let w = PI * (j + 1) as f64;
                let tick = ((k * k) as f64 * 0.618_034).fract() - 0.5;
                let start = far * (-t / 0.15).exp();
                run.q[(k, j)] = (w * t).sin() + start + 1e-6 * tick;
                run.tau[(k, j)] = 2.0 * (start / (0.15 * 0.15) - w * w * (w * t).sin()) + 1e-3 * tick;
            }
        }
        run.tau.view_mut((first, 0), (lost, 2)).fill(if lost > 2 { 0.0 } else { 300.0 });
        // A sample that is lost in the middle does not part a drop-out.
        let row = first + lost / 2;
        run.t.remove(row);
        (run.q, run.tau) = (run.q.remove_row(row), run.tau.remove_row(row));
        let experiment = Experiment::prepare(&run, &kept_periods()).unwrap();
        assert!(experiment.settling > 0.6, "{} s", experiment.settling);
        let error = inertia(&experiment.motion) - &experiment.tau;
        let error = experiment.filter(&DMatrix::from_column_slice(error.len(), 1, error.as_slice())).amax();
        // A line across the drop-out would be off by 0.9 Nm, one across what the periods differ by 0.2 Nm, the other period instead of the spike by 0.3 Nm.
        // Across the end of the period, the unsettled start in its place would be off by 33 Nm.
        assert!(error < most, "{lost} samples from {first}: {error} Nm");
    }
}
