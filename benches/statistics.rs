//! Statistics of the identification over many simulated runs of the Panda on the wall: `cargo bench --bench statistics`.
//!
//! One plan, the simulated arm with its controller, friction, sensor noise and rounding; every run is recorded with noise of its own and
//! goes through the whole identification. Parts by name, all by default: `cargo bench --bench statistics -- runs signal estimators
//! aperiodic`; `estimators huber iv` for some of them. `RUNS=n` changes the number of runs. The figures are in docs/results/identification.md and
//! docs/results/estimators.md.

use plumbline_identify::solve::{Estimator, Identification, Options, identify_with};
use plumbline_identify::{Derivative, Experiment, Method, Run, Settings};
use plumbline_testkit::scene::campaign::Campaign;
use plumbline_testkit::scene::{Coloured, Extra, Scene};
use std::time::Instant;

const PERIODS: usize = 10;

fn main() {
    let parts: Vec<String> = std::env::args().skip(1).filter(|part| !part.starts_with("--")).collect();
    let runs = std::env::var("RUNS").ok().and_then(|runs| runs.parse().ok());
    let wanted = |part: &str| parts.is_empty() || parts.iter().any(|own| own == part);
    let scene = Scene::panda_on_the_wall();
    let start = Instant::now();
    if wanted("runs") {
        whole(&scene, runs.unwrap_or(200));
    }
    if wanted("signal") {
        signal(&scene, runs.unwrap_or(30));
    }
    if wanted("estimators") {
        estimators(&scene, runs.unwrap_or(16), &parts);
    }
    if wanted("aperiodic") {
        aperiodic(&scene, runs.unwrap_or(100));
    }
    println!("\n{:.0} s", start.elapsed().as_secs_f64());
}

fn identify(scene: &Scene, run: &Run, settings: &Settings, estimator: Estimator) -> Identification {
    let settings = Settings { keep_periods: estimator.needs_periods(), ..settings.clone() };
    let experiment = Experiment::prepare(run, &settings).unwrap();
    identify_with(&scene.structure, &[experiment], &Options { estimator, essential: false }).unwrap()
}

/// The default identification, parameter by parameter.
fn whole(scene: &Scene, runs: usize) {
    let settings = Settings::default();
    let bound = scene.bound(PERIODS);
    let of = Campaign::of(scene, runs, &bound, |seed| {
        identify(scene, &scene.record(PERIODS, seed), &settings, Estimator::Wls)
    });
    println!("\n{runs} runs of {PERIODS} periods, weighted least squares, default signal processing");
    println!("parameter | truth | bound | error/bound | bias/bound | claimed/error | inside 95 %");
    for (c, name) in of.names.iter().enumerate() {
        println!(
            "{name} | {:.5} | {:.2e} | {:.3} | {:+.3} | {:.3} | {:.1} %",
            scene.beta[c],
            of.bound[c],
            of.error[c] / of.bound[c],
            of.bias[c] / of.bound[c],
            of.claimed[c] / of.error[c],
            100.0 * of.covered[c]
        );
    }
    let mut covered = of.covered.clone();
    covered.sort_by(f64::total_cmp);
    println!("95 % intervals that hold the truth: {:.2} % of {}", 100.0 * of.coverage(), runs * of.names.len());
    println!("    per parameter: {:.1} % to {:.1} %", 100.0 * covered[0], 100.0 * covered[covered.len() - 1]);
    println!("errors over the Cramer-Rao bound: {:.3} together", of.over_bound());
    println!("    worst parameter {:?}", of.worst(|c| of.error[c] / of.bound[c]));
    println!("    largest bias over the bound {:?}", of.worst(|c| of.bias[c].abs() / of.bound[c]));
    println!("    claimed over bound, worst {:?}", of.worst(|c| of.claimed[c] / of.bound[c]));
    println!("torque error on an unseen motion [mNm]: {:.3?}", of.torque.iter().map(|t| 1e3 * t).collect::<Vec<_>>());
}

