//! Estimates of a Panda's parameters that no real arm has, and Clarabel's answer to them.

use crate::peers;
use nalgebra::{DMatrix, DVector};
use plumbline_identify::consistency::{FLOOR, Prior};
use plumbline_model::{Reduction, Robot, Structure};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use serde::Deserialize;
use serde_json::json;
use std::io::Write;
use std::process::{Command, Stdio};

const REQUIREMENTS: [&str; 2] = ["clarabel==0.11.*", "scipy"];

pub struct Problem {
    pub structure: Structure,
    pub beta: Vec<f64>,
    pub covariance: DMatrix<f64>,
    pub prior: Prior,
}

#[derive(Debug, Deserialize)]
pub struct Answer {
    pub distance: f64,
    pub seconds: f64,
    pub total: f64,
    pub iterations: usize,
    pub status: String,
}

/// The simulated Panda's parameters with noise that is `share` of their sizes, correlated.
pub fn problem(share: f64, seed: u64) -> Problem {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let truth = crate::sim::arm("sim-panda").link_parameters();
    let chain = Robot::load("panda", None).unwrap().chain;
    let reduction = Reduction::any_mounting(&chain);
    let structure = Structure::of(chain, reduction, &[]).unwrap();
    let delta = DVector::from_iterator(70, truth.iter().flatten().copied());
    let beta = structure.reduction().base_of(&delta);
    let p = beta.len();
    let mix = DMatrix::from_fn(p, p, |i, k| {
        f64::from(u8::from(i == k)) + 0.3 / (p as f64).sqrt() * rng.sample::<f64, _>(StandardNormal)
    });
    let scale = DMatrix::from_diagonal(&beta.map(|value| share * value.abs().max(1e-3)));
    let root = scale * mix;
    let beta: Vec<f64> =
        (beta + &root * DVector::from_fn(p, |_, _| rng.sample(StandardNormal))).iter().copied().collect();
    let prior = Prior::of_geometry(&structure, &beta);
    Problem { structure, beta, covariance: &root * root.transpose(), prior }
}

/// Clarabel's answers, the fastest of `repeats`; `None` where there is no Python for it.
pub fn clarabel(problems: &[&Problem], repeats: usize) -> Option<Vec<Answer>> {
    let python = peers::interpreter_with(&REQUIREMENTS)?;
    let rows = |m: &DMatrix<f64>| -> Vec<Vec<f64>> { m.row_iter().map(|row| row.iter().copied().collect()).collect() };
    let one = |problem: &&Problem| {
        json!({
            "k": rows(problem.structure.reduction().regroup()),
            "beta": problem.beta,
            "covariance": rows(&problem.covariance),
            "prior": problem.prior.links,
        })
    };
    let request =
        json!({ "problems": problems.iter().map(one).collect::<Vec<_>>(), "floor": FLOOR, "repeats": repeats });
    let script = crate::path("crates/testkit/peers/nearest.py");
    let mut child =
        Command::new(python).arg(script).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().expect("python runs");
    child.stdin.take().unwrap().write_all(request.to_string().as_bytes()).unwrap();
    let out = child.wait_with_output().unwrap();
    assert!(out.status.success());
    Some(serde_json::from_slice(&out.stdout).unwrap())
}
