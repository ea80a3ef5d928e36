//! Models to load and to serve, states to evaluate them at.

use assert_no_alloc::{assert_no_alloc, violation_count};
use nalgebra::DMatrix;
use plumbline_identify::external::ResidualSpectrum;
use plumbline_identify::{Spread, TorqueUncertainty};
use plumbline_model::term::effect::{Site, Spec, assemble};
use plumbline_model::{Mounting, Reduction, Structure, TorqueModel};
use plumbline_model_file::{ModelFile, Provenance, model_identity};
use plumbline_testkit::arms::{chain, draw};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

pub const WALL: [f64; 3] = [9.81, 0.0, 0.0];

/// A model of `robot` with random parameters, friction, offsets and rotors, and `effects`.
pub fn model(robot: &str, seed: u64, effects: &[Spec]) -> TorqueModel {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let chain = chain(robot);
    let terms = ["friction", "torque-offset", "rotor-inertia"];
    let structure = Structure::of(chain.clone(), Reduction::any_mounting(&chain), &terms).unwrap();
    let mut values = draw(&mut rng, structure.columns().len(), 1.0);
    let terms = assemble(effects, &structure.operating_point(&values)).unwrap();
    let structure = structure.with(terms).unwrap();
    values.extend(draw(&mut rng, structure.columns().len() - values.len(), 1.0));
    let values: Vec<_> = values.into_iter().map(|value| (value, Some(0.1))).collect();
    TorqueModel::new(robot, structure, vec![Mounting::WALL], &values).unwrap()
}

/// A file of `model`, with variances of 0.01 and correlations of 0.5, and a white residual of 0.1 Nm.
pub fn file(model: TorqueModel) -> ModelFile {
    let (p, n) = (model.parameters().len(), model.structure().chain().len());
    let covariance = DMatrix::from_fn(p, p, |c, d| if c == d { 0.1 * 0.1 } else { 0.5 * 0.1 * 0.1 });
    let parameters = Spread { covariance, freedom: vec![100.0; p] };
    let bands = ResidualSpectrum::bands(1000.0);
    let power: Vec<f64> = bands.map(|[low, high]| 0.1 * 0.1 * (high - low) / 500.0).collect();
    let uncertainty = TorqueUncertainty {
        parameters,
        residual_std: vec![0.1; n],
        residual_freedom: 1000.0,
        residual_spectrum: Some(ResidualSpectrum { rate: 1000.0, power: vec![power; n] }),
    };
    let (noise_floor, validation, provenance) = (Vec::new(), Vec::new(), Provenance::default());
    ModelFile { model, noise_floor, validation, uncertainty: Some(uncertainty), consistent: None, provenance }
}

/// Text and identity of a random model.
pub fn text(robot: &str, seed: u64) -> (String, u64) {
    let text = file(model(robot, seed, &[])).to_toml();
    let identity = model_identity(&text);
    (text, identity)
}

pub fn presliding() -> Spec {
    Spec { family: "presliding", form: "", site: Site::Joint(3), settings: vec![0.002] }
}

/// A state: position, velocity, acceleration.
pub type Point = [Vec<f64>; 3];

pub fn points(n: usize, count: usize) -> Vec<Point> {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    (0..count).map(|_| [3.0, 2.0, 5.0].map(|span| draw(&mut rng, n, span))).collect()
}

pub fn assert_no_allocation(run: impl FnOnce()) {
    assert_no_alloc(|| drop(std::hint::black_box(Box::new(1.0))));
    let counted = violation_count();
    assert!(counted > 0, "allocations are not counted");
    assert_no_alloc(run);
    assert_eq!(violation_count(), counted);
}
