//! The motion that would answer what a diagnosis leaves open.

use crate::process::progress;
use nalgebra::DMatrix;
use plumbline_core::threads;
use plumbline_diagnose::outcome::Open;
use plumbline_diagnose::{Answer, OpenQuestions};
use plumbline_excite::{ExciteError, Fourier, Plan, Problem, Progress, Search, SearchControl, best_by_score};
use plumbline_identify::Run;
use plumbline_model::Mounting;

/// Time between samples of a planned motion \[s\]: friction that builds up over milliradians takes this many.
const SAMPLING_S: f64 = 2e-3;

/// File of the plan, beside the report.
pub const FILE: &str = "next.toml";
/// Random motions that are compared, and rounds in which the best are perturbed.
pub const STARTS: usize = 24;
pub const ROUNDS: usize = 6;

/// Smallest share of an answer that a motion is worth driving for.
const MIN_SHARE: f64 = 0.25;

/// Searches for the motion, driven `periods` times, and gives it with the questions and the answers to expect. Motions that are not `usable` are left
/// out; `stop` ends the search early. Without a plan, no motion is expected to answer anything.
pub fn next(
    open: &OpenQuestions,
    problem: &Problem,
    search: &Search,
    periods: usize,
    usable: &(dyn Fn(&Fourier) -> bool + Sync),
    stop: &(dyn Fn() -> bool + Sync),
) -> Result<(Option<Plan>, Vec<Open>), ExciteError> {
    let answers = |fourier: &Fourier| open.answers(&one_period(fourier, problem.mounting), periods).ok();
    let score =
        |fourier: &Fourier| answers(fourier).filter(|_| usable(fourier)).map(|answers| OpenQuestions::score(&answers));
    let bar = progress::bar("planning");
    let report = |now: Progress| bar.at(now.done as f64 / now.of as f64, "what would tell more");
    let control = SearchControl { threads: threads(), stop, progress: &report };
    let plan = best_by_score(problem, search, 0..problem.bounds.chain.len(), &score, &control)?;
    bar.done();
    let expected: Vec<Answer> = answers(&plan.fourier()?).unwrap_or_default();
    let worth = expected.iter().any(|answer| answer.share > MIN_SHARE);
    Ok((worth.then_some(plan), open.facts(&expected)))
}

/// One period of a motion as a recording without torques: the constant stands for them.
fn one_period(fourier: &Fourier, mounting: Mounting) -> Run {
    let samples = (fourier.period / SAMPLING_S).round() as usize;
    let time = |k: usize| k as f64 * SAMPLING_S;
    let n = fourier.joints();
    Run {
        name: "planned".into(),
        t: (0..samples).map(time).collect(),
        q: DMatrix::from_fn(samples, n, |k, j| fourier.at(j, time(k)).q),
        dq: None,
        tau: DMatrix::from_element(samples, n, 1.0),
        mounting,
        period: Some(samples as f64 * SAMPLING_S),
    }
}
