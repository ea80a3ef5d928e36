#![allow(dead_code, unused_imports)]
pub use plumbline::{estimate, model};
#[path = "../src/diagnose/mod.rs"]
mod diagnose;
#[path = "../tests/scene/mod.rs"]
mod scene;
use diagnose::evidence::{Evidence, Trial};
use diagnose::fit::Problem;
use diagnose::moments::Columns;
use diagnose::select::Search;
use diagnose::state::State;
use diagnose::{Settings, library};
use plumbline::backend::sim::Truth;
use plumbline::config::robot::Robot;
use plumbline::estimate::experiment::{self, Experiment};
use plumbline::model::base::Reduction;
use plumbline::model::structure::Structure;
use std::time::Instant;

fn main() {
    let chain = Robot::load("panda", None).unwrap().chain;
    let base = std::fs::read_to_string("config/arms/sim-panda.toml").unwrap();
    let [identify, _validate] = scene::lab::plans();
    for effect in std::env::args().skip(1) {
        let text = format!("{base}\n{}", effect.replace(';', "\n"));
        let truth = Truth::parse("truth", &text).unwrap();
        let t0 = Instant::now();
        let runs: Vec<_> = identify
            .iter()
            .enumerate()
            .map(|(k, plan)| {
                scene::lab::period(&chain, &truth, plan, plan.mounting(), &format!("run{k}")).record(
                    &truth,
                    10,
                    scene::lab::Noise { coloured: 0.05 },
                    7 + k as u64,
                )
            })
            .collect();
        let t1 = Instant::now();
        let exps: Vec<Experiment> =
            runs.iter().map(|run| Experiment::prepare(run, &experiment::Settings::default()).unwrap()).collect();
        let t2 = Instant::now();
        let reduction = Reduction::in_mounting(&chain, &identify[0].mounting());
        let structure = Structure::of(chain.clone(), reduction, &["friction"]).unwrap();
        let trials: Vec<Trial> = exps.iter().map(|experiment| Trial { experiment, session: 1 }).collect();
        let settings = Settings { threads: 2, ..Settings::default() };
        let evidence = Evidence::of(&chain, &trials, settings.band);
        let columns = Columns { m: evidence.regressor(&structure, &trials), r: evidence.torques(&trials) };
        let problem = Problem { evidence: &evidence, prior: None };
        let state = State::base(&problem, columns);
        let t3 = Instant::now();
        let ground = structure.ground(state.fit.theta.as_slice());
        let library = library::library(&evidence, &ground, &library::repeatable(), None, 2);
        let t4 = Instant::now();
        println!("== {effect}");
        for j in 0..7 {
            let lof: f64 = (0..7).map(|b| state.fit.rss[j * 7 + b]).sum::<f64>()
                / (0..7).map(|b| state.fit.count[j * 7 + b]).sum::<f64>();
            println!(
                "joint {} floor {:.4} M {:.4} F {:.2} phi {:?}",
                j + 1,
                evidence.floor(j).unwrap_or(f64::NAN),
                state.unmodelled(&evidence, j).sqrt(),
                lof,
                state.fit.phi[j * 7..j * 7 + 7].iter().map(|p| (p * 10.).round() / 10.).collect::<Vec<_>>()
            );
        }
        let search = Search { problem, ground: &ground, library: &library, settings: &settings };
        let selected = search.select(state, &|step| {
            println!(
                "  {} {:?} score {:.1} M {:.4}",
                if step.added { "+" } else { "-" },
                step.item.spec,
                step.score,
                step.unmodelled.sqrt()
            )
        });
        let t5 = Instant::now();
        for (item, found) in selected.state.items.iter().zip(&selected.found) {
            println!(
                "  FOUND {} {} {} {:?} score {:.1} folds {:?} indep {:.3} rms {:.4} share {:.3} rivals {:?}",
                item.spec.family,
                item.spec.form,
                item.spec.site,
                item.spec.settings,
                found.score,
                found.folds,
                found.independence,
                found.relevance.rms[found.relevance.joint],
                found.relevance.share[found.relevance.joint],
                found
                    .rivals
                    .iter()
                    .map(|r| format!(
                        "{} {} {:?} gap {:.1}",
                        r.item.spec.family, r.item.spec.site, r.item.spec.settings, r.gap
                    ))
                    .collect::<Vec<_>>()
            );
        }
        println!(
            "  top: {:?}",
            selected
                .first
                .iter()
                .take(4)
                .map(|s| format!(
                    "{} {} {:.0} indep {:.4}",
                    s.item.spec.family, s.item.spec.site, s.score, s.tried.independence
                ))
                .collect::<Vec<_>>()
        );
        println!(
            "  library {} columns; times: sim {:.1} prepare {:.1} base {:.2} library {:.2} select {:.2}",
            library.iter().map(|c| c.rows.width).sum::<usize>(),
            (t1 - t0).as_secs_f64(),
            (t2 - t1).as_secs_f64(),
            (t3 - t2).as_secs_f64(),
            (t4 - t3).as_secs_f64(),
            (t5 - t4).as_secs_f64()
        );
    }
}
