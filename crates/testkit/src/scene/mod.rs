//! The simulated Panda on the wall along one planned motion: its true motion, any number of noisy recordings of it, and the Cramer-Rao bound of
//! its parameters. Shared by the statistics of the estimators in `tests/` and `benches/`.

pub mod campaign;
pub mod external;
pub mod lab;

use nalgebra::{Cholesky, DMatrix, DVector};
#[cfg(feature = "program")]
use plumbline::dataset::{self, Role};
use plumbline_core::{Backend, Command, JointVec, Reference, Setpoint, State, transposed_product};
use plumbline_excite::{PeriodicMotion, parse_plan};
use plumbline_identify::Run;
use plumbline_identify::signal::spectral::Spectral;
use plumbline_model::term::Motion;
use plumbline_model::{Mounting, Reduction, Robot, Structure};
use plumbline_sim::{Gate, Pace, SimArm, Truth};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Text of the plan that the scenes move along.
pub const WALL_PLAN: &str = include_str!("wall.toml");
/// Sampling time of the arm \[s\].
pub const DT: f64 = 1e-3;
/// Periods driven before the recording, while the arm settles.
const LEAD_IN: u64 = 1;

/// An arm and a motion, with true parameters, positions and torques.
pub struct Scene {
    pub truth: Truth,
    pub structure: Structure,
    pub mounting: Mounting,
    pub period: f64,
    /// True parameters, in the order of the structure's columns.
    pub beta: Vec<f64>,
    /// One period of the arm's true motion once it has settled.
    pub motion: Motion,
    /// Torques of its actuators there, N x n.
    pub tau: DMatrix<f64>,
}

/// Disturbances of a recording besides the sensor noise of the arm's file.
#[derive(Clone, Copy, Debug, Default)]
pub struct Extra {
    /// First-order torque noise.
    pub coloured: Coloured,
    /// Standard deviation of further white position noise \[rad\].
    pub position: f64,
    /// Share of the torque samples that are off by 20 times the sensor's noise.
    pub outliers: f64,
}

/// First-order noise.
#[derive(Clone, Copy, Debug)]
pub struct Coloured {
    /// Standard deviation \[Nm\].
    pub std: f64,
    /// Correlation time \[s\].
    pub time: f64,
}

impl Default for Coloured {
    /// None; its correlation time is 0.1 s.
    fn default() -> Coloured {
        Coloured { std: 0.0, time: 0.1 }
    }
}

impl Coloured {
    /// With a correlation time of 0.1 s.
    pub fn of(std: f64) -> Coloured {
        Coloured { std, ..Coloured::default() }
    }

    /// Factor from one sample to the next.
    fn pole(self) -> f64 {
        (-DT / self.time).exp()
    }
}

impl Scene {
    /// The shipped Panda on the wall with the plan `wall.toml` in this folder.
    pub fn panda_on_the_wall() -> Scene {
        let truth = crate::sim::arm("sim-panda");
        let plan = parse_plan("wall.toml", WALL_PLAN).unwrap();
        let (fourier, mounting) = (plan.fourier().unwrap(), plan.mounting());
        let chain = Robot::load("panda", None).unwrap().chain;
        let n = chain.len();
        let period = (plan.period / DT).round() as usize;

        let mut arm = still(&chain, &truth, mounting, &plan.q0, 0);
        let reference = PeriodicMotion::new(&fourier, LEAD_IN as u32 + 1).unwrap();
        let zeros = || DMatrix::zeros(period, n);
        let mut motion = Motion {
            dt: DT,
            q: zeros(),
            dq: zeros(),
            ddq: zeros(),
            gravity: mounting.gravity(),
            periodic: true,
            start: 0.0,
        };
        let mut tau = zeros();
        let first = LEAD_IN as usize * period;
        drive(&mut arm, &reference, first + period, |tick, _, arm| {
            let Some(k) = tick.checked_sub(first) else { return };
            let exact = arm.exact();
            for j in 0..n {
                motion.q[(k, j)] = exact.q[j];
                motion.dq[(k, j)] = exact.dq[j];
                motion.ddq[(k, j)] = exact.ddq[j];
                tau[(k, j)] = exact.tau[j];
            }
        });

        let structure = Structure::of(chain.clone(), Reduction::in_mounting(&chain, &mounting), &["friction"]).unwrap();
        let delta = DVector::from_iterator(10 * n, truth.link_parameters().into_iter().flatten());
        let base = structure.reduction().base_of(&delta);
        let friction = truth.joints.iter().map(|j| j.fv).chain(truth.joints.iter().map(|j| j.fc));
        let beta = base.iter().copied().chain(friction).collect();
        Scene { truth, structure, mounting, period: plan.period, beta, motion, tau }
    }

