//! What a model returns, against the model's own routes and Pinocchio.

use crate::models::*;
use nalgebra::{DMatrix, DVector, Vector3};
use plumbline_client::{Error, Fault, Model, Way};
use plumbline_identify::TorqueUncertainty;
use plumbline_identify::external::{ExternalObserver, ObserverSettings};
use plumbline_model::term::Sample;
use plumbline_model::{LinkParameters, Mounting, Reduction, Robot, Structure, TorqueModel};
use plumbline_model_file::ModelFile;
use serde_json::Value;
use std::path::PathBuf;

/// A file in a folder of this process, under a name of its own.
fn saved(name: &str, file: &ModelFile) -> PathBuf {
    let path = std::env::temp_dir().join(format!("plumbline-client-{}-{name}.toml", std::process::id()));
    std::fs::write(&path, file.to_toml()).unwrap();
    path
}

fn load(name: &str, file: &ModelFile, gravity: [f64; 3]) -> Result<Model, Error> {
    let path = saved(name, file);
    let model = Model::load(&path, gravity);
    std::fs::remove_file(path).unwrap();
    model
}

fn sample([q, dq, ddq]: &Point) -> Sample {
    let padded = |values: &Vec<f64>| std::array::from_fn(|j| values.get(j).copied().unwrap_or_default());
    Sample { q: padded(q), dq: padded(dq), ddq: padded(ddq) }
}

fn largest(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).fold(0.0, |most, (a, b)| f64::max(most, (a - b).abs()))
}

#[test]
fn the_torque_is_the_evaluators_and_the_sum_of_its_parts_on_every_shipped_arm() {
    for robot in Robot::names() {
        let of = model(robot, 3, &[]);
        let n = of.structure().chain().len();
        let mut evaluator = of.evaluator(&Vector3::from(WALL));
        let offsets: Vec<f64> = (1..=n)
            .map(|j| of.parameters().iter().find(|p| p.column.name == format!("offset{j}")).map_or(0.0, |p| p.value))
            .collect();
        let mut model = load(robot, &file(of.clone()), WALL).unwrap();
        let (mut tau, mut part, mut matrix) = (vec![0.0; n], vec![0.0; n], vec![0.0; n * n]);
        let mut y = vec![0.0; n * model.columns().unwrap()];
        for (index, point) in points(n, 10_000).iter().enumerate() {
            let [q, dq, ddq] = point;
            model.torque(q, dq, ddq, None, &mut tau).unwrap();
            assert_eq!(tau, evaluator.torque(&sample(point)).0[..n], "{robot}, {index}");
            if index >= 100 {
                continue;
            }
            model.inertia(q, &mut matrix).unwrap();
            let m = DMatrix::from_column_slice(n, n, &matrix);
            let scale = tau.iter().fold(1.0, |scale: f64, tau| scale.max(tau.abs()));
            assert!((&m - m.transpose()).amax() < 1e-12 * m.amax(), "{robot}");
            let mut sum = m * DVector::from_column_slice(ddq) + DVector::from_column_slice(&offsets);
            model.gravity(q, &mut part).unwrap();
            sum += DVector::from_column_slice(&part);
            model.coriolis(q, dq, &mut part).unwrap();
            sum += DVector::from_column_slice(&part);
            model.friction(dq, &mut part).unwrap();
            sum += DVector::from_column_slice(&part);
            assert!(largest(sum.as_slice(), &tau) < 1e-12 * scale, "{robot}: {sum} {tau:?}");

            model.regressor(q, dq, ddq, &mut y).unwrap();
            let product = DMatrix::from_column_slice(n, of.beta().len(), &y) * DVector::from_vec(of.beta());
            assert!(largest(product.as_slice(), &tau) < 1e-11 * scale, "{robot}");
        }
    }
}

#[test]
fn torque_inertia_and_gravity_are_pinocchios() {
    let path = plumbline_testkit::path("crates/model/tests/golden/dynamics.json");
    let golden: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    let mut seen = 0;
    for of in golden["robots"].as_array().unwrap() {
        let name = of["file"].as_str().unwrap().rsplit('/').next().unwrap().trim_end_matches(".toml");
        if !Robot::names().any(|known| known == name) {
            continue;
        }
        seen += 1;
        let links: Vec<LinkParameters> = serde_json::from_value(of["links"].clone()).unwrap();
        let chain = plumbline_testkit::arms::chain(name);
        let reduction = Reduction::any_mounting(&chain);
        let beta = reduction.base_of(&DVector::from_vec(links.concat()));
        let values: Vec<_> = beta.iter().map(|&value| (value, None)).collect();
        let structure = Structure::of(chain.clone(), reduction, &[]).unwrap();
        let model = TorqueModel::new(name, structure, vec![Mounting::WALL], &values).unwrap();
        let file = ModelFile { uncertainty: None, ..file(model) };
        let mut model = load(&format!("pinocchio-{name}"), &file, WALL).unwrap();
        let n = chain.len();
        for case in of["cases"].as_array().unwrap() {
            let list = |key: &str| -> Vec<f64> { serde_json::from_value(case[key].clone()).unwrap() };
            let gravity: [f64; 3] = serde_json::from_value(case["gravity"].clone()).unwrap();
            let (q, dq, ddq, expected) = (list("q"), list("dq"), list("ddq"), list("tau"));
            let mut tau = vec![0.0; n];
            model.torque(&q, &dq, &ddq, Some(gravity), &mut tau).unwrap();
            let scale = expected.iter().fold(1.0, |scale: f64, tau| scale.max(tau.abs()));
            assert!(largest(&tau, &expected) < 1e-9 * scale, "{name}: {tau:?} {expected:?}");
        }
    }
    assert_eq!(seen, Robot::names().count());
}

