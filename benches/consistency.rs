//! Time to the nearest consistent parameters of a Panda, beside Clarabel's in the same run.
//!
//!     cargo bench --bench consistency

use plumbline_identify::consistency::{Uncertainty, nearest};
use plumbline_testkit::peers::nearest as sdp;

use std::time::Instant;

const REPEATS: usize = 200;

fn main() {
    let problems: Vec<_> =
        [0.0001, 0.001, 0.01, 0.1, 0.3].iter().map(|&share| (share, sdp::problem(share, 7))).collect();
    let answers = sdp::clarabel(&problems.iter().map(|(_, problem)| problem).collect::<Vec<_>>(), 20);
    println!(
        "Panda, 45 base parameters of 70; least of {REPEATS} repeats, of 20 for Clarabel (solver alone; with set-up)"
    );
    for (k, (share, problem)) in problems.iter().enumerate() {
        let deviations: Vec<_> = problem.covariance.diagonal().iter().map(|variance| Some(variance.sqrt())).collect();
        let uncertainty = Uncertainty::Covariance(&problem.covariance, &deviations);
        let run = || nearest(&problem.structure, &problem.beta, uncertainty, &problem.prior).expect("converges");
        let mut best = f64::INFINITY;
        for _ in 0..REPEATS {
            let start = Instant::now();
            std::hint::black_box(run());
            best = best.min(start.elapsed().as_secs_f64());
        }
        let found = run();
        print!(
            "noise {:.2} %: {:.3} ms, {} steps, {} {:.3} standard deviations",
            100.0 * share,
            1e3 * best,
            found.iterations,
            if found.exact { "reproduced," } else { "moved" },
            found.distance
        );
        match &answers {
            Some(answers) => println!(
                " | Clarabel {:.1} ms ({:.1} ms), {} steps, {:.3}: {:.0} times ours",
                1e3 * answers[k].seconds,
                1e3 * answers[k].total,
                answers[k].iterations,
                answers[k].distance,
                answers[k].seconds / best
            ),
            None => println!(),
        }
    }
}
