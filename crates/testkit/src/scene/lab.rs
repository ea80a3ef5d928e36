//! A simulated arm with any truth along several trajectories, recorded as often as wanted: one period of each is integrated without noise,
//! once it has settled, and every recording adds the noise of its own seed.

use super::DT;
use nalgebra::{DMatrix, Vector3};
use plumbline_excite::{PeriodicMotion, Plan, parse_plan};
use plumbline_identify::Run;
use plumbline_model::{Chain, JointKind, Mounting, Placement};
use plumbline_sim::{Response, Truth};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

#[derive(Clone)]
pub struct Period {
    pub name: String,
    pub mounting: Mounting,
    pub seconds: f64,
    /// Positions that the sensors would report without noise, N x n.
    pub q: DMatrix<f64>,
    pub tau: DMatrix<f64>,
}

/// Noise of a recording besides white noise of the arm's file.
#[derive(Clone, Copy, Debug, Default)]
pub struct Noise {
    /// Standard deviation of first-order torque noise of 0.3 s correlation time \[Nm\].
    pub coloured: f64,
}

/// Motions for the diagnosis, four to identify from and two to validate with.
pub fn plans() -> [Vec<Plan>; 2] {
    let read = |name: &str, text: &str| parse_plan(name, text).unwrap();
    let identify = vec![
        read("identify-1", include_str!("diagnosis/identify-1.toml")),
        read("identify-2", include_str!("diagnosis/identify-2.toml")),
        read("identify-3", include_str!("diagnosis/identify-3.toml")),
        read("identify-4", include_str!("diagnosis/identify-4.toml")),
    ];
    let validate = vec![
        read("validate-1", include_str!("diagnosis/validate-1.toml")),
        read("validate-2", include_str!("diagnosis/validate-2.toml")),
    ];
    [identify, validate]
}

/// One settled period of an arm of that truth, in a mounting that need not be the plan's.
pub fn period(chain: &Chain, truth: &Truth, plan: &Plan, mounting: Mounting, name: &str) -> Period {
    let mut quiet = truth.clone();
    for joint in &mut quiet.joints {
        (joint.torque_noise, joint.torque_noise_coloured, joint.torque_quantum) = (0.0, 0.0, 0.0);
        (joint.position_noise, joint.position_quantum, joint.velocity_noise) = (0.0, 0.0, 0.0);
    }
    (quiet.drop_probability, quiet.outlier_probability, quiet.repeat_probability) = (0.0, 0.0, 0.0);
    let reference = PeriodicMotion::new(&plan.fourier().unwrap(), 1).unwrap();
    let samples = reference.period_ticks();
    let response = Response::simulate(chain, &quiet, mounting, &reference, samples, 1).unwrap();
    let zeros = || DMatrix::zeros(samples as usize, chain.len());
    let (mut q, mut tau) = (zeros(), zeros());
    response.measure(0, |_, k, state| {
        for j in 0..chain.len() {
            (q[(k, j)], tau[(k, j)]) = (state.q[j], state.tau[j]);
        }
    });
    Period { name: name.to_string(), mounting, seconds: plan.period, q, tau }
}

impl Period {
    /// `periods` of it with the sensors' noise and steps.
    pub fn record(&self, truth: &Truth, periods: usize, noise: Noise, seed: u64) -> Run {
        let (samples, n) = self.q.shape();
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut normal = || rng.sample::<f64, _>(StandardNormal);
        let rows = periods * samples;
        let (mut q, mut tau) = (DMatrix::zeros(rows, n), DMatrix::zeros(rows, n));
        let pole = (-DT / 0.3_f64).exp();
        for (j, joint) in truth.joints.iter().enumerate() {
            let mut colour = normal();
            for k in 0..rows {
                colour = pole * colour + (1.0 - pole * pole).sqrt() * normal();
                let torque = self.tau[(k % samples, j)] + joint.torque_noise * normal() + noise.coloured * colour;
                let position = self.q[(k % samples, j)] + joint.position_noise * normal();
                q[(k, j)] = step(position, joint.position_quantum);
                tau[(k, j)] = step(torque, joint.torque_quantum);
            }
        }
        Run {
            name: self.name.clone(),
            t: (0..rows).map(|k| k as f64 * DT).collect(),
            q,
            dq: None,
            tau,
            mounting: self.mounting,
            period: Some(self.seconds),
        }
    }
}

fn step(value: f64, quantum: f64) -> f64 {
    if quantum > 0.0 { (value / quantum).round() * quantum } else { value }
}

/// Torque that it takes to hold against a force on the arm in the base frame at a point of a link.
pub fn of_force(chain: &Chain, q: &[f64], link: usize, point: Vector3<f64>, force: Vector3<f64>) -> Vec<f64> {
    let mut frame = Placement::identity();
    let frames: Vec<Placement> = chain
        .joints()
        .iter()
        .zip(q)
        .map(|(joint, &q)| {
            frame = frame.then(&joint.placement(q));
            frame
        })
        .collect();
    let at = frames[link].origin + frames[link].rotation * point;
    let torque = |(j, frame): (usize, &Placement)| {
        assert_eq!(chain.joints()[j].kind, JointKind::Revolute);
        let axis: Vector3<f64> = frame.rotation.column(2).into();
        if j > link { 0.0 } else { -axis.cross(&(at - frame.origin)).dot(&force) }
    };
    frames.iter().enumerate().map(torque).collect()
}

/// 0 to 1 within a tenth of a second after `from`, and back before `to`.
pub fn window(t: f64, from: f64, to: f64) -> f64 {
    let edge = |x: f64| 0.5 - 0.5 * (std::f64::consts::PI * (x / 0.1).clamp(0.0, 1.0)).cos();
    edge(t - from) * edge(to - t)
}
