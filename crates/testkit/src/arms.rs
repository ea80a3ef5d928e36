//! Arms and random states for the tests of the model.

use nalgebra::{DVector, Matrix3, Rotation3, Vector3};
use plumbline_model::{Body, Chain, Joint, JointKind, LinkParameters, Mounting, Placement, Reduction, Robot, rnea};
use rand::Rng;
use rand::seq::IndexedRandom;
use rand_chacha::ChaCha8Rng;
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;

/// A robot by name, built in or of the golden tests.
pub fn chain(name: &str) -> Chain {
    if Robot::names().any(|known| known == name) {
        return Robot::load(name, None).unwrap().chain;
    }
    let file = format!("crates/model/tests/golden/robots/{name}.toml");
    Robot::load(&file, Some(Path::new(crate::ROOT))).unwrap().chain
}

pub fn all() -> Vec<(&'static str, Chain)> {
    Robot::names().chain(["scara", "stanford", "gantry", "skew"]).map(|name| (name, chain(name))).collect()
}

/// An arm with random geometry: zero lengths, right angles and prismatic joints are common, since they make base sets special.
pub fn random_chain(rng: &mut ChaCha8Rng) -> Chain {
    let n = rng.random_range(1..=7);
    let joint = |index: usize, rng: &mut ChaCha8Rng| {
        let mut length = || if rng.random_bool(0.5) { 0.0 } else { rng.random_range(-0.6..0.6) };
        let (a, d) = (length(), length());
        let kind = if rng.random_bool(0.25) { JointKind::Prismatic } else { JointKind::Revolute };
        let skew = rng.random_range(-3.0..3.0);
        let alpha = *[0.0, FRAC_PI_2, -FRAC_PI_2, PI, skew].choose(rng).unwrap();
        let theta = rng.random_range(-3.0..3.0);
        let first = index == 0;
        Joint { kind, a: if first { 0.0 } else { a }, alpha: if first { 0.0 } else { alpha }, d, theta }
    };
    let joints = (0..n).map(|index| joint(index, rng)).collect();
    Chain::modified(joints, Placement::identity())
}

/// A rigid body that may be.
pub fn random_body(rng: &mut ChaCha8Rng) -> LinkParameters {
    let second = Vector3::from_fn(|_, _| rng.random_range(0.002..0.05));
    let axes = Rotation3::from_euler_angles(
        rng.random_range(-3.0..3.0),
        rng.random_range(-1.5..1.5),
        rng.random_range(-3.0..3.0),
    );
    let mass = rng.random_range(0.3..6.0);
    let sigma = axes.matrix() * Matrix3::from_diagonal(&second) * axes.matrix().transpose() * mass;
    let inertia = sigma.trace() * Matrix3::identity() - sigma;
    Body { mass, com: Vector3::from_fn(|_, _| rng.random_range(-0.2..0.2)), inertia }.link_parameters()
}

/// Base parameters of random bodies that may be.
pub fn random_base(reduction: &Reduction, links: usize, rng: &mut ChaCha8Rng) -> DVector<f64> {
    let delta: Vec<f64> = (0..links).flat_map(|_| random_body(rng)).collect();
    reduction.base_of(&DVector::from_vec(delta))
}

/// `n` numbers within `span` of zero.
pub fn draw(rng: &mut ChaCha8Rng, n: usize, span: f64) -> Vec<f64> {
    (0..n).map(|_| rng.random_range(-span..span)).collect()
}

pub fn any_mounting(rng: &mut ChaCha8Rng) -> Mounting {
    Mounting { rho: rng.random_range(0.0..PI), phi: rng.random_range(-PI..PI) }
}

pub fn links(delta: &[f64]) -> Vec<LinkParameters> {
    delta.chunks_exact(10).map(|link| link.try_into().unwrap()).collect()
}

pub fn torque(
    chain: &Chain,
    delta: &[f64],
    gravity: &Vector3<f64>,
    q: &[f64],
    dq: &[f64],
    ddq: &[f64],
) -> DVector<f64> {
    let mut tau = DVector::zeros(chain.len());
    rnea(chain, &links(delta), gravity, q, dq, ddq, tau.as_mut_slice());
    tau
}