#[test]
fn another_gravity_is_that_of_another_model_and_none_is_the_models_own() {
    let of = file(model("panda", 5, &[]));
    let upright = [0.0, 0.0, -9.81];
    let (mut wall, mut table) = (load("wall", &of, WALL).unwrap(), load("table", &of, upright).unwrap());
    for [q, dq, ddq] in points(7, 50) {
        let torque = |model: &mut Model, gravity| {
            let mut tau = [0.0; 7];
            model.torque(&q, &dq, &ddq, gravity, &mut tau).unwrap();
            tau
        };
        let (own, other) = (torque(&mut wall, None), torque(&mut table, None));
        assert_ne!(own, other);
        assert_eq!(torque(&mut wall, Some(upright)), other);
        assert_eq!(torque(&mut wall, None), own);
    }
}

/// Presliding takes each call as the next sample: the torque is that of the motion, and the regressor's memory is its own.
#[test]
fn terms_with_a_memory_take_one_call_per_cycle() {
    let of = model("panda", 6, &[presliding()]);
    let mut evaluator = of.evaluator(&Vector3::from(WALL));
    let mut model = load("presliding", &file(of.clone()), WALL).unwrap();
    let mut y = vec![0.0; 7 * model.columns().unwrap()];
    let zero = [0.0; 7];
    let mut tau = [0.0; 7];
    for k in 0..200 {
        let q = [0.01 * (f64::from(k) * 0.05).sin(); 7];
        let point = [q.to_vec(), zero.to_vec(), zero.to_vec()];
        model.torque(&q, &zero, &zero, None, &mut tau).unwrap();
        assert_eq!(tau, evaluator.torque(&sample(&point)).0[..7]);
        model.regressor(&q, &zero, &zero, &mut y).unwrap();
        let product = DMatrix::from_column_slice(7, of.beta().len(), &y) * DVector::from_vec(of.beta());
        assert!(largest(product.as_slice(), &tau) < 1e-11);
    }
    let upright = Some([0.0, 0.0, -9.81]);
    assert_eq!(model.torque(&zero, &zero, &zero, upright, &mut tau), Err(Fault::FixedGravity));
}

#[test]
fn the_standard_deviation_is_that_of_the_covariance() {
    let of = model("panda", 7, &[presliding()]);
    let p = of.parameters().len();
    let with = file(of);
    let mut model = load("std", &with, WALL).unwrap();
    let covariance = &with.uncertainty.as_ref().unwrap().parameters.covariance;
    // The memories of two models advance alike.
    let mut other = load("std-other", &with, WALL).unwrap();
    let (mut y, mut std) = (vec![0.0; 7 * p], [0.0; 7]);
    for [q, dq, ddq] in points(7, 20) {
        other.regressor(&q, &dq, &ddq, &mut y).unwrap();
        let y = DMatrix::from_column_slice(7, p, &y);
        let expected = (&y * covariance * y.transpose()).diagonal().map(f64::sqrt);
        model.torque_std(&q, &dq, &ddq, &mut std).unwrap();
        assert!(largest(&std, expected.as_slice()) < 1e-10 * expected.max(), "{std:?} {expected}");
    }
    let mut without = load("no-std", &ModelFile { uncertainty: None, ..with }, WALL).unwrap();
    assert_eq!(without.torque_std(&[0.0; 7], &[0.0; 7], &[0.0; 7], &mut std), Err(Fault::NoUncertainty));
}

