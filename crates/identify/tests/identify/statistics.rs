//! The statistics of docs/results/identification.md in short: coverage of the intervals, and errors relative to the bound.
//! `cargo bench --bench statistics` is the long form.

use plumbline_identify::solve::identify;
use plumbline_identify::{Experiment, Method, Settings};
use plumbline_testkit::scene::campaign::Campaign;
use plumbline_testkit::scene::{Coloured, Extra, Scene};

const RUNS: usize = 16;
const PERIODS: usize = 10;

fn campaign(scene: &Scene, runs: usize, settings: &Settings) -> Campaign {
    Campaign::of(scene, runs, &scene.bound(PERIODS), |seed| {
        let experiment = Experiment::prepare(&scene.record(PERIODS, 1000 + seed), settings).unwrap();
        identify(&scene.structure, &[experiment]).unwrap()
    })
}

#[test]
fn intervals_have_their_coverage_and_errors_are_near_the_bound() {
    let scene = Scene::panda_on_the_wall();
    let usual = campaign(&scene, RUNS, &Settings::default());
    println!("{}", usual.line());
    // 944 correlated intervals: their share scatters by about 1.5 % round 95 %.
    assert!((0.915..0.98).contains(&usual.coverage()), "{}", usual.coverage());
    assert!(usual.over_bound() < 1.1, "{}", usual.over_bound());
    // No parameter is biased: its mean error over the runs is within its standard deviation.
    for (c, name) in usual.names.iter().enumerate() {
        let bias = usual.bias[c] / usual.bound[c] * (RUNS as f64).sqrt();
        assert!(bias.abs() < 4.0, "{name}: mean error {bias:.2} of its standard deviations");
    }

    // Slow noise with its corner at 0.3 Hz. Weights that are white in time give 1.41 and 1.78.
    for (std, most) in [(0.03, 1.2), (0.1, 1.4)] {
        let coloured = Coloured { std, time: 0.53 };
        let slow = Campaign::of(&scene, RUNS, &scene.bound_coloured(PERIODS, coloured), |seed| {
            let run = scene.record_with(PERIODS, 3000 + seed, Extra { coloured, ..Extra::default() });
            identify(&scene.structure, &[Experiment::prepare(&run, &Settings::default()).unwrap()]).unwrap()
        });
        println!("slow noise of {std} Nm: {}", slow.line());
        assert!(slow.over_bound() < most, "{}", slow.over_bound());
        assert!((0.915..0.98).contains(&slow.coverage()), "{}", slow.coverage());
    }

    // The paper's signal processing removes the reversals of friction from the motion and is therefore biased.
    let paper = campaign(&scene, 4, &Method::Paper.settings());
    println!("paper: {}", paper.line());
    assert!(paper.over_bound() > 1.5 * usual.over_bound(), "{} {}", paper.over_bound(), usual.over_bound());
}