const HEAD: &str = "errors over bound | worst | claimed over errors | inside 95 % | torque error on an unseen motion";

/// The paper's signal processing and the default one.
fn signal(scene: &Scene, runs: usize) {
    let usual = Settings::default();
    let with = |torque: f64, position: f64| Settings {
        torque_cutoff: torque,
        position_cutoff: Some(position),
        ..usual.clone()
    };
    let ways = [
        ("paper: order 20, 2 Hz, central differences", Method::Paper.settings()),
        ("paper's, spectral derivatives", Settings { derivative: Derivative::Spectral, ..Method::Paper.settings() }),
        ("spectral, positions 5 Hz", with(5.0, 5.0)),
        ("spectral, positions 10 Hz", with(5.0, 10.0)),
        ("spectral, positions 20 Hz", with(5.0, 20.0)),
        ("spectral, positions 40 Hz", with(5.0, 40.0)),
        ("spectral (default: 5 Hz, positions 80 Hz)", usual.clone()),
        ("default with central differences", Settings { derivative: Derivative::Central, ..usual.clone() }),
        ("spectral, torques 10 Hz", with(10.0, 80.0)),
        ("spectral, torques 2 Hz", with(2.0, 80.0)),
    ];
    println!("\n{runs} runs of {PERIODS} periods, weighted least squares\nsignal processing | {HEAD}");
    let bound = scene.bound(PERIODS);
    for (name, settings) in ways {
        let of = Campaign::of(scene, runs, &bound, |seed| {
            identify(scene, &scene.record(PERIODS, seed), &settings, Estimator::Wls)
        });
        println!("{name} | {}", of.line());
    }
}

/// Every estimator on every kind of disturbance.
fn estimators(scene: &Scene, runs: usize, parts: &[String]) {
    let named = |of: Estimator| parts.iter().any(|part| part == of.id());
    let chosen = |of: &Estimator| named(*of) || !Estimator::ALL.into_iter().any(named);
    let wide = Settings { torque_cutoff: 15.0, position_cutoff: Some(15.0), ..Settings::default() };
    let data = [
        ("as the arm's sensors are", Extra::default(), Settings::default()),
        (
            "and coloured noise of 0.1 Nm",
            Extra { coloured: Coloured::of(0.1), ..Extra::default() },
            Settings::default(),
        ),
        ("and 0.1 % of samples off by 20 sigma", Extra { outliers: 1e-3, ..Extra::default() }, Settings::default()),
        ("and position noise of 1 mrad, filters at 15 Hz", Extra { position: 1e-3, ..Extra::default() }, wide),
    ];
    for (name, extra, settings) in data {
        println!("\n{runs} runs of {PERIODS} periods, {name}\nestimator | {HEAD}");
        let bound = scene.bound_coloured(PERIODS, extra.coloured);
        for estimator in Estimator::ALL.into_iter().filter(chosen) {
            let of = Campaign::of(scene, runs, &bound, |seed| {
                identify(scene, &scene.record_with(PERIODS, seed, extra), &settings, estimator)
            });
            println!("{} | {}", estimator.id(), of.line());
        }
    }
}

/// Records that are declared not to repeat.
fn aperiodic(scene: &Scene, runs: usize) {
    println!("\n{runs} runs of 60 s as if nothing repeated, weighted least squares\nnoise | {HEAD}");
    for (name, coloured) in [("white", Coloured::default()), ("and coloured of 0.1 Nm", Coloured::of(0.1))] {
        let bound = scene.bound_coloured(6, coloured);
        let of = Campaign::of(scene, runs, &bound, |seed| {
            let mut run = scene.record_with(6, seed, Extra { coloured, ..Extra::default() });
            run.period = None;
            identify(scene, &run, &Settings::default(), Estimator::Wls)
        });
        println!("{name} | {}", of.line());
    }
}
