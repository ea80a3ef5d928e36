//! The estimators against each other and against simulated truth, each on its intended data.

use plumbline_identify::solve::{Equations, Estimator, Identification, Options, Outcome, identify_with};
use plumbline_identify::{EstimateError, Experiment, Run, Settings};
use plumbline_model::term::effect::{self, Site, Spec};
use plumbline_testkit::scene;
use plumbline_testkit::scene::{Coloured, Extra, Scene};
use std::sync::LazyLock;

static SCENE: LazyLock<Scene> = LazyLock::new(Scene::panda_on_the_wall);

fn prepare(run: &Run) -> Experiment {
    Experiment::prepare(run, &Settings { keep_periods: true, ..Settings::default() }).unwrap()
}

fn with(estimator: Estimator, experiments: &[Experiment]) -> Identification {
    identify_with(&SCENE.structure, experiments, &Options { estimator, essential: false }).unwrap()
}

/// Errors in standard deviations.
fn z(found: &Identification) -> Vec<f64> {
    let each = found.beta.iter().zip(&found.std).zip(&SCENE.beta);
    each.map(|((beta, std), truth)| (beta - truth) / std.expect("determined")).collect()
}

fn mean_square(values: &[f64]) -> f64 {
    values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64
}

/// Root mean square of the errors, each in units of a given standard deviation.
fn error(found: &Identification, unit: &[f64]) -> f64 {
    let each = found.beta.iter().zip(&SCENE.beta).zip(unit);
    mean_square(&each.map(|((beta, truth), unit)| (beta - truth) / unit).collect::<Vec<_>>()).sqrt()
}

/// Cramer-Rao bound of the parameters' standard deviations.
fn bound(periods: usize) -> Vec<f64> {
    SCENE.bound(periods).diagonal().iter().map(|variance| variance.sqrt()).collect()
}

#[test]
fn the_scene_draws_the_noise_of_the_arm_s_sensors() {
    use plumbline_excite::{PeriodicMotion, parse_plan};
    // The second of two periods, as in the scene: sensor for sensor the same numbers as the arm's own, once its generator stands there.
    let plan = parse_plan("wall.toml", plumbline_testkit::scene::WALL_PLAN).unwrap();
    let reference = PeriodicMotion::new(&plan.fourier().unwrap(), 2).unwrap();
    let mut arm = scene::still(SCENE.structure.chain(), &SCENE.truth, SCENE.mounting, &plan.q0, 42);
    let samples = SCENE.motion.samples();
    let mut states = Vec::new();
    scene::drive(&mut arm, &reference, 2 * samples, |tick, state, _| {
        if tick >= samples {
            states.push(*state);
        }
    });
    // The arm gives one state before the first sample of the motion.
    let run = SCENE.record_after(samples + 1, 1, 42, Extra::default());
    for (k, state) in states.iter().enumerate() {
        for j in 0..7 {
            assert_eq!((state.q[j], state.tau[j]), (run.q[(k, j)], run.tau[(k, j)]), "sample {k}, joint {}", j + 1);
        }
    }
}

#[test]
fn the_bound_agrees_in_time_and_frequency_domain() {
    let (time, frequency) = (SCENE.bound(3), SCENE.bound_coloured(3, Coloured::of(0.0)));
    for c in 0..time.nrows() {
        assert!((frequency[(c, c)] / time[(c, c)] - 1.0).abs() < 1e-8, "{c}");
    }
    let coloured = SCENE.bound_coloured(3, Coloured::of(0.1));
    assert!((0..time.nrows()).all(|c| coloured[(c, c)] > 2.0 * time[(c, c)]));
}

#[test]
fn with_good_data_all_estimators_agree_with_correct_standard_deviations() {
    let experiment = [prepare(&SCENE.record(10, 1))];
    let unit = bound(10);
    for estimator in Estimator::ALL {
        let found = with(estimator, &experiment);
        let (z, error) = (mean_square(&z(&found)), error(&found, &unit));
        println!("{}: error {error:.3} of the bound, mean z2 {z:.3}, rounds {}", estimator.id(), found.rounds);
        assert_eq!((found.estimator, found.outcome, found.rank), (estimator, Outcome::Settled, 59));
        assert!((0.5..1.7).contains(&z), "{}: mean squared z-score {z}", estimator.id());
        // Equal weights are less precise: the wrist's sensors have less noise than the shoulder's.
        let most = if estimator == Estimator::Ols { 2.5 } else { 1.3 };
        assert!(error < most, "{}: {error} times the bound", estimator.id());
    }
}

