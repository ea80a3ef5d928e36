//! Torques, regressors and kinematics against Pinocchio (`crates/model/tests/golden/make.py` writes the values).

use nalgebra::{DMatrix, Vector3};
use plumbline_model::{LINK_COLUMNS, LinkParameters, Robot, regressor, rnea};
use serde::Deserialize;
use std::path::Path;

#[derive(Deserialize)]
struct Golden {
    robots: Vec<GoldenRobot>,
}

#[derive(Deserialize)]
struct GoldenRobot {
    file: String,
    links: Vec<LinkParameters>,
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    gravity: [f64; 3],
    q: Vec<f64>,
    dq: Vec<f64>,
    ddq: Vec<f64>,
    tau: Vec<f64>,
    /// Row j from its own link's columns on; a link loads only the joints up to its own.
    regressor: Vec<Vec<f64>>,
    end_effector: [f64; 3],
}

fn golden() -> Golden {
    serde_json::from_str(include_str!("../golden/dynamics.json"))
        .expect("crates/model/tests/golden/dynamics.json as make.py writes it")
}

fn robot(file: &str) -> Robot {
    Robot::load(file, Some(Path::new(plumbline_testkit::ROOT))).unwrap_or_else(|error| panic!("{error}"))
}

/// Largest difference, relative to the largest value (or to 1).
fn apart(ours: &[f64], theirs: &[f64]) -> f64 {
    assert_eq!(ours.len(), theirs.len());
    let scale = theirs.iter().fold(1.0, |scale: f64, value| scale.max(value.abs()));
    ours.iter().zip(theirs).fold(0.0, |worst: f64, (a, b)| worst.max((a - b).abs())) / scale
}

#[test]
fn covers_every_shipped_robot_and_prismatic_ones() {
    let files: Vec<String> = golden().robots.into_iter().map(|robot| robot.file).collect();
    for name in Robot::names() {
        assert!(
            files.contains(&format!("config/robots/{name}.toml")),
            "no golden values for {name}: run crates/model/tests/golden/make.py"
        );
    }
    assert!(files.iter().any(|file| file.ends_with("gantry.toml")));
}

#[test]
fn torque_is_pinocchios() {
    for golden in golden().robots {
        let chain = robot(&golden.file).chain;
        for (index, case) in golden.cases.iter().enumerate() {
            let mut tau = vec![0.0; chain.len()];
            rnea(&chain, &golden.links, &Vector3::from(case.gravity), &case.q, &case.dq, &case.ddq, &mut tau);
            let worst = apart(&tau, &case.tau);
            assert!(worst < 1e-10, "{} case {index}: {worst:e}", golden.file);
        }
    }
}

#[test]
fn regressor_is_pinocchios() {
    for golden in golden().robots {
        let chain = robot(&golden.file).chain;
        let n = chain.len();
        let mut y = DMatrix::zeros(n, n * LINK_COLUMNS);
        for (index, case) in golden.cases.iter().enumerate() {
            regressor(&chain, &Vector3::from(case.gravity), &case.q, &case.dq, &case.ddq, &mut y);
            for j in 0..n {
                let row: Vec<f64> = y.row(j).iter().copied().collect();
                let (before, own) = row.split_at(j * LINK_COLUMNS);
                assert!(before.iter().all(|value| *value == 0.0), "{} case {index} row {j}", golden.file);
                let worst = apart(own, &case.regressor[j]);
                assert!(worst < 1e-10, "{} case {index} row {j}: {worst:e}", golden.file);
            }
        }
    }
}

#[test]
fn end_effector_is_pinocchios() {
    for golden in golden().robots {
        let chain = robot(&golden.file).chain;
        for case in &golden.cases {
            let worst = apart(chain.end_effector(&case.q).as_slice(), &case.end_effector);
            assert!(worst < 1e-12, "{}: {worst:e}", golden.file);
        }
    }
}
