//! The external torque on the simulated Panda: models identified from noisy runs, unseen motions, pushes at the flange. Shared by
//! `tests/identification/external_torque.rs` and `benches/external.rs`.

use super::lab;
use nalgebra::DMatrix;
use plumbline_core::{Backend, Command, JointVec, Reference, Setpoint};
use plumbline_excite::{PeriodicMotion, Plan};
use plumbline_identify::external::{ExternalObserver, ObserverSettings, residual_spectrum};
use plumbline_identify::solve::{Identification, identify};
use plumbline_identify::{Experiment, Run, Settings, TorqueUncertainty};
use plumbline_model::{Chain, Mounting, Reduction, Robot, Structure, TorqueModel};
use plumbline_sim::{Response, SimArm, Truth};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Duration of a push \[s\].
const PUSH_S: f64 = 0.2;
/// Time of its rise \[s\].
const EDGE_S: f64 = 0.01;
/// Pause before it, for the observer to settle \[s\].
const BEFORE_S: f64 = 0.3;

/// The shipped Panda, one motion to identify from and one that it does not know.
pub struct Bench {
    pub chain: Chain,
    pub truth: Truth,
    /// Coloured torque noise of every joint \[Nm\], 1.6 Hz.
    coloured: f64,
    known: Plan,
    unseen: Plan,
}

/// An identified model with what is known of its errors.
pub struct Found {
    pub model: TorqueModel,
    pub uncertainty: TorqueUncertainty,
}

/// States of a motion: position, velocity, torque.
pub type States = Vec<[JointVec; 3]>;

impl Bench {
    pub fn new(coloured: f64) -> Bench {
        let [identify, validate] = lab::plans();
        let mut truth = crate::sim::arm("sim-panda");
        truth.torque_noise_corner = 1.6;
        truth.joints.iter_mut().for_each(|joint| joint.torque_noise_coloured = coloured);
        let chain = Robot::load("panda", None).expect("a shipped robot").chain;
        Bench { chain, truth, coloured, known: identify[0].clone(), unseen: validate[0].clone() }
    }

    /// The arm with one more effect of its file.
    pub fn with_effect(&self, text: &str) -> Truth {
        let mut truth = crate::sim::arm_with("sim-panda", text);
        truth.torque_noise_corner = self.truth.torque_noise_corner;
        truth.joints.iter_mut().for_each(|joint| joint.torque_noise_coloured = self.coloured);
        truth
    }

    /// Some periods of the motion to identify from, or of the unseen one, once the arm has settled; noise is drawn by [`Response::measure`].
    pub fn response(&self, unseen: bool, periods: usize, mounting: Mounting) -> Response {
        let plan = if unseen { &self.unseen } else { &self.known };
        let reference = PeriodicMotion::new(&plan.fourier().expect("a plan"), 1).expect("a plan");
        let ticks = reference.period_ticks();
        Response::simulate(&self.chain, &self.truth, mounting, &reference, ticks, periods)
            .expect("truth fits the chain")
    }

    /// A recording as a dataset has it.
    pub fn record(&self, response: &Response, mounting: Mounting, seed: u64) -> Run {
        let n = self.chain.len();
        let (mut t, mut rows) = (Vec::new(), Vec::new());
        response.measure(seed, |_, _, state| {
            t.push(state.time);
            rows.push([state.q, state.dq, state.tau]);
        });
        let matrix = |i: usize| DMatrix::from_fn(rows.len(), n, |k, j| rows[k][i][j]);
        let period = response.period_ticks() as f64 * 1e-3;
        Run {
            name: format!("run {seed}"),
            q: matrix(0),
            dq: Some(matrix(1)),
            tau: matrix(2),
            t,
            mounting,
            period: Some(period),
        }
    }