#[test]
fn equations_that_are_kept_identify_a_structure_with_more_terms() {
    let experiments = [prepare(&SCENE.record(3, 1)), prepare(&SCENE.record(3, 2))];
    let spec = Spec { family: "spring", form: "linear", site: Site::Joint(3), settings: vec![] };
    let terms = effect::assemble(&[spec], &SCENE.structure.operating_point(&SCENE.beta)).unwrap();
    let more = SCENE.structure.clone().with(terms).unwrap();
    let kept = Equations::of(SCENE.structure.clone(), &experiments).unwrap();
    let options = Options::default();
    let found = kept.extended(more.clone()).unwrap().identify(&options).unwrap();
    let expected = identify_with(&more, &experiments, &options).unwrap();
    assert_eq!((&found.beta, &found.std), (&expected.beta, &expected.std));
    assert!(found.beta.len() > SCENE.beta.len());
    assert_eq!(kept.identify(&options).unwrap().beta, with(Estimator::Wls, &experiments).beta);
}

#[test]
fn outliers_bias_least_squares_and_not_huber() {
    let extra = Extra { outliers: 0.0, ..Extra::default() };
    let mut run = SCENE.record_with(4, 2, extra);
    // Two contacts of 8 Nm for 0.4 s.
    for (first, joint) in [(3000, 1), (17000, 3)] {
        for k in first..first + 400 {
            run.tau[(k, joint)] += 8.0;
        }
    }
    let experiment = [prepare(&run)];
    let unit = bound(4);
    let (wls, huber) = (with(Estimator::Wls, &experiment), with(Estimator::Huber, &experiment));
    let (of_wls, of_huber) = (error(&wls, &unit), error(&huber, &unit));
    println!("contacts: wls {of_wls:.2}, huber {of_huber:.2} of the bound, z2 {:.2}", mean_square(&z(&huber)));
    assert!(of_wls > 3.0 * of_huber, "{of_wls} {of_huber}");
    assert!(of_huber < 2.0, "{of_huber}");
    let weights = huber.row_weights.as_ref().unwrap();
    let low = weights.iter().filter(|weight| **weight < 0.3).count();
    assert!((1..60).contains(&low), "{low} of {} equations have small weights", weights.len());
}

#[test]
fn noisy_positions_bias_no_estimator_where_periods_tell_their_noise() {
    // Encoders of 1 mrad noise, and filters so wide that the accelerations' noise reaches the regressor: least squares would be off by 14 and, with
    // weights, 5.5 of IV's standard deviations if it were not taken off the mean.
    let extra = Extra { position: 1e-3, ..Extra::default() };
    let settings =
        Settings { position_cutoff: Some(15.0), torque_cutoff: 15.0, keep_periods: true, ..Settings::default() };
    let experiment = [Experiment::prepare(&SCENE.record_with(10, 30, extra), &settings).unwrap()];
    let found = [Estimator::Ols, Estimator::Wls, Estimator::Iv, Estimator::Tls].map(|one| with(one, &experiment));
    let iv_std: Vec<f64> = found[2].std.iter().map(|std| std.unwrap()).collect();
    let errors = found.each_ref().map(|found| error(found, &iv_std));
    let z2 = found.each_ref().map(|found| mean_square(&z(found)));
    println!("ols, wls, iv, tls: errors {errors:.2?} in IV's standard deviations, mean z2 {z2:.2?}");
    assert!(z2.iter().all(|z2| *z2 < 2.5) && errors.iter().all(|error| *error < 1.3), "{errors:?} {z2:?}");
}

#[test]
fn the_desired_motion_is_an_instrument_of_an_aperiodic_run() {
    let run = SCENE.record(1, 5);
    let error =
        identify_with(&SCENE.structure, &[prepare(&run)], &Options { estimator: Estimator::Iv, essential: false })
            .unwrap_err();
    assert!(matches!(error, EstimateError::NoInstruments { .. }), "{error}");
    let experiment = prepare(&run).with_desired(&run.t, &SCENE.motion.q).unwrap();
    let found = with(Estimator::Iv, &[experiment]);
    let z = mean_square(&z(&found));
    assert!((0.4..2.0).contains(&z), "{z}");
}

