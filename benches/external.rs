//! The external torque on the simulated Panda on the wall: `cargo bench --bench external [-- coverage alarms pushes]`.
//!
//! | part | what |
//! |---|---|
//! | `coverage` | `RUNS` (200) models, each identified from noise of its own; share of the samples of an unseen motion whose 95 % interval holds 0 |
//! | `alarms` | false alarms in a simulated hour of the unseen motion |
//! | `pushes` | pushes at the flange along the unseen motion: share found within 50 ms |
//!
//! Beside it a fixed threshold on a vendor-style model: 57 parameters that were identified upright, with and without friction.
//! The figures are in docs/results/external-torque.md.

use plumbline_core::{JointVec, parallel, threads};
use plumbline_identify::external::{ObserverSettings, Way};
use plumbline_model::Mounting;
use plumbline_testkit::scene::external::{Bench, Found, States, found_after};
use std::time::Instant;

const PERIODS: usize = 6;
/// Coloured noise of the second arm \[Nm\].
const COLOURED: f64 = 0.1;
const FORCES: [f64; 7] = [0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0];
/// Directions of each of the ten pushes of a force.
const ROUNDS: u64 = 5;
/// Thresholds of libfranka's examples, `setDefaultBehavior` \[Nm\].
const LIBFRANKA: [f64; 7] = [20.0, 20.0, 18.0, 18.0, 16.0, 14.0, 12.0];

/// Whether a detector flags contact at a state.
type Flag = Box<dyn FnMut(&[JointVec; 3]) -> bool>;

fn main() {
    let parts: Vec<String> = std::env::args().skip(1).filter(|part| !part.starts_with("--")).collect();
    let runs = std::env::var("RUNS").ok().and_then(|runs| runs.parse().ok()).unwrap_or(200);
    let wanted = |part: &str| parts.is_empty() || parts.iter().any(|own| own == part);
    let start = Instant::now();
    if wanted("coverage") {
        coverage(runs);
    }
    for coloured in [0.0, COLOURED] {
        if wanted("alarms") || wanted("pushes") {
            detection(coloured, wanted("alarms"), wanted("pushes"));
        }
    }
    println!("\n{:.0} s", start.elapsed().as_secs_f64());
}

fn ways() -> [(&'static str, ObserverSettings); 2] {
    let by = |way| ObserverSettings { way, ..ObserverSettings::default() };
    [("momentum", by(Way::Momentum)), ("acceleration", by(Way::Acceleration))]
}

fn coverage(runs: u64) {
    let bench = Bench::new(COLOURED);
    let (known, unseen) = (bench.response(false, PERIODS, Mounting::WALL), bench.response(true, 2, Mounting::WALL));
    let seeds: Vec<u64> = (1..=runs).collect();
    // Per way and joint.
    let shares: Vec<Vec<[f64; 7]>> = parallel(&seeds, threads(), |seed| {
        let found = bench.identify(&bench.record(&known, Mounting::WALL, *seed));
        ways()
            .iter()
            .map(|(_, settings)| {
                let mut observer = found.observer(Mounting::WALL, *settings);
                let (mut inside, mut count) = ([0.0; 7], 0.0);
                unseen.measure(seed + 100_000, |_, _, state| {
                    let external = observer.next(&state.q, &state.dq, &state.tau);
                    if external.settled {
                        count += 1.0;
                        (0..7).for_each(|j| {
                            inside[j] += f64::from(u8::from(external.tau[j].abs() <= external.half_width[j]));
                        });
                    }
                });
                inside.map(|inside| inside / count)
            })
            .collect()
    });
    println!("\ncoverage of the 95 % interval over {runs} models, coloured noise of {COLOURED} Nm, unseen motion [%]");
    for (w, (name, _)) in ways().iter().enumerate() {
        let mean = |j: usize| shares.iter().map(|of| of[w][j]).sum::<f64>() / runs as f64;
        let joints: Vec<f64> = (0..7).map(|j| 100.0 * mean(j)).collect();
        println!("{name} | all {:.2} | per joint {joints:.1?}", joints.iter().sum::<f64>() / 7.0);
    }
}

/// A detector: its name, and whether each state is flagged.
type Detector<'a> = (String, Box<dyn Fn() -> Flag + 'a>);

