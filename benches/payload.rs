//! The body on the flange from 20 s of wrist motion, on the simulated Panda on the wall: `cargo bench --bench payload`.
//!
//! `RUNS` (50) seeds, each with a model that was identified from noise of its own, and 20 s with the body. One plan, found by `plumbline payload --plan`.
//! Errors of mass and centre of mass, and how often the 95 % intervals hold the truth. The figures are in docs/results/external-torque.md.

use plumbline_core::{parallel, threads};
use plumbline_excite::PeriodicMotion;
use plumbline_identify::payload::find;
use plumbline_identify::{Experiment, Settings};
use plumbline_model::{Body, Mounting};
use plumbline_sim::Response;
use plumbline_testkit::scene::external::Bench;
use std::process::Command;

const MASS: f64 = 0.73;
const COM: [f64; 3] = [0.01, -0.02, 0.15];

fn main() {
    let runs: u64 = std::env::var("RUNS").ok().and_then(|runs| runs.parse().ok()).unwrap_or(50);
    for coloured in [0.0, 0.1] {
        campaign(coloured, runs);
    }
}

fn campaign(coloured: f64, runs: u64) {
    let bench = Bench::new(coloured);
    let known = bench.response(false, 6, Mounting::WALL);
    let folder = tempfile::tempdir().expect("a folder");
    let [model, plan] = ["model.toml", "wrist.toml"].map(|name| folder.path().join(name));
    let first = bench.identify(&bench.record(&known, Mounting::WALL, 1));
    std::fs::write(&model, first.file().to_toml()).expect("a file");
    let mut program = Command::new(env!("CARGO_BIN_EXE_plumbline"));
    let done = program
        .args(["payload".as_ref(), model.as_os_str(), "--plan".as_ref(), plan.as_os_str()])
        .output()
        .expect("the program");
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    print!("\ncoloured noise of {coloured} Nm\n{}", String::from_utf8_lossy(&done.stdout));

    let text = std::fs::read_to_string(&plan).expect("a plan");
    let plan = plumbline_excite::parse_plan("wrist.toml", &text).expect("a plan");
    let motion = plan.fourier().expect("a plan");
    let reference = PeriodicMotion::new(&motion, 1).expect("a plan");
    let effect = format!(
        "\n[[effect]]\nid = \"payload\"\nmass = {MASS}\ncom = [{}, {}, {}]\ninertia = [0.001, 0.0, 0.0, 0.0025, 0.0, 0.0017]\n",
        COM[0], COM[1], COM[2]
    );
    let truth = bench.with_effect(&effect);
    let periods = (20.0 / motion.period).round() as usize;
    let loaded =
        Response::simulate(&bench.chain, &truth, Mounting::WALL, &reference, reference.period_ticks(), periods)
            .expect("truth fits the chain");
    let seeds: Vec<u64> = (1..=runs).collect();
    let found = parallel(&seeds, threads(), |seed| {
        let own = bench.identify(&bench.record(&known, Mounting::WALL, *seed));
        let run = bench.record(&loaded, Mounting::WALL, 1000 + seed);
        let experiment = Experiment::prepare(&run, &Settings::default()).expect("a recording");
        let found = find(&own.model, Some(&own.uncertainty), &[experiment]).expect("a motion of the wrist");
        let body = Body::of(&found.values);
        let std = found.spread.covariance[(9, 9)].sqrt();
        (
            (body.mass / MASS - 1.0) * 100.0,
            (body.com - nalgebra::Vector3::from(COM)) * 1e3,
            (body.mass - MASS).abs() < 1.96 * std,
        )
    });
    let rms = |values: &mut dyn Iterator<Item = f64>| (values.map(|x| x * x).sum::<f64>() / runs as f64).sqrt();
    let mut masses: Vec<f64> = found.iter().map(|(mass, ..)| mass.abs()).collect();
    let mut centres: Vec<f64> = found.iter().map(|(_, com, _)| com.norm()).collect();
    masses.sort_by(f64::total_cmp);
    centres.sort_by(f64::total_cmp);
    let at = |values: &[f64], share: f64| values[((values.len() - 1) as f64 * share).round() as usize];
    println!(
        "error of the mass [%]: RMS {:.3}, 95 % of the runs within {:.3}, worst {:.3}",
        rms(&mut masses.iter().copied()),
        at(&masses, 0.95),
        at(&masses, 1.0)
    );
    println!(
        "error of the centre of mass [mm]: RMS {:.3}, 95 % within {:.3}, worst {:.3}",
        rms(&mut centres.iter().copied()),
        at(&centres, 0.95),
        at(&centres, 1.0)
    );
    println!("RMS per axis [mm]: {:.3?}", [0, 1, 2].map(|i| rms(&mut found.iter().map(|(_, com, _)| com[i]))));
    let held = found.iter().filter(|(.., held)| *held).count();
    println!("95 % intervals of the mass that hold the truth: {held} of {runs}");
    let both = found.iter().filter(|(mass, com, _)| mass.abs() <= 0.3 && com.norm() <= 1.0).count();
    println!("within 0.3 % and 1 mm: {both} of {runs}");
}