#[test]
fn the_full_covariance_improves_estimates_under_correlated_noise() {
    // Correlated torque noise of joints 2 and 4, as from a swaying base.
    let mut run = SCENE.record(6, 6);
    let common = SCENE.record_with(6, 7, Extra { coloured: Coloured::of(1.0), ..Extra::default() });
    for k in 0..run.t.len() {
        let shared = common.tau[(k, 0)] - SCENE.tau[(k % SCENE.motion.samples(), 0)];
        run.tau[(k, 1)] += 0.5 * shared;
        run.tau[(k, 3)] += 0.5 * shared;
    }
    let experiment = [prepare(&run)];
    let (alone, full) = (with(Estimator::Wls, &experiment), with(Estimator::WlsFull, &experiment));
    let gain: Vec<f64> = full.std.iter().zip(&alone.std).map(|(full, alone)| full.unwrap() / alone.unwrap()).collect();
    println!(
        "std full over diagonal {:.3}, z2 {:.2} {:.2}",
        mean_square(&gain).sqrt(),
        mean_square(&z(&alone)),
        mean_square(&z(&full))
    );
    assert!(mean_square(&gain).sqrt() < 0.9);
    for found in [&alone, &full] {
        assert!((0.4..2.2).contains(&mean_square(&z(found))), "{}", found.estimator.id());
    }
}

#[test]
fn essential_parameters_are_the_significant_ones() {
    let experiment = [prepare(&SCENE.record(2, 8))];
    let options = Options { estimator: Estimator::Wls, essential: true };
    let found = identify_with(&SCENE.structure, &experiment, &options).unwrap();
    let whole = with(Estimator::Wls, &experiment);
    println!("dropped {:?}", found.dropped.iter().map(|d| d.name.as_str()).collect::<Vec<_>>());
    assert!((3..40).contains(&found.dropped.len()), "{}", found.dropped.len());
    for dropped in &found.dropped {
        let c = found.columns.iter().position(|column| column.name == dropped.name).unwrap();
        assert_eq!((found.beta[c], found.std[c]), (0.0, None));
        // Eliminated parameters are not significantly different from zero.
        assert!(SCENE.beta[c].abs() < 5.0 * whole.std[c].unwrap(), "{}", dropped.name);
    }
    // The remaining ones have smaller standard deviations and equal residuals.
    let gain: Vec<f64> =
        found.std.iter().zip(&whole.std).filter_map(|(reduced, std)| Some((*reduced)? / std.unwrap())).collect();
    println!("std over that of the whole model {:.3}", mean_square(&gain).sqrt());
    assert!(mean_square(&gain).sqrt() < 0.99 && gain.iter().all(|gain| *gain < 1.1), "{gain:.3?}");
    for (reduced, whole) in found.rms.raw.iter().zip(&whole.rms.raw) {
        assert!((reduced / whole - 1.0).abs() < 0.01);
    }
    let relative = found.relative_std();
    let worst = |all: &[Option<f64>]| all.iter().flatten().copied().fold(0.0, f64::max);
    assert!(worst(&relative) < worst(&whole.relative_std()));
}

#[test]
fn aperiodic_runs_with_coloured_noise_have_correct_intervals() {
    // One long motion without repeats: three different stretches of noise on forty seconds each, treated as no period.
    let mut all = Vec::new();
    let mut within = (0, 0);
    for seed in 0..6 {
        let mut run = SCENE.record_with(6, 60 + seed, Extra { coloured: Coloured::of(0.1), ..Extra::default() });
        run.period = None;
        let found = with(Estimator::Wls, &[prepare(&run)]);
        let z = z(&found);
        within.0 +=
            z.iter().zip(&found.freedom).filter(|(z, f)| z.abs() < plumbline_identify::solve::student_975(**f)).count();
        within.1 += z.len();
        all.extend(z);
    }
    let share = within.0 as f64 / within.1 as f64;
    println!("aperiodic: mean z2 {:.3}, {share:.3} inside 95 %", mean_square(&all));
    assert!((0.7..1.5).contains(&mean_square(&all)), "{}", mean_square(&all));
    assert!((0.90..0.985).contains(&share), "{share}");
}