fn detection(coloured: f64, alarms: bool, pushes: bool) {
    let bench = Bench::new(coloured);
    let model_in = |mounting: Mounting| {
        let response = bench.response(false, PERIODS, mounting);
        bench.identify(&bench.record(&response, mounting, 1))
    };
    let (own, upright) = (model_in(Mounting::WALL), model_in(Mounting::UPRIGHT));
    let mut frictionless =
        Found { model: upright.model.part(|_| false).expect("the links"), uncertainty: upright.uncertainty.clone() };
    let columns = frictionless.model.structure().columns().len();
    let covariance = &mut frictionless.uncertainty.parameters.covariance;
    *covariance = covariance.view((0, 0), (columns, columns)).into_owned();

    // The smallest fixed thresholds without a false alarm in the hour: no user could choose better ones.
    let hour = bench.response(true, 360, Mounting::WALL);
    let fixed = |of: &Found| {
        let mut observer = of.observer(Mounting::WALL, ObserverSettings::default());
        let mut largest = [0.0f64; 7];
        hour.measure(9, |_, _, state| {
            let external = observer.next(&state.q, &state.dq, &state.tau);
            if external.settled {
                (0..7).for_each(|j| largest[j] = largest[j].max(external.tau[j].abs()));
            }
        });
        largest
    };
    let mut detectors: Vec<Detector> = Vec::new();
    for bandwidth in [10.0, 20.0, 40.0] {
        for (name, settings) in ways() {
            let (own, settings) = (&own, ObserverSettings { bandwidth, ..settings });
            let make = move || {
                let mut observer = own.observer(Mounting::WALL, settings);
                let flag: Flag = Box::new(move |[q, dq, tau]| observer.next(q, dq, tau).contact);
                flag
            };
            detectors.push((format!("{name}, {bandwidth} Hz"), Box::new(make)));
        }
    }
    let vendors = [
        ("fixed threshold, 57 parameters", &upright, fixed(&upright)),
        ("fixed threshold, 57 parameters without friction", &frictionless, fixed(&frictionless)),
        ("libfranka's example thresholds, 57 parameters without friction", &frictionless, LIBFRANKA),
    ];
    for (name, of, thresholds) in vendors {
        let make = move || {
            let mut observer = of.observer(Mounting::WALL, ObserverSettings::default());
            let flag: Flag = Box::new(move |[q, dq, tau]| {
                let external = observer.next(q, dq, tau);
                external.settled && (0..7).any(|j| external.tau[j].abs() > thresholds[j])
            });
            flag
        };
        detectors.push((format!("{name} {thresholds:.2?} Nm"), Box::new(make)));
    }
    println!("\ncoloured noise of {coloured} Nm");
    let observer = own.observer(Mounting::WALL, ObserverSettings::default());
    println!(
        "noise behind the filter [Nm]: {:.4?}",
        observer.noise().iter().map(|noise| noise.std).collect::<Vec<_>>()
    );
    if alarms {
        println!("detector | excursions in {:.0} s of unseen motion", 3.6 * hour.period_ticks() as f64 * 0.1);
        for (name, make) in &detectors {
            let mut flag = make();
            let (mut count, mut last) = (0, f64::NEG_INFINITY);
            hour.measure(9, |_, _, state| {
                if flag(&[state.q, state.dq, state.tau]) {
                    count += u32::from(state.time - last > 0.2);
                    last = state.time;
                }
            });
            println!("{name} | {count}");
        }
    }
    if pushes {
        println!("detector | force [N]: share found within 50 ms of {} pushes [%] (median delay [ms])", 10 * ROUNDS);
        let trials: Vec<Vec<(States, usize)>> = parallel(&FORCES, threads(), |force| {
            (1..=ROUNDS).flat_map(|seed| bench.pushed(*force, seed, Mounting::WALL)).collect()
        });
        for (name, make) in &detectors {
            let mut line = name.clone();
            for (force, trials) in FORCES.iter().zip(&trials) {
                let mut delays: Vec<usize> =
                    trials.iter().filter_map(|(states, pushed)| found_after(states, *pushed, make())).collect();
                delays.sort_unstable();
                let within = delays.iter().filter(|ms| **ms <= 50).count();
                let median = delays.get(delays.len() / 2).map_or("-".into(), usize::to_string);
                line += &format!(" | {force}: {} ({median})", 100 * within / trials.len());
            }
            println!("{line}");
        }
    }
}