    pub fn joints(&self) -> usize {
        self.motion.joints()
    }

    /// A recording of `periods` periods with the noise and the steps of the arm's sensors.
    pub fn record(&self, periods: usize, seed: u64) -> Run {
        self.record_with(periods, seed, Extra::default())
    }

    /// As [`Scene::record`], every so many samples of it, as a dataset holds it. It repeats with the scene's period where that is `periodic`.
    #[cfg(feature = "program")]
    pub fn dataset_run(
        &self,
        file: &str,
        role: Role,
        recorded: (usize, u64),
        every: usize,
        periodic: bool,
    ) -> dataset::Run {
        let (periods, seed) = recorded;
        let recorded = self.record(periods, seed);
        let rows: Vec<usize> = (0..recorded.t.len()).step_by(every).collect();
        let data = Run {
            name: file.into(),
            t: rows.iter().map(|&k| recorded.t[k]).collect(),
            q: recorded.q.select_rows(&rows),
            dq: None,
            tau: recorded.tau.select_rows(&rows),
            mounting: self.mounting,
            period: periodic.then_some(self.period),
        };
        dataset::Run::new(data, role)
    }

    /// As [`Scene::record`], with disturbances.
    pub fn record_with(&self, periods: usize, seed: u64, extra: Extra) -> Run {
        self.record_after(0, periods, seed, extra)
    }

    /// As [`Scene::record_with`], after this number of samples that are not recorded.
    pub fn record_after(&self, skipped: usize, periods: usize, seed: u64, extra: Extra) -> Run {
        let (n, samples) = (self.joints(), self.motion.samples());
        let rows = periods * samples;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let mut more = ChaCha8Rng::seed_from_u64(seed);
        more.set_stream(2);
        for _ in 0..3 * skipped * n {
            let _: f64 = rng.sample(StandardNormal);
        }
        let (mut q, mut tau) = (DMatrix::zeros(rows, n), DMatrix::zeros(rows, n));
        let pole = extra.coloured.pole();
        let mut coloured: Vec<f64> = (0..n).map(|_| more.sample::<f64, _>(StandardNormal)).collect();
        for k in 0..rows {
            for (j, joint) in self.truth.joints.iter().enumerate() {
                let mut normal = |std: f64| std * rng.sample::<f64, _>(StandardNormal);
                // The order in which the simulated arm's own sensors draw.
                let (of_q, _, of_tau) =
                    (normal(joint.position_noise), normal(joint.velocity_noise), normal(joint.torque_noise));
                let mut additional =
                    |std: f64| if std > 0.0 { std * more.sample::<f64, _>(StandardNormal) } else { 0.0 };
                let mut torque = self.tau[(k % samples, j)] + of_tau;
                if extra.coloured.std > 0.0 {
                    coloured[j] = pole * coloured[j] + additional((1.0 - pole * pole).sqrt());
                    torque += extra.coloured.std * coloured[j];
                }
                let position = self.motion.q[(k % samples, j)] + of_q + additional(extra.position);
                if extra.outliers > 0.0 && more.random::<f64>() < extra.outliers {
                    torque += 20.0 * joint.torque_noise * if more.random::<bool>() { 1.0 } else { -1.0 };
                }
                q[(k, j)] = step(position, joint.position_quantum);
                tau[(k, j)] = step(torque, joint.torque_quantum);
            }
        }
        let t = (0..rows).map(|k| k as f64 * DT).collect();
        Run { name: format!("run {seed}"), t, q, dq: None, tau, mounting: self.mounting, period: Some(self.period) }
    }

    /// Another motion of the same arm, every fiftieth sample: the plan's amplitudes, each joint with those of the next, exact derivatives.
    pub fn unseen(&self) -> Motion {
        let plan = parse_plan("wall.toml", WALL_PLAN).unwrap().fourier().unwrap();
        let n = self.joints();
        let rows = self.motion.samples() / 50;
        let at = |k: usize, j: usize| plan.at((j + 1) % n, k as f64 * 50.0 * DT);
        Motion {
            dt: 50.0 * DT,
            q: DMatrix::from_fn(rows, n, |k, j| plan.q0[j] + at(k, j).q - plan.q0[(j + 1) % n]),
            dq: DMatrix::from_fn(rows, n, |k, j| at(k, j).dq),
            ddq: DMatrix::from_fn(rows, n, |k, j| at(k, j).ddq),
            gravity: self.mounting.gravity(),
            periodic: true,
            start: 0.0,
        }
    }

