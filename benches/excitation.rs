//! How good a motion the optimiser finds for a Panda on a wall, and how fast: `cargo bench --bench excitation [-- SECONDS]`.
//!
//! N = 5 harmonics, T = 10 s, 59 columns, every limit that a plan can be held to, Table III of the paper as nominal model, all
//! threads of the machine, each definition of the condition number optimised for itself. Once with the margins that plans have by
//! default, once up to the limits themselves.

use plumbline::store::ModelFile;
use plumbline_excite::{
    Bounds, Criterion, Margins, Nominal, Problem, Progress, Search, SearchControl, optimise, verify_with_guard,
};
use plumbline_model::{Mounting, Reduction, Robot, Structure};
use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

/// A plan with a raw condition number below this is a good one.
const GOOD: f64 = 40.0;

fn main() {
    let seconds = std::env::args().skip(1).find_map(|arg| arg.parse::<f64>().ok()).unwrap_or(60.0);
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let robot = Robot::load("panda", None).expect("a shipped robot");
    let table3 = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/models/panda-paper-table3.toml");
    let model = ModelFile::load(&table3, |_| Ok(robot.chain.clone())).expect("a shipped model").model;
    let nominal = Nominal::of(&model).expect("terms with gradients");
    let reduction = Reduction::in_mounting(&robot.chain, &Mounting::WALL);
    let structure = Structure::of(robot.chain.clone(), reduction, &["friction"]).expect("a known term");
    let sigma: Vec<f64> = robot.limits.tau[..7].iter().map(|tau| tau * 1e-3).collect();
    println!("Panda on the wall, {} columns, {seconds} s each, {threads} threads", structure.columns().len());
    for (margins_name, margins) in [("default margins", Margins::default()), ("up to the limits", Margins::none())] {
        let bounds = Bounds {
            workspace: Some(&robot.workspace),
            shape: Some(&robot.shape),
            links_in_box: true,
            ..Bounds::new(&robot.chain, &robot.limits, margins)
        };
        let problem = Problem {
            robot: "panda",
            structure: &structure,
            mounting: Mounting::WALL,
            bounds,
            nominal: Some(&nominal),
            sigma: &sigma,
            q0: None,
        };
        for criterion in [Criterion::Raw, Criterion::RawRigid, Criterion::Equilibrated] {
            let start = Instant::now();
            // When each better motion was there.
            let steps: Mutex<Vec<(f64, f64)>> = Mutex::new(Vec::new());
            let hear = |now: Progress| {
                let mut steps = steps.lock().expect("no thread panics");
                if now.best < steps.last().map_or(f64::INFINITY, |last| last.1) {
                    steps.push((start.elapsed().as_secs_f64(), now.best));
                }
            };
            let stop = || start.elapsed().as_secs_f64() > seconds;
            let search = Search { criterion, rounds: 100_000, ..Search::default() };
            let plan = optimise(&problem, &search, &[], &SearchControl { threads, stop: &stop, progress: &hear });
            let plan = plan.expect("a motion");
            let took = start.elapsed().as_secs_f64();
            assert!(verify_with_guard(&problem, &plan.fourier().expect("a motion")).is_feasible());
            let c = plan.conditions;
            let value = match criterion {
                Criterion::RawRigid => c.raw_rigid,
                Criterion::Equilibrated => c.equilibrated,
                _ => c.raw,
            };
            println!("{margins_name:17} {criterion:?}: {value:.2} after {took:.1} s");
            println!(
                "{:17} all definitions: raw {:.1} ({:.1}), equilibrated {:.2} ({:.2}), weighted {:.0} ({:.0})",
                "", c.raw, c.raw_rigid, c.equilibrated, c.equilibrated_rigid, c.weighted, c.weighted_rigid
            );
            let steps = steps.into_inner().expect("no thread panics");
            let at =
                |most: f64| steps.iter().find(|step| step.1 < most).map_or("never".into(), |s| format!("{:.1} s", s.0));
            if criterion == Criterion::Raw {
                println!("{:17} first motion below {GOOD}: {}", "", at(GOOD));
            }
            let trace: Vec<String> = steps.iter().map(|(time, best)| format!("{time:.1} s {best:.2}")).collect();
            println!("{:17} {}", "", trace.join(", "));
        }
    }
}