    /// The base parameters of a mounting, identified from one recording with the default settings.
    pub fn identify(&self, run: &Run) -> Found {
        let settings = Settings::default();
        let structure =
            Structure::of(self.chain.clone(), Reduction::in_mounting(&self.chain, &run.mounting), &["friction"])
                .expect("known terms");
        let experiment = Experiment::prepare(run, &settings).expect("a recording");
        let identification: Identification = identify(&structure, &[experiment]).expect("an exciting motion");
        let model =
            TorqueModel::new("panda", structure, vec![run.mounting], &identification.values()).expect("its parameters");
        let residual_spectrum = residual_spectrum(&model, &[run], &settings);
        Found { uncertainty: TorqueUncertainty { residual_spectrum, ..TorqueUncertainty::of(&identification) }, model }
    }

    /// Ten pushes of `force` \[N\] at the flange along the unseen motion, each at another place of it and in a direction of its own (`seed`): the states
    /// of each, and the sample at which it begins.
    pub fn pushed(&self, force: f64, seed: u64, mounting: Mounting) -> Vec<(States, usize)> {
        let reference = PeriodicMotion::new(&self.unseen.fourier().expect("a plan"), 2).expect("a plan");
        let flange = self.chain.flange().origin;
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let trial = |index: usize, rng: &mut ChaCha8Rng| {
            let [x, y, z] = direction(rng).map(|x| force * x);
            let from = 1.0 + index as f64 * 0.9;
            let text = format!(
                "\n[[effect]]\nid = \"contact\"\nforce = [{x:?}, {y:?}, {z:?}]\npoint = [{:?}, {:?}, {:?}]\nfrom = {from:?}\nto = {:?}\nedge = {EDGE_S}\n",
                flange.x,
                flange.y,
                flange.z,
                from + PUSH_S
            );
            let truth = self.with_effect(&text);
            let mut arm: SimArm =
                super::still(&self.chain, &truth, mounting, &self.unseen.q0, seed * 100 + index as u64);
            let (first, begin, end) = (from - BEFORE_S, from, from + PUSH_S);
            let mut states = Vec::new();
            for tick in 0..=(end * 1e3) as u64 {
                let state = arm.read().expect("the arm goes on");
                if state.time > first {
                    states.push([state.q, state.dq, state.tau]);
                }
                let desired = Setpoint { q: reference.at(tick.min(reference.ticks() - 1)).q, ..Setpoint::default() };
                arm.write(&Command { seq: state.seq, desired, ..Command::default() }).expect("a smooth motion");
            }
            let pushed = states.len() - ((end - begin) * 1e3) as usize;
            (states, pushed)
        };
        (0..10).map(|index| trial(index, &mut rng)).collect()
    }
}

/// A direction, evenly over the sphere.
fn direction(rng: &mut ChaCha8Rng) -> [f64; 3] {
    loop {
        let x: [f64; 3] = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
        let norm = x.iter().map(|x| x * x).sum::<f64>().sqrt();
        if (0.1..1.0).contains(&norm) {
            return x.map(|x| x / norm);
        }
    }
}

impl Found {
    /// As a model file.
    #[cfg(feature = "program")]
    pub fn file(&self) -> plumbline::store::ModelFile {
        plumbline::store::ModelFile {
            model: self.model.clone(),
            noise_floor: Vec::new(),
            validation: Vec::new(),
            uncertainty: Some(self.uncertainty.clone()),
            consistent: None,
            provenance: plumbline::store::Provenance::default(),
        }
    }

    pub fn observer(&self, mounting: Mounting, settings: ObserverSettings) -> ExternalObserver {
        ExternalObserver::new(&self.model, &self.uncertainty, &mounting.gravity(), settings).expect("a spectrum")
    }
}

/// Milliseconds from the begin of a push to the flag, by `flagged` of each state in turn; `None` where it is not found while it lasts, or where something is
/// flagged before it.
pub fn found_after(states: &States, pushed: usize, flagged: impl FnMut(&[JointVec; 3]) -> bool) -> Option<usize> {
    let first = states.iter().position(flagged)?;
    first.checked_sub(pushed)
}