    /// Variance of one raw torque sample of each joint: the sensor's noise and the rounding to its step.
    pub fn torque_variance(&self) -> Vec<f64> {
        self.truth.joints.iter().map(|j| j.torque_noise.powi(2) + j.torque_quantum.powi(2) / 12.0).collect()
    }

    /// Covariance that no unbiased estimator can beat (Cramer-Rao): `(sum over periods of W' Sigma^-1 W)^-1`, `W` the regressor of the
    /// true motion at the full rate, `Sigma` the true variance of each joint's torque. The motion is taken as known.
    pub fn bound(&self, periods: usize) -> DMatrix<f64> {
        let mut w = self.structure.regressor(&self.motion);
        let samples = self.motion.samples();
        for (j, variance) in self.torque_variance().iter().enumerate() {
            w.rows_mut(j * samples, samples).scale_mut(1.0 / variance.sqrt());
        }
        let information = transposed_product(&w, &w) * periods as f64;
        Cholesky::new(information).expect("an exciting motion").inverse()
    }
}

impl Scene {
    /// As [`Scene::bound`] where a first-order noise is on every torque too:
    /// frequency by frequency, `(sum_f W(f)^H W(f) / S(f))^-1` with `S` the spectrum of all noise.
    pub fn bound_coloured(&self, periods: usize, coloured: Coloured) -> DMatrix<f64> {
        let w = self.structure.regressor(&self.motion);
        let samples = self.motion.samples();
        let spectral = Spectral::new(samples, DT);
        let pole = coloured.pole();
        let colour = |f: f64| {
            let turn = std::f64::consts::TAU * f * DT;
            (1.0 - pole * pole) / (1.0 - 2.0 * pole * turn.cos() + pole * pole)
        };
        let mut information = DMatrix::zeros(w.ncols(), w.ncols());
        for (j, variance) in self.torque_variance().iter().enumerate() {
            // Real and imaginary parts as rows of their own, both sides of the spectrum, weighed by the noise.
            let mut rows = DMatrix::zeros(2 * spectral.bins(), w.ncols());
            for c in 0..w.ncols() {
                let column = w.column(c);
                let spectrum = spectral.transform(&column.as_slice()[j * samples..(j + 1) * samples]);
                for (m, value) in spectrum.iter().enumerate() {
                    let sides: f64 = if m == 0 || 2 * m == samples { 1.0 } else { 2.0 };
                    let noise = variance + coloured.std.powi(2) * colour(spectral.frequency(m));
                    let weight = (sides / (samples as f64 * noise)).sqrt();
                    rows[(2 * m, c)] = weight * value.re;
                    rows[(2 * m + 1, c)] = weight * value.im;
                }
            }
            information += transposed_product(&rows, &rows) * periods as f64;
        }
        Cholesky::new(information).expect("an exciting motion").inverse()
    }
}

/// The arm itself, with its sensors, at rest at the start of the motion.
pub fn still(chain: &plumbline_model::Chain, truth: &Truth, mounting: Mounting, q0: &[f64], seed: u64) -> SimArm {
    let mut start: JointVec = [0.0; 8];
    start[..q0.len()].copy_from_slice(q0);
    SimArm::new(chain, truth, mounting, start, seed, Pace::Fast(std::sync::Arc::new(Gate::unlimited()))).unwrap()
}

/// Commands a reference; `seen` gets each state that answers a sample of it, counted from 0.
pub fn drive(arm: &mut SimArm, reference: &PeriodicMotion, ticks: usize, mut seen: impl FnMut(usize, &State, &SimArm)) {
    for tick in 0..=ticks {
        let state = arm.read().unwrap();
        if tick > 0 {
            seen(tick - 1, &state, arm);
        }
        let desired = Setpoint { q: reference.at((tick as u64).min(reference.ticks() - 1)).q, ..Setpoint::default() };
        arm.write(&Command { seq: state.seq, desired, ..Command::default() }).unwrap();
    }
}

fn step(value: f64, quantum: f64) -> f64 {
    if quantum > 0.0 { (value / quantum).round() * quantum } else { value }
}
