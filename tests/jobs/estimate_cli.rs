//! `plumbline identify` with its estimators and ways of signal processing, on a recorded dataset; and what it says to names it does not know.

use nalgebra::DMatrix;
use plumbline::dataset::{Dataset, Role, Run};
use plumbline::report::Report;
use plumbline::store::ModelFile;
use plumbline_testkit::job::*;
use plumbline_testkit::scene::Scene;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Every fourth millisecond of a recording, as a dataset would hold it.
fn run(scene: &Scene, file: &str, role: Role, seed: u64, periodic: bool) -> Run {
    scene.dataset_run(file, role, (3, seed), 4, periodic)
}

fn dataset(scene: &Scene, folder: &Path, runs: Vec<Run>) -> PathBuf {
    let (name, robot) = ("recorded".into(), "panda".into());
    let dataset = Dataset { name, robot, mounting: scene.mounting, source: toml::Table::new(), runs };
    dataset.write(folder).unwrap();
    folder.to_path_buf()
}

fn identify(dataset: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = plumbline();
    command.arg("identify").arg(dataset).arg("--out").arg(out).args(["--verbose", "--terms", "friction"]).args(more);
    command
}

fn report(dataset: &Path, out: &Path, more: &[&str]) -> (Report, Done) {
    let done = Done::of(identify(dataset, out, more)).expect_code(0);
    (serde_json::from_str(&std::fs::read_to_string(out.join("report.json")).unwrap()).unwrap(), done)
}

#[test]
fn every_estimator_and_both_methods_run_from_the_command_line() {
    let scene = Scene::panda_on_the_wall();
    let place = Place::new("estimators");
    let runs = vec![
        run(&scene, "identify.csv", Role::Identify, 1, true),
        run(&scene, "validate.csv", Role::Validate, 2, true),
    ];
    let data = dataset(&scene, &place.path().join("data"), runs);
    let (usual, _) = report(&data, &place.out(), &[]);
    let facts = usual.estimator.as_ref().unwrap();
    assert_eq!((facts.name.as_str(), facts.settled, facts.restricted.len()), ("wls", true, 0));
    for name in ["ols", "wls-full", "huber", "tls", "iv"] {
        let (found, done) = report(&data, &place.out(), &["--estimator", name]);
        assert_eq!(found.estimator.unwrap().name, name);
        assert!(done.out.contains(&format!("estimator: {name}")), "{}", done.output());
        for (found, usual) in found.base.parameters.iter().zip(&usual.base.parameters) {
            let far = (found.value - usual.value).abs() / usual.std.unwrap();
            assert!(far < 6.0, "{name}, {}: {far} standard deviations from weighted least squares", found.name);
        }
    }
    let (paper, _) = report(&data, &place.out(), &["--method", "paper"]);
    assert_eq!(serde_json::to_value(paper.band).unwrap()["cutoff"], 2.0);

    let (essential, done) = report(&data, &place.out(), &["--essential"]);
    let restricted = essential.estimator.unwrap().restricted;
    assert!(!restricted.is_empty());
    assert!(done.out.contains("restricted to zero"), "{}", done.output());
    for parameter in &essential.base.parameters {
        let gone = restricted.contains(&parameter.name);
        assert_eq!(gone, (parameter.value, parameter.std) == (0.0, None), "{}", parameter.name);
    }
    // The model file says so beside each of them, and reads back.
    let path = place.out().join("model.toml");
    let text = std::fs::read_to_string(&path).unwrap();
    assert_eq!(text.matches("restricted to zero").count(), restricted.len());
    let chain = |_: &str| Ok(scene.structure.chain().clone());
    let file = ModelFile::load(&path, chain).unwrap();
    assert_eq!(file.model.parameters().len(), 59);
    // What was taken out has no variance.
    let covariance = file.uncertainty.unwrap().parameters.covariance;
    for (c, own) in file.model.parameters().iter().enumerate() {
        assert_eq!(own.std.is_some(), covariance[(c, c)] > 0.0, "{}", own.column.name);
    }
}

#[test]
fn iv_requires_instruments_and_uses_them() {
    let scene = Scene::panda_on_the_wall();
    let place = Place::new("instruments");
    let alone = run(&scene, "once.csv", Role::Identify, 3, false);
    let data = dataset(&scene, &place.path().join("once"), vec![alone.clone()]);
    let done = Done::of(identify(&data, &place.out(), &["--estimator", "iv"])).expect_code(2);
    for part in ["once.csv", "does not repeat", "q_d1..q_dn", "at least two periods"] {
        assert!(done.err.contains(part), "no `{part}` in {}", done.output());
    }
    let desired: DMatrix<f64> = {
        let samples = scene.motion.samples();
        DMatrix::from_fn(alone.samples(), 7, |k, j| scene.motion.q[((4 * k) % samples, j)])
    };
    let extra = (0..7).map(|j| (format!("q_d{}", j + 1), desired.column(j).iter().copied().collect())).collect();
    let data = dataset(&scene, &place.path().join("desired"), vec![Run { extra, ..alone }]);
    let (found, _) = report(&data, &place.out(), &["--estimator", "iv"]);
    for (found, truth) in found.base.parameters.iter().zip(&scene.beta) {
        assert!((found.value - truth).abs() < 6.0 * found.std.unwrap(), "{}: {} {truth}", found.name, found.value);
    }
}

#[test]
fn unknown_names() {
    let place = Place::new("names");
    let scene = Scene::panda_on_the_wall();
    let data = dataset(&scene, &place.path().join("data"), vec![run(&scene, "run.csv", Role::Identify, 4, true)]);
    for (option, value, known) in [
        ("--estimator", "lasso", "huber, tls, iv"),
        ("--method", "wavelet", "spectral or paper"),
        ("--velocities", "guessed", "measured or derived"),
        ("--trim", "4000", "0 to 3600 s"),
        ("--hold-out", "1.5", "0.05 to 0.95"),
    ] {
        let done = Done::of(identify(&data, &place.out(), &[option, value])).expect_code(2);
        for part in [option, value, known] {
            assert!(done.err.contains(part), "no `{part}` in {}", done.output());
        }
        assert!(!place.out().exists());
    }
    for (set, part) in [("estimator.solver=lasso", "lasso"), ("estimator.method=wavelet", "wavelet")] {
        let done = Done::of(place.job("run", &[set])).expect_code(2);
        assert!(done.err.contains(part) && done.err.contains("estimator."), "{}", done.output());
    }
}