/// The loop's call is the observer's own, and does not disturb the memory of the torque.
#[test]
fn the_external_torque_is_the_observers() {
    let of = file(model("panda", 10, &[presliding()]));
    let mut own = load("external", &of, WALL).unwrap();
    let mut other = load("external-other", &of, WALL).unwrap();
    let uncertainty = of.uncertainty.as_ref().unwrap();
    let settings = ObserverSettings { bandwidth: 30.0, ..ObserverSettings::default() };
    let mut observer = ExternalObserver::new(&of.model, uncertainty, &Vector3::from(WALL), settings).unwrap();
    own.set_observer(Way::Momentum, 30.0, 0.1).unwrap();
    assert_eq!(own.set_observer(Way::Momentum, 600.0, 0.1), Err(Fault::Setting));
    let (mut tau, mut expected) = ([0.0; 7], [0.0; 7]);
    for k in 0..200 {
        let t = f64::from(k) * 1e-3;
        let (q, dq) = ([0.3 * (2.0 * t).sin(); 7], [0.6 * (2.0 * t).cos(); 7]);
        own.torque(&q, &dq, &[0.0; 7], None, &mut tau).unwrap();
        other.torque(&q, &dq, &[0.0; 7], None, &mut expected).unwrap();
        assert_eq!(tau, expected);
        tau[1] += 40.0;
        let found = own.external(&q, &dq, &tau).unwrap();
        let padded = |values: &[f64; 7]| std::array::from_fn(|j| values.get(j).copied().unwrap_or_default());
        assert_eq!(found, observer.next(&padded(&q), &padded(&dq), &padded(&tau)));
        assert_eq!(found.settled, k >= 40, "{k}");
    }
    assert_eq!(own.external(&[0.0; 6], &[0.0; 7], &tau), Err(Fault::Length { expected: 7, found: 6 }));
    assert_eq!(own.external(&[f64::NAN; 7], &[0.0; 7], &tau), Err(Fault::NotFinite));

    let without = TorqueUncertainty { residual_spectrum: None, ..uncertainty.clone() };
    let mut without = load("no-spectrum", &ModelFile { uncertainty: Some(without), ..of }, WALL).unwrap();
    assert_eq!(without.external(&[0.0; 7], &[0.0; 7], &tau), Err(Fault::NoUncertainty));
    without.torque_std(&[0.0; 7], &[0.0; 7], &[0.0; 7], &mut tau).unwrap();
}

#[test]
fn calls_in_the_loop_do_not_allocate() {
    let mut model = load("allocation", &file(model("panda", 8, &[presliding()])), WALL).unwrap();
    let (mut tau, mut matrix) = ([0.0; 7], [0.0; 49]);
    let mut y = vec![0.0; 7 * model.columns().unwrap()];
    let all = points(7, 100);
    let mut failed = 0;
    assert_no_allocation(|| {
        for [q, dq, ddq] in &all {
            let mut count = |outcome: Result<(), Fault>| failed += u32::from(outcome.is_err());
            count(model.torque(q, dq, ddq, None, &mut tau));
            count(model.gravity(q, &mut tau));
            count(model.coriolis(q, dq, &mut tau));
            count(model.friction(dq, &mut tau));
            count(model.inertia(q, &mut matrix));
            count(model.regressor(q, dq, ddq, &mut y));
            count(model.torque_std(q, dq, ddq, &mut tau));
            count(model.external(q, dq, &tau).map(|_| ()));
            count(model.set_observer(Way::Acceleration, 30.0, 1.0));
            count(model.external(q, dq, &tau).map(|_| ()));
            failed += u32::from(model.status().model == 0);
        }
    });
    assert_eq!(failed, 0);
}

#[test]
fn bad_input_is_an_error_by_name_and_writes_nothing() {
    let mut of = load("bad-input", &file(model("panda", 9, &[])), WALL).unwrap();
    let mut tau = [5.0; 7];
    let zero = [0.0; 7];
    let length = Err(Fault::Length { expected: 7, found: 6 });
    assert_eq!(of.torque(&zero[..6], &zero, &zero, None, &mut tau), length);
    assert_eq!(of.torque(&zero, &zero, &zero, None, &mut tau[..6]), length);
    for bad in [f64::NAN, f64::INFINITY] {
        let mut one = zero;
        one[4] = bad;
        assert_eq!(of.torque(&one, &zero, &zero, None, &mut tau), Err(Fault::NotFinite));
        assert_eq!(of.torque(&zero, &one, &zero, None, &mut tau), Err(Fault::NotFinite));
        assert_eq!(of.torque(&zero, &zero, &one, None, &mut tau), Err(Fault::NotFinite));
        assert_eq!(of.torque(&zero, &zero, &zero, Some([0.0, bad, 0.0]), &mut tau), Err(Fault::NotFinite));
        assert_eq!(of.inertia(&one, &mut [0.0; 49]), Err(Fault::NotFinite));
    }
    assert_eq!(tau, [5.0; 7]);
    assert!(
        matches!(Model::load("no/such/model.toml".as_ref(), WALL), Err(Error::Input(bad)) if bad.file.contains("such"))
    );

    // A model that was identified upright lacks two parameters on a wall.
    let chain = plumbline_testkit::arms::chain("panda");
    let structure = Structure::of(chain.clone(), Reduction::in_mounting(&chain, &Mounting::UPRIGHT), &[]).unwrap();
    let values = vec![(0.1, Some(0.1)); structure.columns().len()];
    let vertical = file(TorqueModel::new("panda", structure, vec![Mounting::UPRIGHT], &values).unwrap());
    let refused = load("vertical-wall", &vertical, WALL).err();
    assert!(matches!(&refused, Some(Error::OtherMounting(why)) if why.contains("lxR1")), "{refused:?}");
    let mut upright = load("vertical", &vertical, [0.0, 0.0, -9.81]).unwrap();
    assert_eq!(upright.torque(&zero, &zero, &zero, Some(WALL), &mut tau), Err(Fault::Mounting));
    assert_eq!(upright.torque(&zero, &zero, &zero, Some([0.0, 0.0, 9.81]), &mut tau), Ok(()));
}
